"""Simulated rows on which every filter's model is wrong: mass, soil moduli, map, sensors, steering.

A comparison with a matched model, where plant and filter agree, is too favourable: published filters of this
kind report 2-4 % error in it and 13-26 % on another plant. Here the truth departs from the filters' model
in one of the ways of `MISMATCHES`, or in all at once, on the eight rows of the paper's table. Signs and
directions are drawn, sizes are fixed.

The drive force of the paper's rows is open loop, and nothing in the model ties force to speed: a vehicle
that is 10 % heavier would stand still after half a minute. A driver therefore holds the speed of the nominal
run by a slow correction of the force, which every filter knows as a command.

Slip sinkage is that of `lyasko_sinkage_factor`: smaller moduli at the same exponent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.experiments.buzhardt_tallapragada import CHOICES, Row, row_plant, row_truth
from estimators.experiments.simulated_rows import SimulatedRow
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
from estimators.numerics.bounded import from_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import add, rough_terrain

__all__ = ["MISMATCHES", "Mismatch", "MismatchedRow", "excited", "mismatched_row"]

#: Pull of the driver towards the nominal run's speed [1/s]: faster than the force of a row changes.
_DRIVER = 1.0
#: Spatial frequencies of a map's errors [cycles/m]: a map with posts 1 m apart knows nothing beyond
#: 0.5; below 0.05 it is right.
_MAP_BAND = (0.05, 0.5)
_MAP_WAVES = 24
#: Time over which excitation is judged [s], and how large it must be [m/s^2]: twice the noise of the
#: accelerometers.
_EXCITED_TIME, _EXCITED = 2.0, 0.4


@dataclass(frozen=True, kw_only=True)
class Mismatch:
    """Sizes of the differences between truth and filter model; 0 where they agree."""

    title: str  #: in words
    mass: float = 0.0  #: share by which the mass differs, either way [-]
    stiffness: float = 0.0  #: share by which k_phi differs, either way [-]
    map_error: float = 0.0  #: height error of the map [m rms]
    map_shift: float = 0.0  #: distance by which the map is shifted, in any direction [m]
    acceleration_bias: float = 0.0  #: of every accelerometer, either way [m/s^2]
    rate_bias: float = 0.0  #: of every gyro, either way [rad/s]
    misalignment: float = 0.0  #: of the inertial unit in roll and in pitch, either way [rad]
    lag: float = 0.0  #: time constant of the steering [s]
    slip_sinkage: bool = False  #: whether wheels that slip sink deeper


#: Errors of an inexpensive inertial unit: 10 mg, 0.3 deg/s, mounted to 2 deg.
_ACCELERATION_BIAS, _RATE_BIAS, _MISALIGNMENT = 0.1, 0.005, math.radians(2.0)

#: The study: each alone, and all together.
MISMATCHES: dict[str, Mismatch] = {
    "none": Mismatch(title="none (matched model)"),
    "mass": Mismatch(title="mass ±10 %", mass=0.1),
    "map_error": Mismatch(title="map height error 1 cm rms", map_error=0.01),
    "map_shift": Mismatch(title="map shifted by 0.5 m", map_shift=0.5),
    "stiffness": Mismatch(title="k_phi ±20 %", stiffness=0.2),
    "imu": Mismatch(
        title="IMU bias and 2° misalignment",
        acceleration_bias=_ACCELERATION_BIAS,
        rate_bias=_RATE_BIAS,
        misalignment=_MISALIGNMENT,
    ),
    "lag": Mismatch(title="steering lag 50 ms", lag=0.05),
    "slip_sinkage": Mismatch(title="slip sinkage", slip_sinkage=True),
    "all": Mismatch(
        title="all together",
        mass=0.1,
        map_error=0.01,
        map_shift=0.5,
        stiffness=0.2,
        lag=0.05,
        slip_sinkage=True,
        acceleration_bias=_ACCELERATION_BIAS,
        rate_bias=_RATE_BIAS,
        misalignment=_MISALIGNMENT,
    ),
}


@dataclass(frozen=True, kw_only=True)
class MismatchedRow(SimulatedRow):
    """A simulated row whose truth is not the filters' model; positions are on the true ground."""

    mismatch: str  #: name in `MISMATCHES`
    excited: np.ndarray  #: (T,) bool: steering or roughness acts, see `excited`


def excited(accelerations: np.ndarray, dt: float) -> np.ndarray:
    """Where steering or roughness acts: true a_y or a_z has an rms of 0.4 m/s^2 over the last 2 s.

    Parameters
    ----------
    accelerations : array (T, 2)
        True lateral and vertical acceleration [m/s^2].
    dt : float
        [s]
    """
    count = min(round(_EXCITED_TIME / dt), len(accelerations))
    total = np.cumsum(np.vstack([np.zeros((1, 2)), np.square(accelerations)]), axis=0)
    last = np.arange(1, len(total))
    first = np.maximum(last - count, 0)
    mean = (total[last] - total[first]) / (last - first)[:, None]
    return np.asarray(mean.max(axis=1) >= _EXCITED**2)


@kernel
def _lagged(command: np.ndarray, lag: float, step: float) -> np.ndarray:
    """First-order response to a command that is linear between its samples, ``step`` [s] apart."""
    out = np.empty(command.shape[0])
    out[0] = command[0]
    keep = math.exp(-step / lag)
    for i in range(1, command.shape[0]):
        slope = (command[i] - command[i - 1]) / step
        out[i] = command[i] - slope * lag + (out[i - 1] - command[i - 1] + slope * lag) * keep
    return out


class _Record(NamedTuple):
    """What a simulation takes and fills, a row per sample."""

    noise: np.ndarray  #: (T, 11) process noise
    states: np.ndarray  #: (T, 11) true states and eta, filled
    readings: np.ndarray  #: (T, 11) noise-free readings, filled


@kernel
def _drive(
    x: np.ndarray,
    warm: np.ndarray,
    inputs: np.ndarray,
    steer: np.ndarray,
    speed: np.ndarray,
    model: JointModel,
    record: _Record,
) -> int:
    """Integrate the true point (11,) over the run; returns the step that failed, or the number of rows.

    ``inputs`` (2 T - 1, 3) are the commands, to whose force the driver's correction is added; ``steer``
    (2 T - 1,) is the angle of the wheels; ``speed`` (T,) is what the driver holds.
    """
    states = record.states
    work, scratch, step = np.empty((3, ETA)), np.empty(at.READINGS_SIZE), np.empty((3, 3))
    for k in range(states.shape[0]):
        if k > 0:
            correction = _DRIVER * model.plant.vehicle.m * (speed[k - 1] - x[at.V_X])
            inputs[2 * k - 1, 1] += correction
            inputs[2 * k, 1] += correction
            step[:] = inputs[2 * k - 2 : 2 * k + 1]
            step[:, 0] = steer[2 * k - 2 : 2 * k + 1]
            if advance_point(x, warm, step, model, work, scratch) >= SUNK:
                return k
            x[:] += record.noise[k]
        states[k] = x
        now = inputs[2 * k].copy()
        now[0] = steer[2 * k]
        if read_point(x, warm, now, model, work, scratch, record.readings[k]) >= SUNK:
            return k
    return len(states)


def _true_plant(row: Row, mismatch: Mismatch, rng: np.random.Generator) -> Plant:
    """The vehicle and the ground as they are."""
    plant = row_plant(row)
    signs = rng.choice([-1.0, 1.0], size=2)
    vehicle = plant.vehicle._replace(m=plant.vehicle.m * (1.0 + float(signs[0]) * mismatch.mass))
    soil = plant.soil._replace(k_phi=plant.soil.k_phi * (1.0 + float(signs[1]) * mismatch.stiffness))
    if mismatch.slip_sinkage:
        factor = lyasko_sinkage_factor(plant.slip) ** -soil.n
        soil = soil._replace(k_c=soil.k_c * factor, k_phi=soil.k_phi * factor)
    direction, waves = rng.uniform(0.0, 2.0 * math.pi), plant.ground.waves.copy()
    dx, dy = mismatch.map_shift * math.cos(direction), mismatch.map_shift * math.sin(direction)
    waves[:, 3] -= waves[:, 1] * dx + waves[:, 2] * dy
    ground = plant.ground._replace(waves=waves)
    if mismatch.map_error > 0.0:
        lacking = rough_terrain(None, rng, roughness=1e-6, waves=_MAP_WAVES, band=_MAP_BAND)
        rms = math.sqrt(0.5 * float(np.sum(lacking.waves[:, 0] ** 2)))
        lacking.waves[:, 0] *= mismatch.map_error / rms
        ground = add(ground, lacking)
    return plant._replace(vehicle=vehicle, soil=soil, ground=ground)


def _faulty_unit(z: np.ndarray, mismatch: Mismatch, rng: np.random.Generator) -> None:
    """Misalign and bias the inertial unit's readings (T, 11), in place."""
    signs = rng.choice([-1.0, 1.0], size=7)
    roll, pitch = mismatch.misalignment * signs[:2]
    # Columns of the rotation are the unit's axes. It measures gravity, which is subtracted as if the unit
    # stood straight on level ground. A gyro about the left axis reads -pitch_rate.
    rotation = ImuConfig().mount((float(roll), float(pitch), 0.0)).rotation
    up = np.array([0.0, 0.0, GRAVITY])
    z[:, :3] = (z[:, :3] + up) @ rotation - up
    omega = np.stack([np.zeros(len(z)), -z[:, 3], z[:, 4]], axis=1) @ rotation
    z[:, 3], z[:, 4] = -omega[:, 1], omega[:, 2]
    z[:, :3] += mismatch.acceleration_bias * signs[2:5]
    z[:, 3:5] += mismatch.rate_bias * signs[5:]


def mismatched_row(
    row: Row, name: str, seed: int, settings: JointSettings | None = None, *, duration: float = 100.0
) -> MismatchedRow:
    """Simulate a row with a vehicle, a ground and sensors that differ from every filter's model.

    Parameters
    ----------
    row : Row
        One of `buzhardt_tallapragada.ROWS`.
    name : str
        One of `MISMATCHES`.
    seed : int
        Of start, process and sensor noise, as in `simulated_rows.simulate_row`, and of the mismatch.
    settings : JointSettings, optional
        Noise and start.
    duration : float
        [s]

    Raises
    ------
    SolverFailure
        When the vehicle leaves the range of the model.
    """
    if name not in MISMATCHES:
        raise InvalidParameter(f"mismatch must be one of {', '.join(MISMATCHES)}, got {name!r}")
    mismatch, settings = MISMATCHES[name], settings or JointSettings()
    draws = np.random.default_rng([seed, row.number, 1])
    model = joint_model(_true_plant(row, mismatch, draws), CHOICES["dt"].value, settings)
    nominal = row_truth(row, duration=duration)
    inputs, speed = nominal.inputs.copy(), nominal.run.states[:, at.V_X].copy()
    steer = inputs[:, 0].copy()
    if mismatch.lag > 0.0:
        steer = _lagged(steer, mismatch.lag, 0.5 * model.dt)
    rng = np.random.default_rng([seed, row.number])
    state, warm = settled_state(model.plant, v_x=CHOICES["start_speed"].value)
    x, T = np.empty(SIZE), len(speed)
    x[:ETA] = state[:ETA] + rng.normal(size=ETA) * settings.start
    x[ETA] = from_range(SOILS[row.soil].n, model.low, model.high)
    noise = rng.normal(size=(T, SIZE)) * np.sqrt(model.Q)
    truth, z = np.empty((T, SIZE)), np.empty((T, len(CHANNELS)))
    done = _drive(x, warm, inputs, steer, speed, model, _Record(noise, truth, z))
    if done < T or not np.isfinite(z).all():
        raise SolverFailure(
            f"row {row.number}, seed {seed}, {name}: no contact at t = {done * model.dt:.2f} s"
        )
    acts = excited(z[:, 1:3], model.dt)
    _faulty_unit(z, mismatch, draws)
    z += rng.normal(size=z.shape) * np.sqrt(model.R)
    n = np.full(T, SOILS[row.soil].n)
    return MismatchedRow(
        row=row,
        seed=seed,
        inputs=inputs,
        truth=truth,
        z=z,
        n=n,
        dt=model.dt,
        mismatch=name,
        excited=acts,
    )
