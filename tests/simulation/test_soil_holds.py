"""What the soil holds: limits of a vehicle at static loads, from the contact of the models themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.controllers.traction_limits import soil_capability
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.simulation.soil_holds import SoilHolds, soils_hold, what_soil_holds
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, soil_map
from offroad_env.world.vehicles import VEHICLES, make_vehicle

_CAR = VEHICLES["mrzr"]
#: No drag of air and bearings.
_IDEAL = make_vehicle(_CAR, drag_area=0.0, rolling_resistance=0.0)
_SAND = SOILS["dry_sand"]


def _holds(soil=_SAND, vehicle=_CAR, **options) -> SoilHolds:
    return what_soil_holds(make_plant(vehicle, soil, flat(), **options))


def test_on_hard_ground_friction_is_the_limit() -> None:
    ground = SOILS["hard_ground"]
    held, limit = _holds(ground), ground.mu * GRAVITY
    assert 0.99 * limit < held.lateral <= limit
    assert 0.99 * limit < held.pull / _CAR.m <= limit
    assert held.stopping == pytest.approx(25.0 / (2.0 * limit), rel=0.01)
    assert held.resistance == pytest.approx(0.0, abs=1e-6)
    assert held.sinkage == 0.0


@pytest.mark.parametrize("structure", [None, "grid"])
def test_a_vehicle_that_coasts_decelerates_by_the_rolling_resistance(structure: str | None) -> None:
    plant = make_plant(_IDEAL, _SAND, flat(), structure=structure)
    state, warm = settled_state(plant, v_x=5.0)
    coasting = simulate_commands(plant, state, warm, np.zeros((2, 3)))
    force = -_IDEAL.m * coasting.readings[0, at.A_X]
    assert what_soil_holds(plant).resistance == pytest.approx(force, rel=1e-3)
    deepest = max(coasting.readings[0, [at.SINKAGE, at.AXLE + at.SINKAGE]])
    assert what_soil_holds(plant).sinkage == pytest.approx(deepest, rel=1e-3)


@pytest.mark.parametrize("name", ["dry_sand", "lete_sand"])
def test_the_limits_are_those_of_the_single_wheel(name: str) -> None:
    """The tables of the controllers are made by `wheel_forces`, from another search."""
    soil = SOILS[name]
    limits = soil_capability(_CAR, soil, (soil.n, soil.n + 0.001))
    held = _holds(soil)
    assert held.lateral == pytest.approx(limits.lateral_limit(soil.n, soil.n, math.radians(15.0)), rel=5e-3)
    slips = np.flatnonzero(limits.slips <= 0.5)
    assert held.pull / _CAR.m == pytest.approx(limits.pull[0, slips].max(), rel=5e-3)


def test_the_best_slip_is_inside_where_wheels_dig_themselves_in() -> None:
    held = _holds(make_soil(_SAND, phi=0.4))
    slips = np.linspace(held.pull_slip - 0.05, held.pull_slip + 0.05, 3)
    assert 0.05 < slips[0] < slips[2] < 0.5
    limits = soil_capability(_CAR, make_soil(_SAND, phi=0.4), (_SAND.n, _SAND.n + 0.001))
    pull = np.interp(slips, limits.slips, limits.pull[0])
    assert pull[1] > max(pull[0], pull[2])


@pytest.mark.parametrize(
    ("change", "better"),
    [({"phi": 1.15}, True), ({"c": 3.0}, True), ({"k_x": 2.0, "k_y": 2.0}, False)],
)
@pytest.mark.parametrize("structure", [None, "field"])
def test_stronger_soil_holds_more(change: dict[str, float], better: bool, structure: str | None) -> None:
    other = make_soil(_SAND, **{name: factor * getattr(_SAND, name) for name, factor in change.items()})
    one, two = _holds(structure=structure), _holds(other, structure=structure)
    if not better:
        one, two = two, one
    assert two.lateral > one.lateral
    assert two.pull > one.pull
    assert two.stopping < one.stopping


def test_a_larger_modulus_means_less_sinkage_and_resistance() -> None:
    soft, firm = _holds(), _holds(make_soil(_SAND, k_phi=2.0 * _SAND.k_phi))
    assert firm.sinkage < 0.7 * soft.sinkage
    assert firm.resistance < 0.85 * soft.resistance


def test_rear_wheels_in_the_ruts_of_the_front_ones_roll_more_easily() -> None:
    virgin, rutted = _holds(structure="grid,ruts=none"), _holds(structure="grid")
    assert rutted.resistance < 0.9 * virgin.resistance
    # In a bend they run beside the ruts.
    assert rutted.lateral == pytest.approx(virgin.lateral, rel=1e-9)


def test_one_driven_axle_pulls_less_and_one_braked_axle_stops_later() -> None:
    both, front = _holds(), _holds(vehicle=make_vehicle(_CAR, drive_front=1.0, brake_front=1.0))
    assert front.pull < 0.8 * both.pull
    assert front.stopping > 1.1 * both.stopping


@pytest.mark.check
def test_four_wheels_hold_what_the_half_car_holds() -> None:
    for structure in (None, "grid"):
        four = _holds(structure=structure, vehicle_model="four_wheel")
        assert four == pytest.approx(_holds(structure=structure), rel=1e-6)


def test_soil_that_does_not_carry_the_vehicle_holds_nothing() -> None:
    held = _holds(make_soil(_SAND, k_phi=0.02 * _SAND.k_phi))
    assert not held.carried
    assert all(math.isnan(value) for value in held)


def test_the_soil_is_that_of_the_place() -> None:
    soft = soil_map([(10.0, 0.0, 5.0, 1.0)])
    plant = make_plant(_CAR, make_soil(_SAND, n=1.2), flat(), soil_map=soft)
    assert what_soil_holds(plant, x=10.0) == pytest.approx(_holds(make_soil(_SAND, n=1.0)), rel=1e-9)
    assert what_soil_holds(plant, x=30.0) == pytest.approx(_holds(make_soil(_SAND, n=1.2)), rel=1e-9)


def test_samples_of_a_belief_are_taken_one_by_one_and_every_number_is_continuous() -> None:
    prior, rng = SoilPrior.fitted(), np.random.default_rng(3)
    plant = make_plant(_CAR, _SAND, flat())
    soils = [prior.sample(rng) for _ in range(40)]
    rows = soils_hold(plant, soils)
    alone = [what_soil_holds(plant._replace(soil=soil)) for soil in soils]
    np.testing.assert_array_equal(rows, np.array(alone))
    near = soils_hold(plant, [soil._replace(phi=soil.phi + 1e-6, n=soil.n + 1e-6) for soil in soils])
    carried = np.isfinite(rows).all(axis=1)
    assert carried.sum() > 20
    # The best slip alone may lie on a flat top; values change with the soil by as little as it does.
    others = [0, 1, 3, 4, 5]
    scale = np.maximum(np.abs(rows[carried][:, others]), [0.1, 100.0, 100.0, 0.01, 0.1])
    assert np.abs(near[carried][:, others] / scale - rows[carried][:, others] / scale).max() < 1e-3
