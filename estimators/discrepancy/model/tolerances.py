"""Numbers of vehicle and soil that are stated to a tolerance: nuisances in standard deviations of each."""

from __future__ import annotations

import math
from collections.abc import Callable

from estimators.discrepancy.model.protocol import ForwardModel, Nuisance
from estimators.logs.tolerances import TOLERANCES
from offroad_env.effects import Setup

__all__ = ["TOLERATED"]

#: Of the finite differences [standard deviations].
_STEP = 0.05

_Change = Callable[[Setup, ForwardModel, float], Setup]


def _vehicle(tolerance: str, *fields: str) -> _Change:
    """Fields of the vehicle that err by one factor."""

    def change(setup: Setup, run: ForwardModel, value: float) -> Setup:
        factor, vehicle = math.exp(TOLERANCES[tolerance] * value), setup.plant.vehicle
        return setup.with_vehicle(**{name: factor * getattr(vehicle, name) for name in fields})

    return change


def _soil(tolerance: str, *fields: str) -> _Change:
    """Fields of the soil that err by one factor."""

    def change(setup: Setup, run: ForwardModel, value: float) -> Setup:
        factor, soil = math.exp(TOLERANCES[tolerance] * value), setup.plant.soil
        return setup.with_soil(**{name: factor * getattr(soil, name) for name in fields})

    return change


def _balance_of_mass(setup: Setup, run: ForwardModel, value: float) -> Setup:
    vehicle = setup.plant.vehicle
    back = TOLERANCES["cg"] * value * (vehicle.l_f + vehicle.l_r)
    back = min(max(back, -0.9 * vehicle.l_f), 0.9 * vehicle.l_r)
    return setup.with_vehicle(l_f=vehicle.l_f + back, l_r=vehicle.l_r - back)


def _strength(setup: Setup, run: ForwardModel, value: float) -> Setup:
    slope = math.tan(setup.plant.soil.phi) * math.exp(TOLERANCES["tan_phi"] * value)
    return setup.with_soil(phi=math.atan(slope))


def _angles(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return setup.with_soil(b_0=setup.plant.soil.b_0 + TOLERANCES["angles"] * value)


def _spin_inertia(setup: Setup, run: ForwardModel, value: float) -> Setup:
    # Wheels that turn as measured have no inertia that acts.
    return _vehicle("I_w", "I_w")(setup, run, value) if run.driven else setup


def _of_vehicle(name: str, change: _Change, *, pitching: bool = False, effect: str = "") -> Nuisance:
    return Nuisance(
        name=name, change=change, spread=1.0, step=_STEP, pitching=pitching, tolerated=True, effect=effect
    )


def _of_soil(name: str, change: _Change, *, effect: str = "") -> Nuisance:
    return Nuisance(
        name=name, change=change, spread=1.0, step=_STEP, soft=True, tolerated=True, effect=effect
    )


#: In standard deviations. What lies far beyond is an effect of the library: a payload for the mass,
#: `friction_angle` for tan(phi), and so on.
TOLERATED = (
    _of_vehicle("mass", _vehicle("m", "m"), effect="payload"),
    _of_vehicle("inertia_z", _vehicle("I_z", "I_z"), effect="inertia"),
    _of_vehicle("inertia_y", _vehicle("I_y", "I_y"), pitching=True),
    _of_vehicle("cg_height", _vehicle("h_cg", "h_cg"), pitching=True, effect="cg_height"),
    _of_vehicle("cg_place", _balance_of_mass, effect="cg_shift"),
    _of_vehicle("springs_f", _vehicle("springs", "k_f"), pitching=True, effect="spring_rate"),
    _of_vehicle("springs_r", _vehicle("springs", "k_r"), pitching=True, effect="spring_rate"),
    _of_vehicle("dampers_f", _vehicle("dampers", "c_f"), pitching=True),
    _of_vehicle("dampers_r", _vehicle("dampers", "c_r"), pitching=True),
    _of_vehicle("radius", _vehicle("r", "r"), effect="wheel_radius_scale"),
    _of_vehicle("spin_inertia", _spin_inertia),
    _of_soil("moduli", _soil("k", "k_c", "k_phi")),
    _of_soil("cohesion", _soil("c", "c"), effect="cohesion"),
    _of_soil("strength", _strength, effect="friction_angle"),
    _of_soil("shear_moduli", _soil("K", "k_x", "k_y"), effect="shear_modulus"),
    _of_soil("exit_angle", _angles, effect="exit_angle"),
)
