"""Faults with the causes of effects of the library, but of another form; wrong numbers of a description.

A law of another form is what a user has: no vehicle follows the library's formula. A size means the same as
that of the effect at a usual speed, angle or slip. `FAMILIES` holds the effects that name each of them right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from estimators.discrepancy.faults.drive import TICK
from estimators.discrepancy.faults.forces import Push, body_force, wheel_forces
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.drive import Command, Faults
from offroad_env.simulation.simulator import Plant, settled_state
from offroad_env.world.terrain import flat

__all__ = ["FAMILIES", "OTHER_FORMS", "WRONG_NUMBERS"]

#: Usual speed [m/s], steering angle [rad], slip [-] and torque [N m], where a form agrees with the library's.
_SPEED, _ANGLE, _SLIP, _TORQUE = 4.5, 0.15, 0.1, 1500.0
_AIR = 1.2  #: density [kg/m^3]


def _servo(time: float) -> Faults:
    """Steering by a critically damped servo of the second order, with the mean delay of a lag of ``time``."""
    state = [0.0, 0.0, 0.0]

    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        if not state[2]:
            state[:] = [steer, 0.0, 1.0]
        rate = 2.0 / max(time, 1e-6)
        for _ in range(20):
            state[1] += TICK / 20.0 * (rate * rate * (steer - state[0]) - 2.0 * rate * state[1])
            state[0] += TICK / 20.0 * state[1]
        return state[0], drive, brake

    return Faults(command=command)


def _growing_gain(share: float) -> Faults:
    """A linkage whose ratio grows with the angle."""

    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        return steer * (1.0 + share * min(abs(steer) / _ANGLE, 2.0)), drive, brake

    return Faults(command=command)


def _growing_torque(share: float) -> Faults:
    """A drive that gives the more beyond the logged torque the larger this is; the brakes are as stated."""

    def command(past: list[Command]) -> Command:
        steer, drive, brake = past[-1]
        return steer, drive * (1.0 + share * (0.7 + 0.3 * drive / _TORQUE)), brake

    return Faults(command=command)


def _placed_payload(share: float) -> Faults:
    """A load above the rear axle: the inertias follow its place (Steiner), and the centre moves."""

    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        load, arm = share * v.m, 0.3 * v.l_r
        back = load * arm / (v.m + load)
        more = load * arm * arm * v.m / (v.m + load)
        changed = v._replace(
            m=v.m + load, I_z=v.I_z + more, I_y=v.I_y + more, l_f=v.l_f + back, l_r=v.l_r - back
        )
        return plant._replace(vehicle=changed)

    return Faults(plant=plant)


def _growing_resistance(share: float) -> Faults:
    """Rolling resistance that grows with the speed (Gillespie 1992, eq. 4-12 in its linear form)."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        held = math.copysign(min(abs(x[at.V_X]) / 0.2, 1.0), x[at.V_X])
        part = 0.7 + 0.3 * abs(x[at.V_X]) / _SPEED
        return -share * part * plant.vehicle.m * GRAVITY * held, 0.0, 0.0

    return body_force(force)


def _linear_drag(area: float) -> Faults:
    """Drag in proportion to the speed."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        return -0.5 * _AIR * area * _SPEED * x[at.V_X], 0.0, 0.0

    return body_force(force)


class _Usual:
    """Sinkage of the wheels at rest [m], where a law of the sinkage agrees with the library's."""

    def __init__(self) -> None:
        self._known: float | None = None

    def of(self, plant: Plant) -> float:
        """On the soil of this plant: all steps of a drive have the same."""
        if self._known is None:
            _, warm = settled_state(plant._replace(soil_field=None, ground=flat()))
            self._known = float(np.mean(warm[:, at.SINKAGE_ROW]))
        return self._known


def _deep_bulldozing(stress: float) -> Faults:
    """Bulldozing that grows with the square of the sinkage (Hegedus 1960)."""
    usual = _Usual()

    def force(axle: np.ndarray, plant: Plant) -> Push:
        depth = axle[at.SINKAGE]
        area = 2.0 * plant.vehicle.wheels_per_axle * plant.vehicle.r * depth * depth / usual.of(plant)
        aside = axle[at.V_C] / math.hypot(axle[at.V_C], axle[at.V_L], 0.1)
        return 0.0, -stress * area * aside, 0.0

    return wheel_forces(force)


def _saturating_thrust(share: float) -> Faults:
    """Thrust of a tread by a rational law of the slip."""

    def force(axle: np.ndarray, plant: Plant) -> Push:
        slip = axle[at.SLIP]
        thrust = share * axle[at.N] * 1.5 * slip / (abs(slip) + 0.5 * _SLIP)
        return thrust, 0.0, thrust * plant.vehicle.r

    return wheel_forces(force)


def _deep_rut_drag(stress: float) -> Faults:
    """Drag of rut walls that grows with the square of their depth."""
    usual = _Usual()

    def force(axle: np.ndarray, plant: Plant) -> Push:
        rolling, depth = min(max(axle[at.V_L] / 0.2, -1.0), 1.0), axle[at.SINKAGE]
        return -4.0 * stress * plant.vehicle.r * depth * depth / usual.of(plant) * rolling, 0.0, 0.0

    return wheel_forces(force)


#: Effect of the library -> a fault of the same cause and of another form, from a size of the effect.
OTHER_FORMS: Mapping[str, Callable[[float], Faults]] = MappingProxyType(
    {
        "steer_lag": _servo,
        "steer_gain": _growing_gain,
        "torque_scale": _growing_torque,
        "payload": _placed_payload,
        "rolling_resistance": _growing_resistance,
        "aero_drag": _linear_drag,
        "bulldozing": _deep_bulldozing,
        "grouser_thrust": _saturating_thrust,
        "rut_drag": _deep_rut_drag,
    }
)


def _of_soil(factor: float, *fields: str) -> Faults:
    def plant(plant: Plant) -> Plant:
        return plant._replace(
            soil=plant.soil._replace(**{name: factor * getattr(plant.soil, name) for name in fields})
        )

    return Faults(plant=plant)


def _of_vehicle(factor: float, *fields: str) -> Faults:
    def plant(plant: Plant) -> Plant:
        changed = {name: factor * getattr(plant.vehicle, name) for name in fields}
        return plant._replace(vehicle=plant.vehicle._replace(**changed))

    return Faults(plant=plant)


#: Number of a description that is wrong -> the fault.
WRONG_NUMBERS: Mapping[str, Faults] = MappingProxyType(
    {
        "c x 0.6": _of_soil(0.6, "c"),
        "c x 1.5": _of_soil(1.5, "c"),
        "k x 1.3": _of_soil(1.3, "k_c", "k_phi"),
        "I_z + 10 %": _of_vehicle(1.1, "I_z"),
        "h_cg + 10 %": _of_vehicle(1.1, "h_cg"),
        "springs + 20 %": _of_vehicle(1.2, "k_f", "k_r"),
    }
)

#: Fault -> effects that name its cause.
FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "steer_lag": ("steer_lag", "steer_delay"),
        "steer_gain": ("steer_gain",),
        "torque_scale": ("torque_scale", "drive_scale"),
        "payload": ("payload", "placed_payload", "cg_shift", "inertia"),
        "rolling_resistance": ("rolling_resistance", "aero_drag", "rut_drag"),
        "aero_drag": ("aero_drag", "rolling_resistance"),
        "bulldozing": ("bulldozing",),
        "grouser_thrust": ("grouser_thrust",),
        "rut_drag": ("rut_drag", "rolling_resistance"),
        "c x 0.6": ("cohesion",),
        "c x 1.5": ("cohesion",),
        "k x 1.3": ("rate_damping",),
        "I_z + 10 %": ("inertia",),
        "h_cg + 10 %": ("cg_height",),
        "springs + 20 %": ("spring_rate",),
    }
)
