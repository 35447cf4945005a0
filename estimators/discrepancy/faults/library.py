"""Faults that mirror the effects of the library, for tests of the diagnosis.

Every fault is implemented a second time, without the laws of `offroad_env.effects`: as a change of the
commands, the samples, the records, or the state between steps. A test binds each of them to the effect of the
same name. Four effects act inside the suspension or on the soil of one axle, where nothing can be changed
from outside; they have no fault here.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from estimators.discrepancy.faults.drive import TICK
from estimators.discrepancy.faults.forces import Push, body_force, wheel_forces
from offroad_env.physics import state as at
from offroad_env.physics.imu import GNSS, WHEEL
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Soil, SoilMap
from offroad_env.simulation.drive import Command, Faults
from offroad_env.simulation.simulator import Plant

__all__ = ["FAULTS", "ONE_SIDED"]


def _delayed_steering(delay: float) -> Faults:
    ticks = round(delay / TICK)

    def command(past: list[Command]) -> Command:
        _, drive, brake = past[-1]
        return past[max(len(past) - 1 - ticks, 0)][0], drive, brake

    return Faults(command=command)


def _lagging_steering(time: float) -> Faults:
    held: list[float] = []

    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        if not held:
            held.append(steer)
        before = held[0]
        held[0] += (steer - before) * (1.0 - math.exp(-TICK / time))
        # A command is held for a tick: its value in the middle.
        return 0.5 * (before + held[0]), drive, brake

    return Faults(command=command)


def _offset_steering(angle: float) -> Faults:
    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        return steer + angle, drive, brake

    return Faults(command=command)


def _payload(share: float) -> Faults:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        load = 1.0 + share
        return plant._replace(vehicle=v._replace(m=v.m * load, I_z=v.I_z * load, I_y=v.I_y * load))

    return Faults(plant=plant)


def _added_drag(area: float) -> Faults:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        return plant._replace(vehicle=v._replace(drag_area=v.drag_area + area))

    return Faults(plant=plant)


def _rolling_resistance(share: float) -> Faults:
    def force(x: np.ndarray, plant: Plant) -> Push:
        held = math.copysign(min(abs(x[at.V_X]) / 0.2, 1.0), x[at.V_X])
        return -share * plant.vehicle.m * GRAVITY * held, 0.0, 0.0

    return body_force(force)


def _slip_dependent_n(slope: float) -> Faults:
    """Under each axle a disc of soil that moves with it, whose n depends on the slip of the axle."""
    base: list[float] = []

    def step(x: np.ndarray, readings: np.ndarray, plant: Plant) -> Plant:
        if not base:
            base.append(plant.soil.n)
        discs = np.empty((2, 4))
        for i, axle in enumerate((readings[: at.AXLE], readings[at.AXLE : at.MOTION])):
            n = base[0] + slope * (math.hypot(axle[at.SLIP], 1e-2) - 1e-2)
            discs[i] = (axle[at.WHEEL_X], axle[at.WHEEL_Y], 0.5, n)
        return plant._replace(soil_map=SoilMap(0.3, discs))

    return Faults(step=step)


def _stepped_n(step: float) -> Faults:
    """Half of the world is a disc so large that its rim is a straight border."""

    def plant(plant: Plant) -> Plant:
        radius, border = 2000.0, 35.0
        disc = np.array([[border + radius, 0.0, radius, plant.soil.n + step]])
        return plant._replace(soil_map=SoilMap(1.0, disc))

    return Faults(plant=plant)


def _biased_channel(channel: int) -> Callable[[float], Faults]:
    def make(bias: float) -> Faults:
        def sample(sample: np.ndarray) -> None:
            sample[channel] += bias

        return Faults(sample=sample)

    return make


def _delayed_commands(delay: float) -> Faults:
    ticks = round(delay / TICK)
    return Faults(command=lambda past: past[max(len(past) - 1 - ticks, 0)])


def _scaled_steering(share: float) -> Faults:
    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        return steer * (1.0 + share), drive, brake

    return Faults(command=command)


def _scaled_torque(driven: float, braked: float) -> Callable[[float], Faults]:
    """Torques that are larger by these shares of the size."""

    def make(share: float) -> Faults:
        def command(past: list[Command]) -> Command:
            steer, drive, brake = past[-1]
            return steer, drive * (1.0 + driven * share), brake * (1.0 + braked * share)

        return Faults(command=command)

    return make


def _scaled_channels(channels: slice) -> Callable[[float], Faults]:
    """Sensors with a relative scale error."""

    def make(share: float) -> Faults:
        def sample(sample: np.ndarray) -> None:
            sample[channels] += share * sample[channels]

        return Faults(sample=sample)

    return make


def _pitched_imu(angle: float) -> Faults:
    """An IMU whose x axis points up a little."""

    def sample(sample: np.ndarray) -> None:
        a_x, a_z = sample[0], sample[2]
        sample[0] = math.cos(angle) * a_x + math.sin(angle) * a_z
        sample[2] = math.cos(angle) * a_z - math.sin(angle) * a_x
        sample[4] *= math.cos(angle)

    return Faults(sample=sample)


def _rolled_imu(angle: float) -> Faults:
    """An IMU whose left side is up a little; its pitch gyro, about the left axis, turns the other way."""

    def sample(sample: np.ndarray) -> None:
        a_y, a_z, pitch_rate, yaw_rate = sample[1:5]
        sample[1] = math.cos(angle) * a_y + math.sin(angle) * a_z
        sample[2] = math.cos(angle) * a_z - math.sin(angle) * a_y
        sample[3] = math.cos(angle) * pitch_rate - math.sin(angle) * yaw_rate
        sample[4] = math.cos(angle) * yaw_rate + math.sin(angle) * pitch_rate

    return Faults(sample=sample)


def _displaced_imu(ahead: float, up: float) -> Faults:
    """Accelerations of an IMU away from the centre of gravity, for a level body."""

    def feel(x: np.ndarray, readings: np.ndarray, plant: Plant) -> None:
        yaw, pitch = x[at.YAW_RATE], x[at.PITCH_RATE]
        yaw_acc, pitch_acc = readings[at.YAW_ACC], readings[at.PITCH_ACC]
        readings[at.A_X] -= ahead * (yaw * yaw + pitch * pitch) + up * pitch_acc
        readings[at.A_Y] += ahead * yaw_acc - 2.0 * up * pitch * yaw
        readings[at.A_Z] += ahead * pitch_acc - up * pitch * pitch

    return Faults(feel=feel)


def _grade(slope: float) -> Faults:
    def force(x: np.ndarray, plant: Plant) -> Push:
        pull = -slope * plant.vehicle.m * GRAVITY
        return pull * math.cos(x[at.YAW]), -pull * math.sin(x[at.YAW]), 0.0

    return body_force(force)


def _bank(slope: float) -> Faults:
    def force(x: np.ndarray, plant: Plant) -> Push:
        pull = -slope * plant.vehicle.m * GRAVITY
        return pull * math.sin(x[at.YAW]), pull * math.cos(x[at.YAW]), 0.0

    return body_force(force)


def _yaw_moment(moment: float) -> Faults:
    return body_force(lambda x, plant: (0.0, 0.0, moment))


def _uneven_brakes(share: float) -> Faults:
    """Brake forces that differ between left and right."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        v = plant.vehicle
        more_left = share * x[at.BRAKE] / v.r * min(max(x[at.V_X] / 0.2, -1.0), 1.0)
        return 0.0, 0.0, 0.5 * v.track * more_left

    return body_force(force)


def _rut_drag(stress: float) -> Faults:
    def force(axle: np.ndarray, plant: Plant) -> Push:
        rolling = min(max(axle[at.V_L] / 0.2, -1.0), 1.0)
        walls = 2.0 * plant.vehicle.wheels_per_axle * plant.vehicle.r * axle[at.SINKAGE]
        return -stress * walls * rolling, 0.0, 0.0

    return wheel_forces(force)


def _bulldozing(stress: float) -> Faults:
    def force(axle: np.ndarray, plant: Plant) -> Push:
        area = 2.0 * plant.vehicle.wheels_per_axle * plant.vehicle.r * axle[at.SINKAGE]
        aside = axle[at.V_C] / math.hypot(axle[at.V_C], axle[at.V_L], 0.1)
        return 0.0, -stress * area * aside, 0.0

    return wheel_forces(force)


def _grouser_thrust(share: float) -> Faults:
    def force(axle: np.ndarray, plant: Plant) -> Push:
        thrust = share * axle[at.N] * math.tanh(10.0 * axle[at.SLIP])
        return thrust, 0.0, thrust * plant.vehicle.r

    return wheel_forces(force)


def _n_trend(slope: float) -> Faults:
    """Under each axle a disc of soil that moves with it, whose n grows along x."""
    base: list[float] = []

    def step(x: np.ndarray, readings: np.ndarray, plant: Plant) -> Plant:
        if not base:
            base.append(plant.soil.n)
        axles = (readings[: at.AXLE], readings[at.AXLE : at.MOTION])
        places = [(axle[at.WHEEL_X], axle[at.WHEEL_Y]) for axle in axles]
        discs = np.array([(a, b, 0.5, base[0] + 0.01 * slope * (a - 80.0)) for a, b in places])
        return plant._replace(soil_map=SoilMap(0.3, discs))

    return Faults(step=step)


def _rate_dependent_moduli(slope: float) -> Faults:
    """Soil whose moduli grow with the speed of the vehicle."""
    base: list[Soil] = []

    def step(x: np.ndarray, readings: np.ndarray, plant: Plant) -> Plant:
        if not base:
            base.append(plant.soil)
        more = 1.0 + slope * abs(x[at.V_X])
        return plant._replace(soil=base[0]._replace(k_c=more * base[0].k_c, k_phi=more * base[0].k_phi))

    return Faults(step=step)


def _changed_soil(change: Callable[..., dict[str, float]]) -> Callable[[float], Faults]:
    """Another value in the soil's record: ``change`` makes it from the soil and the size."""

    def make(size: float) -> Faults:
        def plant(plant: Plant) -> Plant:
            return plant._replace(soil=plant.soil._replace(**change(plant.soil, size)))

        return Faults(plant=plant)

    return make


def _scaled_vehicle(*fields: str) -> Callable[[float], Faults]:
    """Numbers of the vehicle's record that are all wrong by one share."""

    def make(share: float) -> Faults:
        def plant(plant: Plant) -> Plant:
            changed = {name: getattr(plant.vehicle, name) * (1.0 + share) for name in fields}
            return plant._replace(vehicle=plant.vehicle._replace(**changed))

        return Faults(plant=plant)

    return make


def _shifted_cg(back: float) -> Faults:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        return plant._replace(vehicle=v._replace(l_f=v.l_f + back, l_r=v.l_r - back))

    return Faults(plant=plant)


def _received(x: np.ndarray, ahead: float = 0.0) -> np.ndarray:
    """Position, speed and course by a receiver without noise, antenna ``ahead`` of the centre [m], (4,)."""
    cos, sin = math.cos(x[at.YAW]), math.sin(x[at.YAW])
    along, across = x[at.V_X], x[at.V_Y] + ahead * x[at.YAW_RATE]
    course = x[at.YAW] + math.atan2(across, along)
    return np.array([x[at.X] + ahead * cos, x[at.Y] + ahead * sin, math.hypot(along, across), course])


def _late_receiver(delay: float) -> Faults:
    """A receiver whose solution is ``delay`` old [s]."""
    states: list[np.ndarray] = []

    def sample(sample: np.ndarray) -> None:
        if states:
            place = max(len(states) - 1 - delay / TICK, 0.0)
            i = min(int(place), max(len(states) - 2, 0))
            before, after = _received(states[i]), _received(states[min(i + 1, len(states) - 1)])
            sample[GNSS] += before + (place - i) * (after - before) - _received(states[-1])

    return Faults(feel=lambda x, readings, plant: states.append(x.copy()), sample=sample)


def _displaced_antenna(ahead: float) -> Faults:
    """An antenna that is not at the centre of gravity."""
    now: list[np.ndarray] = []

    def feel(x: np.ndarray, readings: np.ndarray, plant: Plant) -> None:
        now[:] = [x.copy()]

    def sample(sample: np.ndarray) -> None:
        if now:
            sample[GNSS] += _received(now[0], ahead) - _received(now[0])

    return Faults(feel=feel, sample=sample)


#: Effect -> its fault, from the size. None of these uses the laws of the library.
FAULTS: dict[str, Callable[[float], Faults]] = {
    "steer_delay": _delayed_steering,
    "steer_lag": _lagging_steering,
    "clock_offset": _delayed_commands,
    "steer_offset": _offset_steering,
    "steer_gain": _scaled_steering,
    "torque_scale": _scaled_torque(1.0, 1.0),
    "drive_scale": _scaled_torque(1.0, 0.0),
    "brake_scale": _scaled_torque(0.0, 1.0),
    "payload": _payload,
    "cg_shift": _shifted_cg,
    "cg_height": _scaled_vehicle("h_cg"),
    "inertia": _scaled_vehicle("I_z", "I_y"),
    "spring_rate": _scaled_vehicle("k_f", "k_r"),
    "rolling_resistance": _rolling_resistance,
    "aero_drag": _added_drag,
    "rut_drag": _rut_drag,
    "grade": _grade,
    "bank": _bank,
    "yaw_moment": _yaw_moment,
    "one_sided_brake": _uneven_brakes,
    "slip_exponent": _slip_dependent_n,
    "rate_damping": _rate_dependent_moduli,
    "bulldozing": _bulldozing,
    "grouser_thrust": _grouser_thrust,
    "n_step": _stepped_n,
    "n_trend": _n_trend,
    "exit_angle": _changed_soil(lambda soil, size: {"b_0": soil.b_0 + size}),
    "cohesion": _changed_soil(lambda soil, size: {"c": max(soil.c + size, 0.0)}),
    "friction_angle": _changed_soil(lambda soil, size: {"phi": soil.phi + size}),
    "shear_modulus": _changed_soil(
        lambda soil, size: {"k_x": soil.k_x * (1.0 + size), "k_y": soil.k_y * (1.0 + size)}
    ),
    "accel_bias_x": _biased_channel(0),
    "accel_bias_y": _biased_channel(1),
    "accel_bias_z": _biased_channel(2),
    "gyro_bias_pitch": _biased_channel(3),
    "gyro_bias_yaw": _biased_channel(4),
    "accel_scale": _scaled_channels(slice(0, 3)),
    "wheel_radius_scale": _scaled_channels(WHEEL),
    "imu_misalignment_pitch": _pitched_imu,
    "imu_misalignment_roll": _rolled_imu,
    "lever_arm_x": lambda distance: _displaced_imu(distance, 0.0),
    "lever_arm_z": lambda distance: _displaced_imu(0.0, distance),
    "pose_delay": _late_receiver,
    "antenna_x": _displaced_antenna,
}
#: Effects that cannot be negative: nothing acts before its command.
ONE_SIDED = ("steer_delay", "steer_lag", "clock_offset", "pose_delay")
