"""The paper's filter for the sinkage exponent alone, compiled, over a whole run.

The filter estimates n; the vehicle's state that its observation model needs comes from a *source*:

``propagated``  the filter's own model carries the state, open loop, with the current n (the
                paper's filter, as far as it says);
``known``       a perfect navigation system hands over the true state: a bound, never on board.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.models import channels_of, paper_observation, plant_with_exponent, share_horizontal
from estimators.transforms import from_range, moments, range_slope, to_range
from estimators.ukf_compiled import check_alpha, merwe_weights, sigma_points, unscented_update
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.vehicle_model import Plant

__all__ = ["SOURCES", "ParameterRun", "ParameterSettings", "run_parameter_filter"]

SOURCES = ("propagated", "known")
#: Normal quantile of a central interval of 95 %.
_Z_95 = 1.959964


@dataclass(frozen=True, kw_only=True)
class ParameterSettings:
    """What the paper calls the tunable parameters, and the prior."""

    n_prior: float = 1.0  #: first guess of n (BT, Fig. 4) [-]
    n_prior_sd: float = 0.2  #: its standard deviation [-]
    n_range: tuple[float, float] = (0.3, 1.8)  #: bounds of n: clay and sand with room on both sides
    alpha: float = 0.5  #: spread of the sigma points
    drift: float = 0.01  #: sqrt(R_n): random walk of eta per update [-]
    #: Standard deviation that the filter assumes per channel [m/s^2, rad/s]. Horizontal: the sensor's.
    #: Vertical: the size of the signal that the ground itself causes, since the propagated position
    #: drifts and with it the phase of the terrain.
    noise: tuple[float, ...] = (0.2, 0.2, 4.0, 0.35, 0.0175)

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        low, high = self.n_range
        if not low < self.n_prior < high:
            raise InvalidParameter(f"n_prior must lie inside n_range = ({low}, {high}), got {self.n_prior}")
        if not (self.n_prior_sd > 0.0 and self.drift >= 0.0):
            raise InvalidParameter(
                f"n_prior_sd must be > 0 and drift >= 0, got {self.n_prior_sd} and {self.drift}"
            )


@dataclass(frozen=True, kw_only=True)
class ParameterRun:
    """What the filter believed. Row k belongs to the k-th measurement; row 0 is the prior."""

    eta: np.ndarray  #: (T,) mean of the transformed exponent
    variance: np.ndarray  #: (T,) its variance
    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) standard deviation of n [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval of n [-]
    high: np.ndarray  #: (T,) its upper end [-]
    nis: np.ndarray  #: (T,) normalised innovation squared; NaN where no update was possible
    states: np.ndarray  #: (T, 15) state that the observation model started from
    repairs: int  #: repaired factorisations
    skipped: int  #: updates left out because some sigma point had no contact solution


@kernel
def _run(result, warm, known, inputs, z, plant, setting, noise):
    """The loop behind `run_parameter_filter`; returns (repairs, skipped).

    ``result`` = (states (T, 15), belief (T, 2): eta and its variance, nis (T,)), first rows given;
    ``setting`` = (dt, low, high, channels); ``noise`` = (R_e (m, m), R_n, alpha). Every sigma point
    carries its own warm start, heave and pitch.
    """
    states, belief, nis = result
    R, R_n, alpha = noise
    dt, low, high, channels = setting
    weights = merwe_weights(1.0, alpha, 0.0)
    mean, cov = belief[0, :1].copy(), belief[0, 1:].copy().reshape(1, 1)
    points, factor = np.empty((3, 1)), np.empty((1, 1))
    predicted, imu = np.empty((3, channels.shape[0])), np.empty(5)
    own, warms = np.empty((3, states.shape[1])), np.empty((4, 2, 3))
    own[:], warms[:] = states[0], warm
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        step, x = inputs[2 * k - 2 : 2 * k + 1], states[k - 1]
        if known:
            own[:] = x
        cov[0, 0] += R_n
        repairs += sigma_points(mean, cov, weights[3], factor, points)
        worst = 0.0
        for i in range(3):
            share_horizontal(x, own[i])
            there = plant_with_exponent(plant, to_range(points[i, 0], low, high))
            worst = max(worst, paper_observation(own[i], warms[i], step, there, dt, imu))
            predicted[i] = imu[channels]
        if worst < SUNK and np.isfinite(predicted).all() and np.isfinite(own).all():
            nis[k], repaired = unscented_update(mean, cov, points, predicted, z[k], R, weights)
            repairs += repaired
        else:
            skipped += 1
            own[:] = x
        if not known:
            states[k] = x
            here = plant_with_exponent(plant, to_range(mean[0], low, high))
            paper_observation(states[k], warms[3], step, here, dt, imu)
        belief[k, 0], belief[k, 1] = mean[0], cov[0, 0]
    return repairs, skipped


@kernel
def _all_of_n(belief, low, high, out):
    """Mean, sd and ends of the 95 % interval of n at every row, into ``out`` (T, 4)."""
    for k in range(belief.shape[0]):
        out[k, 0], out[k, 1] = moments(belief[k, 0], belief[k, 1], low, high)
        reach = _Z_95 * math.sqrt(belief[k, 1])
        out[k, 2] = to_range(belief[k, 0] - reach, low, high)
        out[k, 3] = to_range(belief[k, 0] + reach, low, high)


def run_parameter_filter(
    plant: Plant,
    start: tuple[np.ndarray, np.ndarray],
    inputs: np.ndarray,
    imu: np.ndarray,
    dt: float,
    settings: ParameterSettings,
    *,
    known: np.ndarray | None = None,
) -> ParameterRun:
    """Filter a whole run.

    Parameters
    ----------
    plant : Plant
        The filter's own model ("paper"; half-car or bicycle). Its soil's n is not used.
    start : (state (15,), warm (2, 3))
        Where the propagated state starts.
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    imu : array (T, 5)
        Measured `models.CHANNELS`; row 0 belongs to the start and is not used.
    dt : float
        Time between rows [s].
    known : array (T, 15), optional
        True states: selects the source ``known``.

    Raises
    ------
    InvalidParameter
        When the arrays do not belong together.
    """
    T = len(imu)
    if len(inputs) != 2 * T - 1 or (known is not None and len(known) != T):
        raise InvalidParameter(
            f"imu has {T} rows, so inputs must have {2 * T - 1} (half steps) and known {T}; "
            f"got {len(inputs)} and {None if known is None else len(known)}"
        )
    low, high = settings.n_range
    channels = channels_of(plant)
    R = np.diag(np.asarray(settings.noise, dtype=np.float64)[channels] ** 2)
    eta = from_range(settings.n_prior, low, high)
    belief, nis = np.empty((T, 2)), np.full(T, math.nan)
    belief[0] = eta, (settings.n_prior_sd / range_slope(eta, low, high)) ** 2
    states = np.empty((T, at.STATE_SIZE)) if known is None else np.array(known, dtype=np.float64)
    if known is None:
        states[0] = start[0]
    setting = (float(dt), float(low), float(high), channels)
    noise = (R, float(settings.drift) ** 2, float(settings.alpha))
    z = np.ascontiguousarray(imu[:, channels])
    result = (states, belief, nis)
    repairs, skipped = _run(result, start[1], known is not None, inputs, z, plant, setting, noise)
    n = np.empty((T, 4))
    _all_of_n(belief, float(low), float(high), n)
    return ParameterRun(
        eta=belief[:, 0],
        variance=belief[:, 1],
        n=n[:, 0],
        sd=n[:, 1],
        low=n[:, 2],
        high=n[:, 3],
        nis=nis,
        states=states,
        repairs=int(repairs),
        skipped=int(skipped),
    )
