"""The paper's filter for the sinkage exponent alone, compiled, over a whole run.

The filter estimates n; the vehicle's state that its observation model needs comes from a *source*:

``propagated``  the filter's own model carries the state, open loop, with the current n (the
                paper's filter, as far as it is described);
``known``       a perfect navigation system supplies the true state: a bound, never available in practice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.filters.belief_history import BeliefHistory
from estimators.models.imu_prediction import (
    channels_of,
    paper_observation,
    plant_with_exponent,
    share_horizontal,
)
from estimators.numerics.bounded import from_range, moments, range_slope, to_range
from estimators.numerics.unscented import check_alpha, merwe_weights, sigma_points, unscented_update
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.numerics import all_finite, copy_into
from offroad_env.physics.records import FloatArray

__all__ = [
    "SOURCES",
    "ParameterHistory",
    "ParameterRecord",
    "ParameterSettings",
    "check_inputs",
    "empty_record",
    "parameter_run",
    "run_parameter_filter",
]

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
class ParameterHistory:
    """Beliefs of the filter over a run. Row k belongs to the k-th measurement; row 0 is the prior."""

    belief: BeliefHistory  #: about n
    eta: FloatArray  #: (T,) mean of the transformed exponent
    variance: FloatArray  #: (T,) its variance
    states: FloatArray  #: (T, 15) state that the observation model started from


class _Observation(NamedTuple):
    """The observation model and its noise."""

    plant: Plant
    dt: float  #: [s]
    low: float  #: bounds of n [-]
    high: float
    channels: FloatArray  #: (m,) compared, indices into `estimators.models.imu_prediction.CHANNELS`
    R_e: FloatArray  #: (m,) variances of the measurement noise
    R_n: float  #: variance of the random walk of eta per update
    alpha: float  #: spread of the sigma points


class ParameterRecord(NamedTuple):
    """A run, to be filled; the first rows are given."""

    states: FloatArray  #: (T, 15)
    belief: FloatArray  #: (T, 2) mean and variance of eta
    nis: FloatArray  #: (T,)


@kernel
def _run(
    record: ParameterRecord,
    warm: FloatArray,
    known: bool,
    inputs: FloatArray,
    z: FloatArray,
    model: _Observation,
) -> tuple[int, int]:
    """The loop behind `run_parameter_filter`; returns (repairs, skipped).

    Every sigma point has its own warm start, heave and pitch.
    """
    states, belief = record.states, record.belief
    weights = merwe_weights(1.0, model.alpha, 0.0)
    mean, cov = belief[0, :1].copy(), belief[0, 1:].copy().reshape(1, 1)
    points, factor = np.empty((3, 1)), np.empty((1, 1))
    predicted, imu = np.empty((3, model.channels.shape[0])), np.empty(5)
    innovation = np.empty(model.channels.shape[0])
    own, warms = np.empty((3, states.shape[1])), np.empty((4, 2, 3))
    # Rows one by one: by broadcasting, a kernel takes seconds longer to compile.
    for i in range(3):
        copy_into(own[i], states[0])
    for i in range(4):
        for j in range(2):
            copy_into(warms[i, j], warm[j])
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        step, x = inputs[2 * k - 2 : 2 * k + 1], states[k - 1]
        if known:
            for i in range(3):
                copy_into(own[i], x)
        cov[0, 0] += model.R_n
        repairs += sigma_points(mean, cov, weights.scale, factor, points)
        worst, sound = 0.0, True
        for i in range(3):
            share_horizontal(x, own[i])
            there = plant_with_exponent(model.plant, to_range(points[i, 0], model.low, model.high))
            worst = max(worst, paper_observation(own[i], warms[i], step, there, model.dt, imu))
            for j in range(model.channels.shape[0]):
                predicted[i, j] = imu[model.channels[j]]
            sound = sound and all_finite(predicted[i]) and all_finite(own[i])
        if worst < SUNK and sound:
            update = unscented_update(mean, cov, points, predicted, z[k], model.R_e, weights, innovation)
            record.nis[k] = update.nis
            repairs += update.repairs
        else:
            skipped += 1
            for i in range(3):
                copy_into(own[i], x)
        if not known:
            copy_into(states[k], x)
            here = plant_with_exponent(model.plant, to_range(mean[0], model.low, model.high))
            paper_observation(states[k], warms[3], step, here, model.dt, imu)
        belief[k, 0], belief[k, 1] = mean[0], cov[0, 0]
    return repairs, skipped


@kernel
def _all_of_n(belief: FloatArray, low: float, high: float, out: FloatArray) -> None:
    """Mean, sd and ends of the 95 % interval of n at every row, into ``out`` (T, 4)."""
    for k in range(belief.shape[0]):
        out[k, 0], out[k, 1] = moments(belief[k, 0], belief[k, 1], low, high)
        reach = _Z_95 * math.sqrt(belief[k, 1])
        out[k, 2] = to_range(belief[k, 0] - reach, low, high)
        out[k, 3] = to_range(belief[k, 0] + reach, low, high)


def check_inputs(inputs: FloatArray, imu: FloatArray, known: FloatArray | None) -> None:
    """Refuse arrays that do not belong together.

    Raises
    ------
    InvalidParameter
    """
    T = len(imu)
    if len(inputs) != 2 * T - 1 or (known is not None and len(known) != T):
        raise InvalidParameter(
            f"imu has {T} rows, so inputs must have {2 * T - 1} (half steps) and known {T}; "
            f"got {len(inputs)} and {None if known is None else len(known)}"
        )


def empty_record(
    settings: ParameterSettings, count: int, state: FloatArray, known: FloatArray | None
) -> ParameterRecord:
    """Room for ``count`` samples, with the prior and the state of the start in the first row."""
    low, high = settings.n_range
    eta = from_range(settings.n_prior, low, high)
    belief = np.empty((count, 2))
    belief[0] = eta, (settings.n_prior_sd / range_slope(eta, low, high)) ** 2
    if known is not None:
        return ParameterRecord(np.array(known, dtype=np.float64), belief, np.full(count, math.nan))
    states = np.empty((count, at.STATE_SIZE))
    states[0] = state
    return ParameterRecord(states, belief, np.full(count, math.nan))


def parameter_run(
    settings: ParameterSettings,
    record: ParameterRecord,
    dt: float,
    channels: int,
    *,
    repairs: int,
    skipped: int,
) -> ParameterHistory:
    """A run from what its filter recorded, ``dt`` [s] apart, with so many ``channels`` compared."""
    (low, high), n = settings.n_range, np.empty((len(record.nis), 4))
    _all_of_n(record.belief, float(low), float(high), n)
    belief = BeliefHistory(
        t=dt * np.arange(len(record.nis)),
        n=n[:, 0],
        sd=n[:, 1],
        low=n[:, 2],
        high=n[:, 3],
        nis=record.nis,
        channels=channels,
        speed=record.states[:, at.V_X],
        repairs=repairs,
        lost=skipped,
    )
    return ParameterHistory(
        belief=belief, eta=record.belief[:, 0], variance=record.belief[:, 1], states=record.states
    )


def run_parameter_filter(
    plant: Plant,
    start: tuple[FloatArray, FloatArray],
    inputs: FloatArray,
    imu: FloatArray,
    dt: float,
    settings: ParameterSettings,
    *,
    known: FloatArray | None = None,
) -> ParameterHistory:
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
        Measured `estimators.models.imu_prediction.CHANNELS`; row 0 belongs to the start and is not used.
    dt : float
        Time between rows [s].
    known : array (T, 15), optional
        True states: selects the source ``known``.

    Raises
    ------
    InvalidParameter
        When the arrays do not belong together.
    """
    check_inputs(inputs, imu, known)
    (low, high), (state, warm) = settings.n_range, start
    channels = channels_of(plant)
    model = _Observation(
        plant=plant,
        dt=float(dt),
        low=float(low),
        high=float(high),
        channels=channels,
        R_e=np.asarray(settings.noise, dtype=np.float64)[channels] ** 2,
        R_n=float(settings.drift) ** 2,
        alpha=float(settings.alpha),
    )
    record = empty_record(settings, len(imu), state, known)
    z = np.ascontiguousarray(imu[:, channels])
    repairs, skipped = _run(record, warm, known is not None, inputs, z, model)
    return parameter_run(settings, record, dt, len(channels), repairs=int(repairs), skipped=int(skipped))
