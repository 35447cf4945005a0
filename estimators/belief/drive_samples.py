"""The sensors of a drive in means over a fifth of a second, as measured and as a model has them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.filters.protocol import Pose
from estimators.models.imu_prediction import Turning, mounted_reading
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.imu import YAW_RATE, ImuMount
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import Plant, settled_state, simulate_commands

__all__ = ["BLOCK", "COMPARED", "DriveSamples", "simulated_drive"]

#: Length of the means [s].
BLOCK = 0.2
#: What is compared: accelerations [m/s^2], yaw rate [rad/s], wheel speeds and speed [m/s], course [rad].
COMPARED = ("a_x", "a_y", "yaw_rate", "wheel_f", "wheel_r", "speed", "course")
#: Step of the solver [s]: twice that of the truth, which moves means by a hundredth of the sensors' noise.
_STEP = 0.01


@dataclass(frozen=True, kw_only=True)
class DriveSamples:
    """A drive from its start until now; row k of the sensors was sampled after command k."""

    period: float  #: between rows [s]
    commands: FloatArray  #: (K, 3) steering [rad], drive, brake torque [N m]
    imu: FloatArray  #: (K, 5) as `offroad_env.physics.imu` has them
    wheel: FloatArray  #: (K, 2) wheel speeds [m/s]; NaN between samples
    gnss: FloatArray  #: (K, 4) x, y, speed, course; NaN between fixes
    pose: Pose  #: at the start, as given
    unit: ImuConfig  #: the inertial unit as described

    def __post_init__(self) -> None:
        if len(self.commands) < self.rows:
            raise InvalidParameter(f"a drive must last {BLOCK:g} s or more, got {len(self.commands)} rows")

    @property
    def rows(self) -> int:
        """Rows in a mean."""
        return round(BLOCK / self.period)

    @property
    def blocks(self) -> int:
        """Means of the drive; what is left after the last is not used."""
        return len(self.commands) // self.rows

    @cached_property
    def _sampled(self) -> FloatArray:
        """(B, R, 7) samples of the means as `COMPARED`; NaN between them."""
        course = self.gnss[:, 3].copy()
        known = np.isfinite(course)
        turned = np.concatenate([[0.0], course[known] - self.pose.yaw])
        course[known] = self.pose.yaw + np.unwrap(turned)[1:]
        rows = np.column_stack([self.imu[:, :2], self.imu[:, YAW_RATE], self.wheel, self.gnss[:, 2], course])
        found: FloatArray = rows[: self.blocks * self.rows].reshape(self.blocks, self.rows, -1)
        return found

    def means_of(self, rows: FloatArray) -> FloatArray:
        """(B, 7) means of rows (B R, 7) over the instants at which the sensors have sampled."""
        parts = rows.reshape(self.blocks, self.rows, -1)
        known = np.isfinite(self._sampled)
        found: FloatArray = np.where(known, parts, 0.0).sum(axis=1) / known.sum(axis=1)
        return found

    def measured(self) -> tuple[FloatArray, FloatArray]:
        """(B, 7) means as `COMPARED`, and (B, 7) how many samples each is of.

        Raises
        ------
        InvalidParameter
            Where a sensor has no sample in one of them.
        """
        seen = np.isfinite(self._sampled).sum(axis=1)
        if not seen.all():
            missing = ", ".join(np.array(COMPARED)[(seen == 0).any(axis=0)])
            raise InvalidParameter(f"no sample within {BLOCK:g} s of {missing}")
        return self.means_of(self._sampled.reshape(-1, len(COMPARED))), seen.astype(float)


@kernel
def _inertial(states: FloatArray, readings: FloatArray, mount: ImuMount, out: FloatArray) -> None:
    """Readings (K, 5) of a mounted unit along a simulated drive."""
    for k in range(states.shape[0]):
        x = states[k]
        mounted_reading(Turning(x[at.YAW_RATE], x[at.PITCH_RATE], x[at.PITCH]), readings[k], mount, out[k])


def simulated_drive(plant: Plant, samples: DriveSamples) -> FloatArray:
    """(B, 7) means of the drive open loop from its start under the commands, settled on the model's soil.

    Raises
    ------
    SolverFailure
        Where the soil does not carry the vehicle, or ceases to.
    """
    pose = samples.pose
    state, warm = settled_state(plant, x=pose.X, y=pose.Y, yaw=pose.yaw, v_x=pose.v)
    commands = samples.commands[: samples.blocks * samples.rows]
    run = simulate_commands(
        plant, state, warm, commands, interval=samples.period, dt=min(_STEP, samples.period)
    )
    states, readings = run.states[1:], run.readings[1:]
    imu = np.empty((len(states), 5))
    _inertial(states, readings, samples.unit.mount(), imu)
    v_x, v_y = states[:, at.V_X], states[:, at.V_Y]
    rims = plant.vehicle.r * states[:, [at.OMEGA_F, at.OMEGA_R]]
    course = states[:, at.YAW] + np.arctan2(v_y, v_x)
    rows = np.column_stack([imu[:, :2], imu[:, YAW_RATE], rims, np.hypot(v_x, v_y), course])
    return samples.means_of(rows)
