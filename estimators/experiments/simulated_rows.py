"""Simulated rows of the paper's table: drives on which every filter that estimates the state is compared.

The true vehicle is drawn from the filters' own model of everything but n: its start is settled on the
true soil and displaced by the stated spread, its motion has the stated process noise and its sensors the
stated noise. So the model is matched: what a filter gets wrong here is its own approximation. No seed is
used both for tuning and for reporting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.experiments.buzhardt_tallapragada import CHOICES, Row, row_plant, row_truth
from estimators.filters.registry import SENSORS
from estimators.models.half_car_on_map import (
    CHANNELS,
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    advance_point,
    joint_model,
    read_point,
)
from estimators.numerics.bounded import from_range, to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.simulation.simulator import settled_state
from offroad_env.world.soils import SOILS

__all__ = ["REPORT_SEEDS", "TUNING_SEEDS", "SimulatedRow", "row_model", "simulate_row"]

_FIRST_GNSS = CHANNELS.index("X")
#: GNSS gives a fix every so many samples (10 Hz).
_FIX_EVERY = 10

#: Noise seeds on which anything was chosen, and those on which results are reported.
TUNING_SEEDS = tuple(range(101, 109))
REPORT_SEEDS = tuple(range(20))


@dataclass(frozen=True, kw_only=True)
class SimulatedRow:
    """A drive on a row of the table with noise in start, motion and sensors."""

    row: Row
    seed: int
    inputs: np.ndarray  #: (2 T - 1, 3) steer [rad], F_u [N], NaN at every half step
    truth: np.ndarray  #: (T, 11) true states and eta
    z: np.ndarray  #: (T, 11) readings of all sensors, `CHANNELS`, at every sample
    n: np.ndarray  #: (T,) true sinkage exponent [-]
    dt: float  #: [s]

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return self.dt * np.arange(len(self.z))

    def readings(self, sensors: str = "imu") -> np.ndarray:
        """(T, 11) readings of a set of `SENSORS`, NaN where nothing is measured; GNSS at 10 Hz."""
        if sensors not in SENSORS:
            raise InvalidParameter(f"sensors must be one of {', '.join(SENSORS)}, got {sensors!r}")
        z = np.full_like(self.z, math.nan)
        index = list(SENSORS[sensors])
        z[:, index] = self.z[:, index]
        z[np.arange(len(z)) % _FIX_EVERY != 0, _FIRST_GNSS:] = math.nan
        return z


def row_model(row: Row, settings: JointSettings) -> JointModel:
    """The filter's model of a row."""
    return joint_model(row_plant(row), CHOICES["dt"].value, settings)


@kernel
def _simulate(
    x: np.ndarray,
    warm: np.ndarray,
    inputs: np.ndarray,
    model: JointModel,
    noise: np.ndarray,
    states: np.ndarray,
    readings: np.ndarray,
) -> int:
    """Integrate the true point (11,) over the run; returns the step that failed, or the number of rows."""
    work, scratch = np.empty((3, x.shape[0] - 1)), np.empty(at.READINGS_SIZE)
    for k in range(states.shape[0]):
        if k > 0:
            step = inputs[2 * k - 2 : 2 * k + 1]
            if advance_point(x, warm, step, model, work, scratch) >= SUNK:
                return k
            x[:] += noise[k]
        states[k] = x
        if read_point(x, warm, inputs[2 * k], model, work, scratch, readings[k]) >= SUNK:
            return k
    return len(states)


def simulate_row(
    row: Row,
    seed: int,
    settings: JointSettings,
    *,
    duration: float = 100.0,
    change: tuple[float, float] | None = None,
    inputs: np.ndarray | None = None,
    exponents: np.ndarray | None = None,
) -> SimulatedRow:
    """Simulate a row with the noise that ``settings`` state.

    Parameters
    ----------
    row : Row
        One of `estimators.experiments.buzhardt_tallapragada.ROWS`.
    seed : int
        Of start, process and sensor noise.
    settings : JointSettings
    duration : float
        [s]
    change : (time, n), optional
        From this time [s] on the true soil has this exponent [-].
    inputs : array (2 T - 1, 3), optional
        Other inputs than the row's, at every half step; they set the duration.
    exponents : array (T,), optional
        True exponent at every sample instead of ``change`` [-]; starts with the soil's.

    Raises
    ------
    SolverFailure
        When the simulated vehicle leaves the range of the model.
    """
    model = row_model(row, settings)
    if inputs is None:
        inputs = row_truth(row, duration=duration).inputs
    state, warm = settled_state(model.plant, v_x=CHOICES["start_speed"].value)
    rng = np.random.default_rng([seed, row.number])
    x = np.empty(SIZE)
    x[:ETA] = state[:ETA] + rng.normal(size=ETA) * settings.start
    x[ETA] = from_range(SOILS[row.soil].n, model.low, model.high)
    T = len(inputs) // 2 + 1
    noise = rng.normal(size=(T, SIZE)) * np.sqrt(model.Q)
    if change is not None:
        noise[round(change[0] / model.dt), ETA] += from_range(change[1], model.low, model.high) - x[ETA]
    if exponents is not None:
        noise[1:, ETA] += np.diff([from_range(float(n), model.low, model.high) for n in exponents])
    truth, z = np.empty((T, SIZE)), np.empty((T, len(CHANNELS)))
    done = _simulate(x, warm, inputs, model, noise, truth, z)
    if done < T or not np.isfinite(z).all():
        raise SolverFailure(f"row {row.number}, seed {seed}: no contact at t = {done * model.dt:.2f} s")
    z += rng.normal(size=z.shape) * np.sqrt(model.R)
    n = np.array([to_range(eta, model.low, model.high) for eta in truth[:, ETA]])
    return SimulatedRow(row=row, seed=seed, inputs=inputs, truth=truth, z=z, n=n, dt=model.dt)
