"""What can be hidden in a drive, for tests of the finder.

Everything here is written a second time: as changes of the commands, of the samples, of the records and of
the state between steps, never with the laws of `offroad_env.effects`. A test binds every one of them to the
effect that it mirrors. Four of the library's effects act inside the suspension or on one axle's soil, where
nothing can be changed from outside; they are not hidden here.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from estimators.discrepancy.hidden_run import TICK, Case, Hidden, draw_case, hidden_log
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import SoilMap
from offroad_env.physics.sensor_kernels import GNSS, WHEEL
from offroad_env.simulator import Plant

__all__ = ["HIDERS", "ONE_SIDED", "STRANGERS", "Case", "Hidden", "draw_case", "hidden_log"]


def _late(delay: float) -> Hidden:
    ticks = round(delay / TICK)

    def command(past):
        return (past[max(len(past) - 1 - ticks, 0)][0], *past[-1][1:])

    return Hidden(command=command)


def _lagging(time: float) -> Hidden:
    held = []

    def command(past):
        if not held:
            held.append(past[-1][0])
        before = held[0]
        held[0] += (past[-1][0] - before) * (1.0 - math.exp(-TICK / time))
        # What acts is held for a tick: the middle of it.
        return (0.5 * (before + held[0]), *past[-1][1:])

    return Hidden(command=command)


def _turned(angle: float) -> Hidden:
    return Hidden(command=lambda past: (past[-1][0] + angle, *past[-1][1:]))


def _laden(share: float) -> Hidden:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        load = 1.0 + share
        return plant._replace(vehicle=v._replace(m=v.m * load, I_z=v.I_z * load, I_y=v.I_y * load))

    return Hidden(plant=plant)


def _pushed(force: Callable[[np.ndarray, Plant], tuple[float, float, float]]) -> Hidden:
    """A force on the body (forward, left [N], moment [N m]): kicks, and what the IMU feels of it."""

    def kick(x, readings, plant, span):
        F_x, F_y, M_z = force(x, plant)
        m, I_z = plant.vehicle.m, plant.vehicle.I_z
        x[at.V_X] += F_x / m * span
        x[at.V_Y] += F_y / m * span
        x[at.YAW_RATE] += M_z / I_z * span

    def feel(x, readings, plant):
        F_x, F_y, M_z = force(x, plant)
        readings[at.A_X] += F_x / plant.vehicle.m
        readings[at.A_Y] += F_y / plant.vehicle.m
        readings[at.YAW_ACC] += M_z / plant.vehicle.I_z

    return Hidden(kick=kick, feel=feel)


def _dragging(area: float) -> Hidden:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        return plant._replace(vehicle=v._replace(drag_area=v.drag_area + area))

    return Hidden(plant=plant)


def _resisting(share: float) -> Hidden:
    def force(x, plant):
        held = math.copysign(min(abs(x[at.V_X]) / 0.2, 1.0), x[at.V_X])
        return -share * plant.vehicle.m * GRAVITY * held, 0.0, 0.0

    return _pushed(force)


def _slipping(slope: float) -> Hidden:
    """Under each axle a disc of soil that moves with it, with the n that its slip makes."""
    base: list[float] = []

    def step(x, readings, plant):
        if not base:
            base.append(plant.soil.n)
        discs = np.empty((2, 4))
        for i, axle in enumerate((readings[: at.AXLE], readings[at.AXLE : at.MOTION])):
            n = base[0] + slope * (math.hypot(axle[at.SLIP], 1e-2) - 1e-2)
            discs[i] = (axle[at.WHEEL_X], axle[at.WHEEL_Y], 0.5, n)
        return plant._replace(soil_map=SoilMap(0.3, discs))

    return Hidden(step=step)


def _bordered(step: float) -> Hidden:
    """Half of the world is a disc so large that its rim is a straight border."""

    def plant(plant: Plant) -> Plant:
        radius, border = 2000.0, 35.0
        disc = np.array([[border + radius, 0.0, radius, plant.soil.n + step]])
        return plant._replace(soil_map=SoilMap(1.0, disc))

    return Hidden(plant=plant)


def _biased(channel: int) -> Callable[[float], Hidden]:
    def make(bias: float) -> Hidden:
        def sample(sample: np.ndarray) -> None:
            sample[channel] += bias

        return Hidden(sample=sample)

    return make


def _all_late(delay: float) -> Hidden:
    ticks = round(delay / TICK)
    return Hidden(command=lambda past: past[max(len(past) - 1 - ticks, 0)])


def _scaled_steering(share: float) -> Hidden:
    return Hidden(command=lambda past: (past[-1][0] * (1.0 + share), *past[-1][1:]))


def _scaled_torque(share: float) -> Hidden:
    return Hidden(command=lambda past: (past[-1][0], *(torque * (1.0 + share) for torque in past[-1][1:])))


def _stretched(channels: slice) -> Callable[[float], Hidden]:
    """Sensors that read a share too much."""

    def make(share: float) -> Hidden:
        def sample(sample: np.ndarray) -> None:
            sample[channels] += share * sample[channels]

        return Hidden(sample=sample)

    return make


def _pitched(angle: float) -> Hidden:
    """An IMU whose x axis points up a little."""

    def sample(sample: np.ndarray) -> None:
        a_x, a_z = sample[0], sample[2]
        sample[0] = math.cos(angle) * a_x + math.sin(angle) * a_z
        sample[2] = math.cos(angle) * a_z - math.sin(angle) * a_x
        sample[4] *= math.cos(angle)

    return Hidden(sample=sample)


def _rolled(angle: float) -> Hidden:
    """An IMU whose left side is up a little; its pitch gyro, about the left axis, turns the other way."""

    def sample(sample: np.ndarray) -> None:
        a_y, a_z, pitch_rate, yaw_rate = sample[1:5]
        sample[1] = math.cos(angle) * a_y + math.sin(angle) * a_z
        sample[2] = math.cos(angle) * a_z - math.sin(angle) * a_y
        sample[3] = math.cos(angle) * pitch_rate - math.sin(angle) * yaw_rate
        sample[4] = math.cos(angle) * yaw_rate + math.sin(angle) * pitch_rate

    return Hidden(sample=sample)


def _displaced(ahead: float, up: float) -> Hidden:
    """What an IMU away from the centre of gravity feels, the body taken for level."""

    def feel(x, readings, plant):
        yaw, pitch = x[at.YAW_RATE], x[at.PITCH_RATE]
        yaw_acc, pitch_acc = readings[at.YAW_ACC], readings[at.PITCH_ACC]
        readings[at.A_X] -= ahead * (yaw * yaw + pitch * pitch) + up * pitch_acc
        readings[at.A_Y] += ahead * yaw_acc - 2.0 * up * pitch * yaw
        readings[at.A_Z] += ahead * pitch_acc - up * pitch * pitch

    return Hidden(feel=feel)


def _climbing(slope: float) -> Hidden:
    def force(x, plant):
        pull = -slope * plant.vehicle.m * GRAVITY
        return pull * math.cos(x[at.YAW]), -pull * math.sin(x[at.YAW]), 0.0

    return _pushed(force)


def _banked(slope: float) -> Hidden:
    def force(x, plant):
        pull = -slope * plant.vehicle.m * GRAVITY
        return pull * math.sin(x[at.YAW]), pull * math.cos(x[at.YAW]), 0.0

    return _pushed(force)


def _twisted(moment: float) -> Hidden:
    return _pushed(lambda x, plant: (0.0, 0.0, moment))


def _one_sided(share: float) -> Hidden:
    """Brake forces that are not the same left and right."""

    def force(x, plant):
        v = plant.vehicle
        more_left = 0.5 * share * x[at.BRAKE] / v.r * min(max(x[at.V_X] / 0.2, -1.0), 1.0)
        return 0.0, 0.0, 0.5 * v.track * more_left

    return _pushed(force)


def _at_wheels(force: Callable[[np.ndarray, Plant], tuple[float, float, float]]) -> Hidden:
    """Forces along and across each axle's wheels [N], and a torque that holds them [N m]."""

    def pushes(x, readings, plant):
        v, total = plant.vehicle, np.zeros(3)
        torques = []
        for axle, angle, arm in ((0, x[at.STEER], v.l_f), (at.AXLE, 0.0, -v.l_r)):
            along, across, torque = force(readings[axle : axle + at.AXLE], plant)
            left = along * math.sin(angle) + across * math.cos(angle)
            total += (along * math.cos(angle) - across * math.sin(angle), left, arm * left)
            torques.append(torque)
        return total, torques

    def kick(x, readings, plant, span):
        v = plant.vehicle
        (F_x, F_y, M_z), torques = pushes(x, readings, plant)
        x[at.V_X] += F_x / v.m * span
        x[at.V_Y] += F_y / v.m * span
        x[at.YAW_RATE] += M_z / v.I_z * span
        x[at.PITCH_RATE] += F_x * v.h_cg / v.I_y * span
        for i, torque in enumerate(torques):
            x[at.OMEGA_F + i] -= torque / (v.wheels_per_axle * v.I_w) * span

    def feel(x, readings, plant):
        v = plant.vehicle
        (F_x, F_y, M_z), _ = pushes(x, readings, plant)
        readings[at.A_X] += F_x / v.m
        readings[at.A_Y] += F_y / v.m
        readings[at.YAW_ACC] += M_z / v.I_z
        readings[at.PITCH_ACC] += F_x * v.h_cg / v.I_y

    return Hidden(kick=kick, feel=feel)


def _rutted(stress: float) -> Hidden:
    def force(axle, plant):
        rolling = min(max(axle[at.V_L] / 0.2, -1.0), 1.0)
        return -4.0 * stress * plant.vehicle.r * axle[at.SINKAGE] * rolling, 0.0, 0.0

    return _at_wheels(force)


def _ploughing(stress: float) -> Hidden:
    def force(axle, plant):
        area = 2.0 * plant.vehicle.wheels_per_axle * plant.vehicle.r * axle[at.SINKAGE]
        aside = axle[at.V_C] / math.hypot(axle[at.V_C], axle[at.V_L], 0.1)
        return 0.0, -stress * area * aside, 0.0

    return _at_wheels(force)


def _treaded(share: float) -> Hidden:
    def force(axle, plant):
        thrust = share * axle[at.N] * math.tanh(10.0 * axle[at.SLIP])
        return thrust, 0.0, thrust * plant.vehicle.r

    return _at_wheels(force)


def _growing(slope: float) -> Hidden:
    """Under each axle a disc of soil that moves with it, with the n that grows along x."""
    base: list[float] = []

    def step(x, readings, plant):
        if not base:
            base.append(plant.soil.n)
        axles = (readings[: at.AXLE], readings[at.AXLE : at.MOTION])
        places = [(axle[at.WHEEL_X], axle[at.WHEEL_Y]) for axle in axles]
        discs = np.array([(a, b, 0.5, base[0] + 0.01 * slope * (a - 80.0)) for a, b in places])
        return plant._replace(soil_map=SoilMap(0.3, discs))

    return Hidden(step=step)


def _hurried(slope: float) -> Hidden:
    """Soil that is the stiffer, the faster one drives."""
    base: list = []

    def step(x, readings, plant):
        if not base:
            base.append(plant.soil)
        more = 1.0 + slope * abs(x[at.V_X])
        return plant._replace(soil=base[0]._replace(k_c=more * base[0].k_c, k_phi=more * base[0].k_phi))

    return Hidden(step=step)


def _with_soil(change: Callable[..., dict[str, float]]) -> Callable[[float], Hidden]:
    """Another value in the soil's record: ``change`` makes it from the soil and the size."""

    def make(size: float) -> Hidden:
        def plant(plant: Plant) -> Plant:
            return plant._replace(soil=plant.soil._replace(**change(plant.soil, size)))

        return Hidden(plant=plant)

    return make


def _shifted(back: float) -> Hidden:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        return plant._replace(vehicle=v._replace(l_f=v.l_f + back, l_r=v.l_r - back))

    return Hidden(plant=plant)


def _told(x: np.ndarray, ahead: float = 0.0) -> np.ndarray:
    """What a receiver without noise says of a state, its antenna ``ahead`` of the centre [m], (4,)."""
    cos, sin = math.cos(x[at.YAW]), math.sin(x[at.YAW])
    along, across = x[at.V_X], x[at.V_Y] + ahead * x[at.YAW_RATE]
    course = x[at.YAW] + math.atan2(across, along)
    return np.array([x[at.X] + ahead * cos, x[at.Y] + ahead * sin, math.hypot(along, across), course])


def _tardy(delay: float) -> Hidden:
    """A receiver that tells of the past."""
    states: list[np.ndarray] = []

    def sample(sample):
        if states:
            place = max(len(states) - 1 - delay / TICK, 0.0)
            i = min(int(place), max(len(states) - 2, 0))
            before, after = _told(states[i]), _told(states[min(i + 1, len(states) - 1)])
            sample[GNSS] += before + (place - i) * (after - before) - _told(states[-1])

    return Hidden(feel=lambda x, readings, plant: states.append(x.copy()), sample=sample)


def _mounted(ahead: float) -> Hidden:
    """An antenna that is not at the centre of gravity."""
    now: list[np.ndarray] = []

    def feel(x, readings, plant):
        now[:] = [x.copy()]

    def sample(sample):
        if now:
            sample[GNSS] += _told(now[0], ahead) - _told(now[0])

    return Hidden(feel=feel, sample=sample)


#: Effect -> how to hide it, from its size. None of these uses the finder's own laws.
HIDERS: dict[str, Callable[[float], Hidden]] = {
    "steer_delay": _late,
    "steer_lag": _lagging,
    "clock_offset": _all_late,
    "steer_offset": _turned,
    "steer_gain": _scaled_steering,
    "torque_scale": _scaled_torque,
    "payload": _laden,
    "cg_shift": _shifted,
    "rolling_resistance": _resisting,
    "aero_drag": _dragging,
    "rut_drag": _rutted,
    "grade": _climbing,
    "bank": _banked,
    "yaw_moment": _twisted,
    "one_sided_brake": _one_sided,
    "slip_sinkage": _slipping,
    "rate_damping": _hurried,
    "bulldozing": _ploughing,
    "grouser_thrust": _treaded,
    "n_step": _bordered,
    "n_trend": _growing,
    "exit_angle": _with_soil(lambda soil, size: {"b_0": soil.b_0 + size}),
    "friction_angle": _with_soil(lambda soil, size: {"phi": soil.phi + size}),
    "shear_modulus": _with_soil(
        lambda soil, size: {"k_x": soil.k_x * (1.0 + size), "k_y": soil.k_y * (1.0 + size)}
    ),
    "accel_bias_x": _biased(0),
    "accel_bias_y": _biased(1),
    "accel_bias_z": _biased(2),
    "gyro_bias_pitch": _biased(3),
    "gyro_bias_yaw": _biased(4),
    "accel_scale": _stretched(slice(0, 3)),
    "wheel_radius_scale": _stretched(WHEEL),
    "imu_misalignment_pitch": _pitched,
    "imu_misalignment_roll": _rolled,
    "lever_arm_x": lambda distance: _displaced(distance, 0.0),
    "lever_arm_z": lambda distance: _displaced(0.0, distance),
    "pose_delay": _tardy,
    "antenna_x": _mounted,
}
#: What cannot be negative: nothing acts before it is asked to.
ONE_SIDED = ("steer_delay", "steer_lag", "clock_offset", "pose_delay")


# ------------------------------------------------------------------ what no library holds


def _overgrown(share: float) -> Hidden:
    """A patch of scrub that brakes whoever drives through it."""

    def force(x, plant):
        inside = 0.5 * (math.tanh((x[at.X] - 40.0) / 2.0) - math.tanh((x[at.X] - 70.0) / 2.0))
        return -share * plant.vehicle.m * GRAVITY * inside, 0.0, 0.0

    return _pushed(force)


def _roped(share: float) -> Hidden:
    """A rope to a post that pulls the more, the further the vehicle goes."""

    def force(x, plant):
        away = max(x[at.X] - 20.0, 0.0) / 50.0
        pull = -share * plant.vehicle.m * GRAVITY * away
        return pull * math.cos(x[at.YAW]), -pull * math.sin(x[at.YAW]), 0.0

    return _pushed(force)


def _blown(share: float) -> Hidden:
    """A side wind through the gaps of a hedge, behind the centre of gravity."""

    def force(x, plant):
        push = share * plant.vehicle.m * GRAVITY * math.sin(0.17 * x[at.X]) ** 2
        return push * math.sin(x[at.YAW]), push * math.cos(x[at.YAW]), -0.5 * push * math.cos(x[at.YAW])

    return _pushed(force)


def _engine(share: float) -> Hidden:
    """An engine that brakes when nobody asks it to drive."""

    def force(x, plant):
        idle = 1.0 - math.tanh(max(x[at.DRIVE], 0.0) / 600.0)
        return -share * plant.vehicle.m * GRAVITY * idle, 0.0, 0.0

    return _pushed(force)


#: Forces for which the library has no name, by their size as a share of the weight.
STRANGERS: dict[str, Callable[[float], Hidden]] = {
    "vegetation": _overgrown,
    "tow_rope": _roped,
    "side_wind": _blown,
    "engine_braking": _engine,
}
