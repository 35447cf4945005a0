"""A wheel with a flexible tyre on soil: against an independent evaluation, and at its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from physics.tyre_reference import tyre_forces

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import CONTACT, Support, slope_frame
from offroad_env.physics.records import ContactOptions, Soil, WheelMotion
from offroad_env.physics.structured_contact import solve_structured_contact
from offroad_env.physics.tyre import hard_ground_deflection, tread_stiffness, tyre_load, tyre_on_soil
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.structures import make_structure
from offroad_env.world.terrain import flat
from offroad_env.world.tyres import TYRES, make_tyre, with_tyre
from offroad_env.world.vehicles import VEHICLES, make_wheel

MRZR = TYRES["mrzr"]
WHEEL = make_wheel(r=MRZR.r, b=MRZR.b)
LOAD = 3400.0
TEN_DEGREES = math.radians(10.0)
SINGLE = "grid,width=rim"


@pytest.mark.parametrize("soil", ["dry_sand", "clay"])
@pytest.mark.parametrize("inflation", [60e3, 150e3, 1e6])
@pytest.mark.parametrize(("slip", "slip_angle"), [(0.0, 0.17), (0.15, 0.05), (-0.05, 0.2)])
def test_forces_are_those_of_the_independent_evaluation(
    soil: str, inflation: float, slip: float, slip_angle: float
) -> None:
    """Its grid of 3000 points errs by some 1e-5 of the load."""
    tyre = make_tyre(MRZR, inflation=inflation)
    found = wheel_forces(
        SOILS[soil], WHEEL, load=LOAD, slip=slip, slip_angle=slip_angle, structure=SINGLE, tyre=tyre
    )
    expected = tyre_forces(SOILS[soil], WHEEL, tyre, LOAD, slip, slip_angle)
    for name in ("F_x", "F_y", "F_z"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-4 * LOAD), name
    assert found.torque == pytest.approx(expected.torque, abs=1e-4 * LOAD * WHEEL.r)
    assert found.sinkage == pytest.approx(expected.sinkage, rel=1e-4)
    assert found.deflection == pytest.approx(expected.deflection, rel=1e-6)


def _sand(pressure: float, n: float) -> Soil:
    """Sand with this pressure [Pa] at 5 cm."""
    return make_soil("dry_sand", k_c=0.0, k_phi=pressure / 0.05**n, n=n)


@pytest.mark.parametrize("n", [0.6, 0.8, 1.1])
@pytest.mark.parametrize("inflation", [100e3, 150e3])
def test_side_force_of_a_tyre_does_not_fall_as_sand_becomes_firmer_and_that_of_a_rigid_rim_does(
    n: float, inflation: float
) -> None:
    soils = [_sand(pressure, n) for pressure in np.geomspace(50e3, 800e3, 6)]
    tyre = make_tyre(MRZR, inflation=inflation)
    rigid, flexible = (
        np.array(
            [
                -wheel_forces(
                    soil, WHEEL, load=LOAD, slip=0.0, slip_angle=TEN_DEGREES, structure="grid", tyre=one
                ).F_y
                for soil in soils
            ]
        )
        for one in (None, tyre)
    )
    assert np.all(np.diff(rigid) < 0.0)
    assert np.all(np.diff(flexible) > -1e-3 * LOAD)
    assert flexible[-1] > 1.05 * flexible[0]


@pytest.mark.parametrize("soil", ["dry_sand", "clay", "lete_sand"])
def test_a_tyre_at_ten_megapascals_is_a_rigid_wheel_within_one_per_cent(soil: str) -> None:
    slip, slip_angle = np.array([0.0, 0.2, -0.1]), np.array([TEN_DEGREES, 0.05, 0.1])
    rigid, hard = (
        wheel_forces(
            SOILS[soil], WHEEL, load=LOAD, slip=slip, slip_angle=slip_angle, structure="grid", tyre=tyre
        )
        for tyre in (None, make_tyre(MRZR, inflation=10e6))
    )
    for name in ("F_x", "F_y", "torque"):
        assert np.abs(getattr(hard, name) - getattr(rigid, name)).max() < 0.01 * LOAD, name
    assert hard.sinkage == pytest.approx(rigid.sinkage, rel=0.01)


def _brush(tan_slip: float) -> float:
    """Side force of the brush model with a parabola of pressure (Pacejka, Tire and Vehicle Dynamics, 3.2)."""
    f = hard_ground_deflection(MRZR, LOAD)
    half = math.sqrt(2.0 * WHEEL.r * f)
    stiffness = tread_stiffness(MRZR, WHEEL.r, WHEEL.b, LOAD, f)
    share = min(2.0 * stiffness * WHEEL.b * half**2 * tan_slip / (3.0 * MRZR.mu * LOAD), 1.0)
    return MRZR.mu * LOAD * (3.0 * share - 3.0 * share**2 + share**3)


@pytest.mark.parametrize("degrees", [0.5, 2.0, 5.0, 12.0])
def test_side_force_on_firm_ground_is_that_of_the_brush_model_within_one_per_cent(degrees: float) -> None:
    """Stiff as a gravel road, n = 1 (whose elastic pressure is a parabola), stronger than rubber."""
    firm = make_soil("clay", k_c=0.0, k_phi=1e9, n=1.0, c=0.0, phi=math.radians(55.0))
    found = wheel_forces(
        firm, WHEEL, load=LOAD, slip=0.0, slip_angle=math.radians(degrees), structure="grid", tyre=MRZR
    )
    assert -found.F_y == pytest.approx(_brush(math.tan(math.radians(degrees))), rel=0.01)
    assert found.deflection == pytest.approx(hard_ground_deflection(MRZR, LOAD), rel=1e-3)


def test_less_pressure_means_less_sinkage_and_resistance_and_more_pull() -> None:
    found = [
        wheel_forces(
            SOILS["dry_sand"],
            WHEEL,
            load=LOAD,
            slip=[0.0, 0.2],
            structure="grid",
            tyre=make_tyre(MRZR, inflation=pressure),
        )
        for pressure in np.geomspace(80e3, 800e3, 6)
    ]
    assert np.all(np.diff([one.sinkage[0] for one in found]) > 0.0)
    assert np.all(np.diff([one.F_x[0] for one in found]) < 0.0)
    assert np.all(np.diff([one.F_x[1] for one in found]) < 0.0)


def test_load_and_sinkage_ask_the_same_question() -> None:
    by_load = wheel_forces(SOILS["clay"], WHEEL, load=LOAD, slip=0.1, structure="grid", tyre=MRZR)
    again = wheel_forces(SOILS["clay"], WHEEL, sinkage=by_load.sinkage, slip=0.1, structure="grid", tyre=MRZR)
    assert np.array(again) == pytest.approx(np.array(by_load), rel=1e-6)


def test_a_warm_start_leaves_no_trace_and_the_fast_rule_errs_by_a_thousandth_of_the_load() -> None:
    structure = with_tyre(make_structure("grid"), MRZR)
    frame, motion = slope_frame(0.05, -0.03), WheelMotion(4.3, 4.0, 0.3)
    warm = np.zeros(at.STRUCTURED_CONTACT_SIZE)
    for soil in (SOILS["clay"], SOILS["dry_sand"]):
        warm[:] = 0.0
        for load in 6800.0 * (1.0 + 0.1 * np.sin(0.3 * np.arange(30))):
            support = Support(load, 3e4, 2.0)
            cold = np.zeros(at.STRUCTURED_CONTACT_SIZE)
            options = ContactOptions(0.2, 1.0, False)
            remembered = solve_structured_contact(
                structure, soil, WHEEL, motion, frame, support, warm, options
            )
            fresh = solve_structured_contact(structure, soil, WHEEL, motion, frame, support, cold, options)
            assert np.array(remembered) == pytest.approx(np.array(fresh), rel=1e-6, abs=5e-7 * load)
        fine = solve_structured_contact(
            structure, soil, WHEEL, motion, frame, support, cold, ContactOptions(0.2, 1.0, True)
        )
        assert np.array(fine) == pytest.approx(np.array(fresh), abs=1e-3 * load)


@pytest.mark.parametrize("soil", ["heavy_clay", "lean_clay"])
def test_a_tyre_on_clay_that_hardly_yields_carries_its_load_however_little_it_sinks(soil: str) -> None:
    """Down to picometres: the belt is then all but flat, and angles of a billionth of a radian count."""
    rng, smallest = np.random.default_rng(4), 1.0
    frame, options = slope_frame(0.01, -0.02), ContactOptions(0.2, 1.0, False)
    for _ in range(300):
        structure = with_tyre(
            make_structure("field"), make_tyre(MRZR, inflation=10.0 ** rng.uniform(4.9, 5.8))
        )
        row = np.zeros(at.STRUCTURED_CONTACT_SIZE)
        row[at.RUT_SHARE], row[at.RUT_DEPTH] = rng.uniform(), 10.0 ** rng.uniform(-20.0, -2.0)
        load, v = 10.0 ** rng.uniform(1.5, 4.0), rng.uniform(-10.0, 10.0)
        motion, support = WheelMotion(1.02 * v, v, 0.05), Support(load, 0.0, 1.0)
        found = solve_structured_contact(structure, SOILS[soil], WHEEL, motion, frame, support, row, options)
        borne = found.F_l * frame.l_z + found.F_c * frame.c_z + found.F_n * frame.n_z
        assert found.status == CONTACT, (load, row[at.RUT_SHARE], row[at.RUT_DEPTH])
        assert borne == pytest.approx(load, rel=1e-6)
        smallest = min(smallest, found.sinkage)
    assert smallest < 1e-8


def test_a_tyre_that_all_but_lifts_off_snow_carries_what_is_left() -> None:
    """Its spring lets go within the sinkage: the load falls to nothing from one chord to the next."""
    rng = np.random.default_rng(1)
    frame, options = slope_frame(0.01, -0.02), ContactOptions(0.2, 1.0, False)
    structure = with_tyre(make_structure("field"), MRZR)
    row = np.zeros(at.STRUCTURED_CONTACT_SIZE)
    for i in range(300):
        if i % 3 == 0:
            row[:] = 0.0
        support, v = Support(rng.uniform(30.0, 110.0), 3e4, 2.0), rng.uniform(-5.0, 5.0)
        motion = WheelMotion(1.02 * v, v, 0.05)
        found = solve_structured_contact(
            structure, SOILS["snow"], WHEEL, motion, frame, support, row, options
        )
        borne = found.F_l * frame.l_z + found.F_c * frame.c_z + found.F_n * frame.n_z
        assert found.status == CONTACT, support
        assert 0.0 < borne <= support.N_0 - support.k * found.sinkage


def test_a_tyre_on_a_bump_stop_carries_what_spring_and_deflection_leave() -> None:
    """A stop ten times as stiff as the spring: a hundredth of a millimetre is a per cent of the load."""
    rng, soil = np.random.default_rng(2), SOILS["clay"]
    frame, options = slope_frame(0.0, 0.0), ContactOptions(0.2, 1.0, False)
    structure = with_tyre(make_structure("grid"), MRZR)
    on_soil, row = tyre_on_soil(MRZR, soil, WHEEL), np.zeros(at.STRUCTURED_CONTACT_SIZE)
    for i in range(300):
        if i % 10 == 0:
            row[:] = 0.0
            k, load, v = rng.uniform(2e5, 1e6), rng.uniform(1e3, 6e3), rng.uniform(-5.0, 5.0)
            N_0 = load + k * rng.uniform(0.01, 0.05)
        N_0 += 0.01 * load * rng.normal()
        motion = WheelMotion((1.0 + 0.1 * rng.normal()) * v, v, 0.05)
        found = solve_structured_contact(
            structure, soil, WHEEL, motion, frame, Support(N_0, k, 1.0), row, options
        )
        left = tyre_load(on_soil, N_0 - k * found.sinkage, k).load
        assert found.status == CONTACT
        assert found.F_n == pytest.approx(left, rel=1e-5)


def test_a_wheel_and_its_mirror_image_feel_mirrored_forces() -> None:
    left, right = (
        wheel_forces(SOILS["clay"], WHEEL, load=LOAD, slip=0.05, slip_angle=a, structure="grid", tyre=MRZR)
        for a in (0.1, -0.1)
    )
    assert left.F_y == -right.F_y
    assert (left.F_x, left.torque) == (right.F_x, right.torque)


@pytest.mark.parametrize(
    ("structure", "says"),
    [
        (None, "ground"),
        ("full", "pressure_direction"),
        ("full,pressure_direction=ground_normal", "pressure_from"),
        ("grid,grouser_height=0.01", "grousers"),
    ],
)
def test_structures_without_room_for_a_tyre_are_refused_by_name(structure: str | None, says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        wheel_forces(SOILS["clay"], WHEEL, load=LOAD, slip=0.0, structure=structure, tyre="mrzr")
    with pytest.raises(InvalidParameter, match=says):
        make_plant(VEHICLES["mrzr"], SOILS["clay"], flat(), structure=structure, tyre="mrzr")


@pytest.mark.check
@pytest.mark.parametrize("soil", ["clay", "dry_sand", "hard_ground"])
def test_a_vehicle_on_tyres_settles_by_their_deflection_and_stays_there(soil: str) -> None:
    plant = make_plant(VEHICLES["mrzr"], SOILS[soil], flat(), structure="grid", tyre="mrzr")
    state, warm = settled_state(plant, v_x=3.0)
    run = simulate_commands(plant, state, warm, np.zeros((10, 3)))
    heights = run.states[:, at.Z]
    assert heights == pytest.approx(state[at.Z], abs=2e-3)
    assert state[at.Z] < -0.01
