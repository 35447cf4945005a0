"""What the inertial unit should read if the sinkage exponent were n: the filters' observation model.

d_k = f(xi_{k-1}, n) (BT, section III): one step of the plant's own model with exponent n from the
previous state, read at the new state. Reading it at the old state would leave both angular rates
without any dependence on n, since the force laws only enter their derivatives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant, with_exponent
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_step
from offroad_env.physics.imu import A_X, A_Y, A_Z, PITCH_RATE, YAW_RATE, ImuMount, imu_reading
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.paper_vehicle import paper_derivative, paper_step
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray, Soil, Vehicle
from offroad_env.simulation.simulator import plant_model

__all__ = [
    "BICYCLE_CHANNELS",
    "CHANNELS",
    "HALF_CAR_CHANNELS",
    "PropagatedModel",
    "Turning",
    "channels_of",
    "imu_of",
    "mounted_reading",
    "paper_observation",
    "plant_with",
    "plant_with_exponent",
    "share_horizontal",
    "step_full_copies",
    "step_paper_copies",
]

#: Channels of the inertial unit [m/s^2, rad/s], at the centre of gravity.
CHANNELS = ("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate")
HALF_CAR_CHANNELS = np.array([0, 1, 2, 3, 4])
#: The bicycle has no vertical motion to compare with (BT, section IV).
BICYCLE_CHANNELS = np.array([0, 1, 4])


class Turning(NamedTuple):
    """Motion of the body that a mounted unit measures beside its accelerations."""

    yaw_rate: float  #: [rad/s]
    pitch_rate: float  #: [rad/s]
    pitch: float  #: [rad]


@inline_kernel
def plant_with(plant: Plant, vehicle: Vehicle, soil: Soil) -> Plant:
    """The same plant with another vehicle and soil."""
    return replace(plant, vehicle=vehicle, soil=soil)


@kernel
def plant_with_exponent(plant: Plant, n: float) -> Plant:
    """The same plant on the same soil with another sinkage exponent."""
    return plant_with(plant, plant.vehicle, with_exponent(plant.soil, n))


@kernel
def imu_of(x: FloatArray, readings: FloatArray, imu: FloatArray) -> None:
    """Noise-free readings (5,) at the centre of gravity of the state that ``readings`` belongs to."""
    imu[A_X], imu[A_Y], imu[A_Z] = readings[at.A_X], readings[at.A_Y], readings[at.A_Z]
    imu[PITCH_RATE], imu[YAW_RATE] = x[at.PITCH_RATE], x[at.YAW_RATE]


@kernel
def paper_observation(
    x: FloatArray, warm: FloatArray, inputs: FloatArray, plant: Plant, dt: float, imu: FloatArray
) -> float:
    """One Runge-Kutta step of the paper's model, in place, and the reading after it.

    Parameters
    ----------
    x (15,), warm (2, 3) : previous state and its warm start, advanced by ``dt`` [s]
    inputs (3, 3) : (steer, F_u, NaN) at the start, middle and end of the step
    imu (5,) : receives the reading at the new state

    Returns
    -------
    The worst contact status on the way.
    """
    work, readings = np.empty((3, x.shape[0])), np.empty(at.READINGS_SIZE)
    status = paper_step(x, warm, inputs, plant, dt, work, readings)
    u = (inputs[2, 0], inputs[2, 1], inputs[2, 2])
    paper_derivative(x, u, plant, warm, work[0], readings)
    imu_of(x, readings, imu)
    worst: float = max(status, readings[at.STATUS])
    return worst


@kernel
def share_horizontal(x: FloatArray, own: FloatArray) -> None:
    """Give ``own`` (15,) the place, heading and horizontal motion of ``x``; heave and pitch stay its own."""
    for i in range(x.shape[0]):
        if not (i == at.Z or i == at.PITCH or i == at.V_Z or i == at.PITCH_RATE):
            own[i] = x[i]


@kernel
def step_full_copies(
    copies: FloatArray,
    warms: FloatArray,
    packed: PackedPlant,
    exponents: FloatArray,
    command: tuple[float, float, float],
    dt: float,
    mount: ImuMount,
    predicted: FloatArray,
) -> float:
    """Read every copy of the full model as it is, then carry it over ``dt`` with its own exponent, in place.

    Parameters
    ----------
    copies (C, 15), warms (C, 2, 3) : states and warm starts, advanced
    packed : of `offroad_env.physics.packing.pack`
    exponents (C,) : sinkage exponent of each copy
    command : (steer [rad], drive torque [N m], brake torque [N m]), held
    mount : `ImuMount` of the inertial unit
    predicted (C, 5) : receives the readings before the step

    Returns
    -------
    The worst contact status.
    """
    plant = unpack(packed)
    work, readings = np.empty((WORK_ROWS, at.READINGS_SIZE)), np.empty(at.READINGS_SIZE)
    worst = 0.0
    for i in range(copies.shape[0]):
        x = copies[i]
        motion = Turning(x[at.YAW_RATE], x[at.PITCH_RATE], x[at.PITCH])
        own = plant_with_exponent(plant, exponents[i])
        worst = max(worst, full_step(x, warms[i], command, own, dt, work, readings))
        mounted_reading(motion, readings, mount, predicted[i])
    return worst


@kernel
def step_paper_copies(
    copies: FloatArray,
    warms: FloatArray,
    packed: PackedPlant,
    exponents: FloatArray,
    command: tuple[float, float, float],
    dt: float,
    mount: ImuMount,
    predicted: FloatArray,
) -> float:
    """The same for the paper's model, where ``command`` is (steer [rad], F_u [N], NaN)."""
    plant = unpack(packed)
    work, readings = np.empty((3, at.STATE_SIZE)), np.empty(at.READINGS_SIZE)
    held = np.empty((3, 3))
    steer, force, _ = command
    for i in range(3):
        held[i, 0], held[i, 1], held[i, 2] = steer, force, math.nan
    worst = 0.0
    for i in range(copies.shape[0]):
        x = copies[i]
        motion = Turning(x[at.YAW_RATE], x[at.PITCH_RATE], x[at.PITCH])
        own = plant_with_exponent(plant, exponents[i])
        worst = max(worst, paper_step(x, warms[i], held, own, dt, work, readings))
        mounted_reading(motion, readings, mount, predicted[i])
    return worst


@kernel
def mounted_reading(motion: Turning, readings: FloatArray, mount: ImuMount, imu: FloatArray) -> None:
    """Noise-free reading (5,) of a mounted unit."""
    imu[A_X], imu[A_Y], imu[A_Z], imu[PITCH_RATE], imu[YAW_RATE] = imu_reading(
        (readings[at.A_X], readings[at.A_Y], readings[at.A_Z]),
        motion.yaw_rate,
        motion.pitch_rate,
        readings[at.YAW_ACC],
        readings[at.PITCH_ACC],
        motion.pitch,
        mount,
    )


def channels_of(plant: Plant) -> FloatArray:
    """Indices into `CHANNELS` of what a plant models: all five, or three for the bicycle."""
    return HALF_CAR_CHANNELS if plant.half_car > 0.5 else BICYCLE_CHANNELS


class PropagatedModel:
    """The paper's model, one step at a time, with its state propagated open loop.

    Every sigma point has its own heave and pitch, which settle on its own soil within tenths of a
    second; place, heading and horizontal speeds are those of the mean. (Points that start each
    step from one common height feel their n at a sinkage that belongs to another n: on clay the
    sensitivity of a_x then has the wrong sign, and the filter runs away.)

    For the reference filter (`estimators.filters.parameter_ukf_reference`); the compiled filter has a loop of
    its own.

    Parameters
    ----------
    plant : Plant
        Of model "paper".
    state, warm : arrays (15,), (2, 3)
        Where to start; copied.
    dt : float
        Step [s].
    points : int
        Sigma points that will ask.
    """

    def __init__(self, plant: Plant, state: FloatArray, warm: FloatArray, dt: float, points: int = 3) -> None:
        if plant_model(plant) != "paper":
            raise InvalidParameter("this is the paper's model: make the plant with model='paper'")
        self.plant = plant
        self.dt = float(dt)
        self.state, self.warm = state.copy(), warm.copy()
        self.channels = channels_of(plant)
        self._own = [(state.copy(), warm.copy()) for _ in range(points)]

    def predict(self, n: float, inputs: FloatArray, point: int) -> FloatArray:
        """Readings (m,) of one sigma point after a step with exponent ``n``; call once per step.

        ``inputs`` (3, 3) as in `paper_observation`. Raises SolverFailure without a contact solution.
        """
        x, warm = self._own[point]
        share_horizontal(self.state, x)
        readings: FloatArray = self._step(n, inputs, x, warm)[self.channels]
        return readings

    def advance(self, n: float, inputs: FloatArray) -> None:
        """Carry the mean's state on by one step with exponent ``n``."""
        self._step(n, inputs, self.state, self.warm)

    def place(self, state: FloatArray) -> None:
        """Set the state (15,) of the mean and of all sigma points."""
        self.state[:] = state
        for x, _ in self._own:
            x[:] = state

    def _step(self, n: float, inputs: FloatArray, x: FloatArray, warm: FloatArray) -> FloatArray:
        imu = np.empty(len(CHANNELS))
        status = paper_observation(x, warm, inputs, plant_with_exponent(self.plant, float(n)), self.dt, imu)
        if status >= SUNK or not np.isfinite(imu).all():
            raise SolverFailure(f"the soil with n = {n:.3f} does not carry the vehicle (status {status:g})")
        return imu
