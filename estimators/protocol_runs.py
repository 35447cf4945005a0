"""The eight rows of the paper's table as one protocol for every filter that estimates the state too.

The truth is a draw from what the filter believes about everything but n: its start is settled on
the true soil and displaced by the stated spread, its motion carries the stated process noise and
its sensors the stated noise. Seeds for tuning and for reporting do not meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.joint import (
    CHANNELS,
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    advance_point,
    joint_model,
    read_point,
)
from estimators.paper import CHOICES, Row, row_truth
from estimators.transforms import from_range, to_range
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.simulator import Plant, make_plant, settled_state
from offroad_env.soils import SOILS, make_soil
from offroad_env.terrain import paper_terrain
from offroad_env.vehicles import VEHICLES

__all__ = ["REPORT_SEEDS", "TUNING_SEEDS", "RowTwin", "row_model", "row_plant", "row_twin"]

#: Noise seeds on which anything was chosen, and those on which results are reported.
TUNING_SEEDS = tuple(range(101, 109))
REPORT_SEEDS = tuple(range(20))


@dataclass(frozen=True, kw_only=True)
class RowTwin:
    """A row of the table with noise in start, motion and sensors."""

    row: Row
    seed: int
    inputs: np.ndarray  #: (2 T - 1, 3) steer [rad], F_u [N], NaN at every half step
    truth: np.ndarray  #: (T, 11) true states and eta
    z: np.ndarray  #: (T, 11) readings of all sensors, `joint.CHANNELS`, at every sample
    n: np.ndarray  #: (T,) true sinkage exponent [-]
    dt: float  #: [s]

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return self.dt * np.arange(len(self.z))


def row_plant(row: Row) -> Plant:
    """The half-car of a row, truth and filter's model alike."""
    return make_plant(
        VEHICLES["paper"],
        make_soil(row.soil),
        paper_terrain(row.H0),
        model="paper",
        slip=CHOICES[f"slip_{row.soil}"].value,
    )


def row_model(row: Row, settings: JointSettings) -> JointModel:
    """The filter's model of a row."""
    return joint_model(row_plant(row), CHOICES["dt"].value, settings)


@kernel
def _draw(x, warm, inputs, model, noise, states, readings):
    """Carry the true point (11,) through the run; returns the step that failed, or the number of rows."""
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
    return states.shape[0]


def row_twin(
    row: Row,
    seed: int,
    settings: JointSettings,
    *,
    duration: float = 100.0,
    change: tuple[float, float] | None = None,
) -> RowTwin:
    """Simulate a row with the noise that ``settings`` state.

    Parameters
    ----------
    row : Row
        One of `estimators.paper.ROWS`.
    seed : int
        Of start, process and sensor noise.
    settings : JointSettings
    duration : float
        [s]
    change : (time, n), optional
        From this time [s] on the true soil has this exponent [-].

    Raises
    ------
    SolverFailure
        When the drawn vehicle leaves the range of the model.
    """
    model = row_model(row, settings)
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
    truth, z = np.empty((T, SIZE)), np.empty((T, len(CHANNELS)))
    done = _draw(x, warm, inputs, model, noise, truth, z)
    if done < T or not np.isfinite(z).all():
        raise SolverFailure(f"row {row.number}, seed {seed}: no contact at t = {done * model.dt:.2f} s")
    z += rng.normal(size=z.shape) * np.sqrt(model.R)
    n = np.array([to_range(eta, model.low, model.high) for eta in truth[:, ETA]])
    return RowTwin(row=row, seed=seed, inputs=inputs, truth=truth, z=z, n=n, dt=model.dt)
