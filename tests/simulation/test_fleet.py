"""Fleets: the same physics as one vehicle at a time, whatever the division of the work."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.effects import Setup, apply
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.simulation.fleet import make_fleet, simulate_fleet, simulate_fleet_commands, vary
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate, simulate_commands
from offroad_env.world.natural_soil import natural_soil
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES

CAR = VEHICLES["mrzr"]
EXPONENTS = np.linspace(0.4, 0.9, 5)


def plants(model: str, ground=None) -> list:
    """One plant for each sinkage exponent."""
    ground = paper_terrain(0.05) if ground is None else ground
    soils = [make_soil(SOILS["clay"], n=float(n)) for n in EXPONENTS]
    return [make_plant(CAR, soil, ground, model=model, slip=0.03) for soil in soils]


def laden(plant):
    """The same plant, held back by a force that the base model does not know."""
    setup = Setup(plant=plant, mount=ImuConfig().mount())
    return apply(setup, [("rolling_resistance", {"share": 0.05})]).plant


def starts(some: list) -> tuple[np.ndarray, np.ndarray]:
    """Settled states and warm starts of all."""
    settled = [settled_state(plant, v_x=4.0) for plant in some]
    return np.stack([state for state, _ in settled]), np.stack([warm for _, warm in settled])


def commands(count: int) -> np.ndarray:
    """Different commands for each vehicle, 0.4 s long."""
    rng = np.random.default_rng(1)
    low, high = [-0.2, 0.0, 0.0], [0.2, 800.0, 200.0]
    return rng.uniform(low, high, (count, 20, 3))


def test_a_fleet_of_the_full_model_is_its_vehicles_one_by_one():
    some = plants("full")
    states, warm = starts(some)
    held = commands(len(some))
    run = simulate_fleet_commands(make_fleet(some), states, warm, held, threads=2)
    assert (run.done == 20).all()
    for i, plant in enumerate(some):
        alone = simulate_commands(plant, states[i], warm[i], held[i])
        # The same kernels, translated for another caller: rounding may differ, nothing else.
        np.testing.assert_allclose(run.states[:, i], alone.states, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(run.readings[:, i, at.N], alone.readings[:, at.N], rtol=1e-9)
        assert run.status[i] == alone.status


@pytest.mark.check
@pytest.mark.parametrize("vehicle_model", ["half_car", "four_wheel"])
def test_a_fleet_on_tyres_and_natural_soil_is_its_vehicles_one_by_one(vehicle_model):
    """Everything at once: laws, tyre, natural soil, four wheels."""
    some = []
    for n in EXPONENTS[:3]:
        soil = make_soil(SOILS["sandy_loam"], n=float(n))
        options = {"structure": "grid", "tyre": "mrzr", "soil_field": natural_soil(soil, 3)}
        some.append(make_plant(CAR, soil, paper_terrain(0.02), vehicle_model=vehicle_model, **options))
    states, warm = starts(some)
    held = commands(len(some))
    run = simulate_fleet_commands(make_fleet(some), states, warm, held, threads=2)
    shared = simulate_fleet_commands(make_fleet(some), states, warm, held, threads=1)
    np.testing.assert_array_equal(run.states, shared.states)
    for i, plant in enumerate(some):
        alone = simulate_commands(plant, states[i], warm[i], held[i])
        np.testing.assert_allclose(run.states[:, i], alone.states, rtol=1e-9, atol=1e-9)
        assert run.status[i] == alone.status


def test_a_fleet_of_the_papers_model_is_its_vehicles_one_by_one():
    some = plants("paper")
    states, warm = starts(some)
    t = 0.005 * np.arange(2 * 40 + 1)
    force = CAR.m * (0.8 + 0.5 * np.sin(0.8 * t))
    inputs = np.stack([0.3 * np.sin(t), force, np.full(t.shape, np.nan)], axis=1)
    run = simulate_fleet(make_fleet(some), states, warm, inputs)
    for i, plant in enumerate(some):
        alone = simulate(
            plant,
            states[i],
            warm[i],
            steer=lambda time: 0.3 * math.sin(time),
            force=lambda time: CAR.m * (0.8 + 0.5 * math.sin(0.8 * time)),
            duration=0.4,
        )
        np.testing.assert_allclose(run.states[:, i], alone.states, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(run.readings[:, i, at.N], alone.readings[:, at.N], rtol=1e-9)


def test_neither_threads_nor_neighbours_nor_what_is_kept_change_a_bit():
    some = plants("full")
    states, warm = starts(some)
    held = commands(len(some))
    fleet = make_fleet(some)
    one = simulate_fleet_commands(fleet, states, warm, held, threads=1)
    for threads in (2, 3, 8):
        many = simulate_fleet_commands(fleet, states, warm, held, threads=threads)
        np.testing.assert_array_equal(many.states, one.states)
    end = simulate_fleet_commands(fleet, states, warm, held, every=False)
    np.testing.assert_array_equal(end.states[0], one.states[-1])
    np.testing.assert_array_equal(end.readings[0], one.readings[-1])
    pair = simulate_fleet_commands(make_fleet(some[1:3]), states[1:3], warm[1:3], held[1:3])
    np.testing.assert_array_equal(pair.states, one.states[:, 1:3])


def test_varied_columns_are_plants_of_their_own():
    base = plants("full")[0]
    masses = CAR.m * np.linspace(0.9, 1.1, len(EXPONENTS))
    varied = vary(base, {"n": EXPONENTS, "m": masses})
    written = [
        base._replace(soil=base.soil._replace(n=float(n)), vehicle=CAR._replace(m=float(m)))
        for n, m in zip(EXPONENTS, masses, strict=True)
    ]
    np.testing.assert_array_equal(varied.packed.numbers, make_fleet(written).packed.numbers)


def test_a_vehicle_that_drowns_stops_alone():
    base = make_plant(CAR, SOILS["clay"], flat())
    state, warm = settled_state(base, v_x=4.0)
    fleet = vary(base, {"n": np.array([base.soil.n, 2.4, base.soil.n])})
    run = simulate_fleet_commands(fleet, state, warm, np.tile([0.0, 300.0, 0.0], (10, 1)))
    assert run.status[1] >= SUNK
    assert run.done[1] < 10
    assert np.isnan(run.states[-1, 1]).all()
    assert (run.done[[0, 2]] == 10).all()
    assert np.isfinite(run.states[:, [0, 2]]).all()
    np.testing.assert_array_equal(run.states[:, 0], run.states[:, 2])


def test_a_vehicle_of_a_fleet_takes_less_than_four_kilobytes():
    some = plants("full")
    states, warm = starts(some)
    fleet = make_fleet(some)
    run = simulate_fleet_commands(fleet, states, warm, commands(len(some)), every=False)
    held = (fleet.packed.numbers, states, warm, run.states, run.readings, run.status, run.done)
    assert sum(array.nbytes for array in held) / len(fleet) < 4096


def test_a_fleet_carries_effects():
    some = [laden(plant) for plant in plants("full")[:2]]
    states, warm = starts(some)
    held = commands(len(some))
    run = simulate_fleet_commands(make_fleet(some), states, warm, held, threads=1)
    for i, plant in enumerate(some):
        alone = simulate_commands(plant, states[i], warm[i], held[i])
        np.testing.assert_allclose(run.states[:, i], alone.states, rtol=1e-9, atol=1e-10)
    plain = simulate_fleet_commands(make_fleet(plants("full")[:2]), states, warm, held, threads=1)
    assert np.max(np.abs(run.states - plain.states)) > 1e-3


def test_impossible_fleets_are_refused_with_the_reason():
    some = plants("full")
    with pytest.raises(InvalidParameter, match="at least one plant"):
        make_fleet([])
    with pytest.raises(InvalidParameter, match="all full or all paper"):
        make_fleet([some[0], plants("paper")[0]])
    with pytest.raises(InvalidParameter, match="share ground waves"):
        make_fleet([some[0], plants("full", flat())[0]])
    with pytest.raises(InvalidParameter, match="share their effects"):
        make_fleet([some[0], laden(some[1])])
    with pytest.raises(InvalidParameter, match="unknown fields: speed"):
        vary(some[0], {"speed": EXPONENTS})
    with pytest.raises(InvalidParameter, match="one N"):
        vary(some[0], {"n": EXPONENTS, "m": np.ones(2)})
    states, warm = starts(some)
    with pytest.raises(InvalidParameter, match="commands must be"):
        simulate_fleet_commands(make_fleet(some), states, warm, np.zeros((2, 20, 3)))
    with pytest.raises(InvalidParameter, match="states must be"):
        simulate_fleet_commands(make_fleet(some), states[:2], warm, np.zeros((20, 3)))
    with pytest.raises(InvalidParameter, match="half step"):
        simulate_fleet(make_fleet(plants("paper")), states, warm, np.zeros((20, 3)))
