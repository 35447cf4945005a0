"""Soils and vehicles: factories refuse what cannot be, catalogues hold what is published."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.catalogue import Catalogue, Entry, UnknownNameError
from offroad_env.world.soils import SOILS, make_soil, with_exponent
from offroad_env.world.vehicles import VEHICLES, make_vehicle, make_wheel, static_loads
from strategies import any_soils, any_wheels

DEFORMABLE = [name for name, soil in SOILS.items() if soil.rigid < 0.5]


# --- catalogues ---------------------------------------------------------------------------------


@pytest.mark.parametrize("catalogue", [SOILS, VEHICLES], ids=["soils", "vehicles"])
def test_every_entry_has_a_source_a_remark_and_a_record_of_floats(catalogue):
    for name in catalogue:
        entry = catalogue.entry(name)
        assert entry.name == name
        assert min(len(entry.title), len(entry.source), len(entry.remark)) > 10
        assert all(type(value) is float for value in entry.record), "an int would compile kernels twice"


def test_catalogues_are_rich_enough():
    assert len(DEFORMABLE) >= 14
    assert {"clay", "dry_sand", "cmu_sand", "lunar_regolith", "hard_ground"} <= set(SOILS)
    assert {"mrzr", "paper", "f1tenth"} <= set(VEHICLES)


def test_catalogue_is_a_read_only_mapping_that_copies_and_pickles():
    assert "clay" in SOILS
    assert "cheese" not in SOILS
    assert SOILS.get("cheese") is None
    with pytest.raises(TypeError):
        SOILS["clay"] = SOILS["snow"]
    for other in (copy.deepcopy(SOILS), pickle.loads(pickle.dumps(SOILS))):
        assert dict(other) == dict(SOILS)
        assert other.entry("clay") == SOILS.entry("clay")


def test_repr_shows_one_titled_line_per_entry():
    lines = repr(VEHICLES).splitlines()
    assert len(lines) == len(VEHICLES) + 1
    assert any(line.split()[0] == "mrzr" and "Polaris" in line for line in lines[1:])


@pytest.mark.parametrize(
    ("wrong", "near"),
    [("caly", "clay"), ("Dry Sand", "dry_sand"), ("sand", "lete_sand"), ("LETE-sand", "lete")],
)
def test_unknown_name_lists_the_nearest(wrong, near):
    with pytest.raises(UnknownNameError, match=near):
        SOILS[wrong]
    with pytest.raises(InvalidParameter, match=near):
        make_soil(wrong)
    with pytest.raises(KeyError):
        SOILS[wrong]


def test_name_like_no_other_lists_all_and_is_not_quoted():
    with pytest.raises(UnknownNameError) as caught:
        VEHICLES["xyzzy"]
    assert str(caught.value).startswith("no vehicle named 'xyzzy'; known: mrzr, paper")
    with pytest.raises(UnknownNameError):
        VEHICLES[["a", "list"]]


def test_two_entries_of_one_name_are_refused():
    entry = Entry(name="a", record=1.0, title="t", source="s", remark="r")
    with pytest.raises(InvalidParameter, match="two entries named 'a'"):
        Catalogue("thing", [entry, entry])


# --- published numbers ----------------------------------------------------------------------------


def test_clay_and_dry_sand_are_wongs():
    clay, sand = SOILS["clay"], SOILS["dry_sand"]
    assert clay[:4] == (13.19e3, 692.15e3, 0.5, 4.14e3)
    assert sand[:4] == pytest.approx((0.99e3, 1528.43e3, 1.1, 1.04e3), rel=1e-12)
    assert math.degrees(clay.phi) == pytest.approx(13.0)
    assert math.degrees(sand.phi) == pytest.approx(28.0)
    assert (sand.a_0, sand.a_1) == (0.18, 0.32)
    assert (clay.a_0, clay.a_1) == (0.43, 0.32)


@pytest.mark.parametrize("name", DEFORMABLE)
def test_a_wheel_of_a_light_vehicle_finds_a_plausible_pressure(name):
    """At 5 cm sinkage every catalogue soil carries 1 kPa ... 2 MPa: no unit slipped."""
    soil = SOILS[name]
    pressure = (soil.k_c / 0.2 + soil.k_phi) * 0.05**soil.n
    assert 1e3 < pressure < 2e6
    strength = soil.c + pressure * math.tan(soil.phi)
    assert 0.05 < strength / pressure < 5.0  # Swedish snow: soft, but 6 kPa of cohesion


def test_mrzr_static_loads_are_the_published_ones():
    front, rear = static_loads(VEHICLES["mrzr"])
    # Published to the newton with CG distances to the millimetre: 1 mm is 5 N.
    assert front == pytest.approx(5880.0, abs=6.0)
    assert rear == pytest.approx(7641.0, abs=6.0)


def test_static_loads_balance_weight_and_moment():
    vehicle = VEHICLES["hmmwv"]
    front, rear = static_loads(vehicle)
    assert front + rear == pytest.approx(vehicle.m * 9.80665, rel=1e-14)
    assert front * vehicle.l_f == pytest.approx(rear * vehicle.l_r, rel=1e-14)


# --- make_soil ------------------------------------------------------------------------------------


def test_base_by_name_and_by_record_agree_and_only_the_given_changes():
    changed = make_soil("clay", n=0.4)
    assert changed == make_soil(SOILS["clay"], n=0.4)
    assert changed == SOILS["clay"]._replace(n=0.4)
    assert make_soil("clay") == SOILS["clay"]


@pytest.mark.parametrize("name", [*SOILS])
def test_the_quick_way_to_another_exponent_gives_the_same_soil(name):
    for n in (0.1, 1 / 3, 1.1, 2.5):
        assert with_exponent(SOILS[name], n) == make_soil(name, n=n)
    with pytest.raises(InvalidParameter, match=r"n must be in \(0.05, 2.5\], got 2.6"):
        with_exponent(SOILS[name], 2.6)


def test_soil_from_scratch_needs_the_essentials_and_shares_the_shear_modulus():
    soil = make_soil(k_phi=1e6, n=1.0, c=1e3, phi=0.5, k_x=0.02)
    assert soil.k_y == 0.02
    assert make_soil("clay", k_x=0.02).k_y == SOILS["clay"].k_y
    with pytest.raises(InvalidParameter, match="missing: c, phi"):
        make_soil(k_phi=1e6, n=1.0)


@pytest.mark.parametrize("name", [*SOILS])
def test_every_catalogue_soil_passes_its_own_factory(name):
    assert make_soil(SOILS[name]) == SOILS[name]


@pytest.mark.parametrize(
    ("field", "value", "mistake"),
    [
        ("phi", 30.0, "degrees"),
        ("k_phi", 692.15, "kN"),
        ("c", 4.14, "kPa"),
        ("k_x", 2.5, "cm"),
        ("k_y", 25.0, "mm"),
        ("n", 0.05, r"\(0.05, 2.5\]"),
        ("n", 2.6, r"\(0.05, 2.5\]"),
        ("n", math.nan, "got nan"),
        ("k_phi", -1e6, "got -1e"),
        ("c", math.inf, "got inf"),
        ("k_x", 0.0, "1e-4"),
        ("a_0", 30.0, "degrees"),
        ("mu", 80.0, "per cent"),
        ("C_alpha", 45e3, "not divided"),
        ("n", "0.5", "number"),
        ("n", True, "number"),
        ("n", [0.4, 0.5], "one number"),
    ],
)
def test_wrong_soil_value_is_refused_with_name_and_likely_mistake(field, value, mistake):
    with pytest.raises(InvalidParameter, match=mistake) as caught:
        make_soil("clay", **{field: value})
    assert str(caught.value).startswith(field)


@pytest.mark.parametrize(("k_c", "k_phi"), [(13.19, 692.15), (-44.0, 1900.0), (0.0, 692.15), (13.19, 0.0)])
def test_moduli_that_are_both_small_are_taken_for_kn(k_c, k_phi):
    with pytest.raises(InvalidParameter, match="both kN given as N"):
        make_soil("clay", k_c=k_c, k_phi=k_phi)


@pytest.mark.parametrize("k_c", [-44e3, -44.0, 0.5, 49e3])
def test_a_measured_k_c_may_be_small_or_negative(k_c):
    soil = make_soil("dry_sand", k_c=k_c)
    wheel = make_wheel(r=0.33, b=0.212)
    found = wheel_forces(soil, wheel, load=2000.0, slip=0.1)
    assert found.F_z == pytest.approx(2000.0, rel=1e-6)
    deeper = wheel_forces(make_soil(soil, k_c=k_c - 5e3), wheel, load=2000.0, slip=0.1)
    assert deeper.sinkage > found.sinkage


def test_a_wheel_too_narrow_for_a_negative_k_c_is_refused_with_the_least_width():
    soil = make_soil("dry_sand", k_c=-440e3)
    with pytest.raises(InvalidParameter, match=r"below 0\.288 m"):
        wheel_forces(soil, make_wheel(r=0.33, b=0.212), load=2000.0, slip=0.1)
    with pytest.raises(InvalidParameter, match="not even one"):
        make_soil("dry_sand", k_c=-1e8)


def test_one_overloaded_wheel_does_not_fail_a_sweep():
    soil, wheel = make_soil("dry_sand", n=1.1), make_wheel(r=0.33, b=0.212)
    loads = np.array([1000.0, 1e6, 2000.0])
    with pytest.raises(SolverFailure, match="1 of 3"):
        wheel_forces(soil, wheel, load=loads, slip=0.1)
    found = wheel_forces(soil, wheel, load=loads, slip=0.1, errors="nan")
    assert all(np.isnan(values[1]) for values in found)
    alone = wheel_forces(soil, wheel, load=loads[2], slip=0.1)
    assert all(values[2] == value for values, value in zip(found, alone, strict=True))


def test_message_reads_as_the_house_wants():
    with pytest.raises(InvalidParameter) as caught:
        make_soil("clay", phi=30.0)
    assert str(caught.value) == "phi must be in [0, pi/2) rad, got 30 - degrees?"


def test_misspelt_name_is_refused():
    with pytest.raises(TypeError, match=r"unexpected field .k_fi. - did you mean .k_phi."):
        make_soil("clay", k_fi=1e6)


def test_contact_angles_out_of_order_are_refused():
    with pytest.raises(InvalidParameter, match="exchanged"):
        make_soil("clay", a_0=-0.1, a_1=0.0, b_0=0.43)
    with pytest.raises(InvalidParameter, match="slip 1 "):
        make_soil("clay", a_0=0.8, a_1=0.3)


@pytest.mark.parametrize(
    ("b_0", "b_1", "said"),
    [(-0.6, 0.0, "behind the axle"), (-0.4, 0.2, "slip -1"), (0.2, 0.0, "ahead of"), (0.0, 0.15, "slip 1")],
)
def test_a_contact_that_ends_where_no_wheel_is_carried_is_refused(b_0, b_1, said):
    with pytest.raises(InvalidParameter, match=said) as caught:
        make_soil("clay", b_0=b_0, b_1=b_1)
    assert "no monotone load curve" in str(caught.value)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(soil=any_soils(), wheel=any_wheels(), turned=st.floats(0.0, 1.0))
def test_a_rolling_wheel_is_carried_the_better_the_deeper_on_every_soil_of_the_factory(soil, wheel, turned):
    depths = np.concatenate([np.geomspace(1e-6, 1e-2, 15), np.linspace(0.02, 0.95, 30)]) * wheel.r
    for slip in (0.0, 0.3, turned, 1.0):
        for shear in ("independent", "resultant"):
            carried = wheel_forces(soil, wheel, sinkage=depths, slip=slip, shear=shear).F_z
            assert np.diff(carried).min() > -1e-6 * carried.max()


@pytest.mark.parametrize(
    "changes",
    [
        {"k_phi": 24e3, "n": 2.47, "c": 276e3, "phi": 0.16, "k_x": 0.006, "a_0": 0.09, "b_0": -0.88},
        {"a_0": 0.8, "a_1": 0.15, "b_0": 0.7, "b_1": 0.0},
    ],
    ids=["behind", "ahead"],
)
def test_the_load_curve_of_a_refused_soil_does_fall(changes):
    """Without this the bounds on the exit angle would be a matter of taste."""
    soil = SOILS["clay"]._replace(**changes)
    depths = np.concatenate([np.geomspace(1e-6, 1e-2, 15), np.linspace(0.02, 0.95, 30)]) * 0.33
    carried = wheel_forces(soil, make_wheel(r=0.33, b=0.21), sinkage=depths, slip=0.0).F_z
    assert np.diff(carried).min() < -1e-3 * np.abs(carried).max()


def test_soil_without_stiffness_or_strength_is_refused():
    with pytest.raises(InvalidParameter, match="carry no load"):
        make_soil("clay", k_c=0.0, k_phi=0.0)
    with pytest.raises(InvalidParameter, match="no strength"):
        make_soil("clay", c=0.0, phi=0.0)


def test_rigid_needs_nothing_and_does_not_turn_into_soil_by_itself():
    ground = make_soil(kind="rigid")
    assert ground.rigid == 1.0
    assert make_soil(ground, mu=0.5) == ground._replace(mu=0.5)
    assert make_soil(ground, C_alpha=7.0).C_kappa == 7.0, "one stiffness, unless two are given"
    assert make_soil(make_soil(ground, C_kappa=20.0), C_alpha=5.0).C_kappa == 10.0
    assert make_soil("clay", kind="rigid", mu=0.6).rigid == 1.0
    with pytest.raises(InvalidParameter, match="missing"):
        make_soil(ground, kind="deformable")
    with pytest.raises(InvalidParameter, match="'deformable' or 'rigid'"):
        make_soil("clay", kind="hard")
    with pytest.raises(InvalidParameter, match="base must be"):
        make_soil(0.5)


def test_numpy_scalars_become_floats():
    soil = make_soil("clay", n=np.float32(0.5), c=np.int64(4000))
    assert type(soil.n) is float
    assert type(soil.c) is float
    assert isinstance(soil, Soil)


# --- make_vehicle, make_wheel -----------------------------------------------------------------------


def test_vehicle_from_a_base_changes_only_the_given():
    assert make_vehicle("mrzr", m=1500.0) == VEHICLES["mrzr"]._replace(m=1500.0)
    assert make_vehicle(**VEHICLES["paper"]._asdict()) == VEHICLES["paper"]
    assert isinstance(make_vehicle("f1tenth"), Vehicle)


def test_vehicle_without_a_base_names_what_is_missing():
    with pytest.raises(InvalidParameter, match=r"missing: I_z, I_y, .*mrzr"):
        make_vehicle(m=1000.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steer_max": 30.0}, "steer_max .* degrees"),
        ({"steer_rate": 60.0}, "steer_rate .* degrees"),
        ({"r": 330.0}, "r must .* mm"),
        ({"l_f": 1537.0}, "l_f .* mm"),
        ({"drive_front": 50.0}, "drive_front .* per cent"),
        ({"torque_lag": 200.0}, "torque_lag .* ms"),
        ({"wheels_per_axle": 1.5}, "1 or 2, got 1.5"),
        ({"wheels_per_axle": 4}, "wheels_per_axle"),
        ({"m": -1.0}, "m must"),
        ({"m": math.nan}, "m must"),
        ({"I_z": 17870.0}, "gyration in yaw"),
        ({"I_y": 13.95}, "gyration in pitch"),
        ({"k_f": 28.0, "k_r": 88.3}, "bounce frequency"),
        ({"k_f": 28e6, "k_r": 88e6}, "bounce frequency"),
        ({"c_f": 14.3e5}, "damping ratio"),
        ({"c_f": 5e5, "k_f": 5e6}, r"damping rate \(c_f \+ c_r\)/m must be in \[0, 300\] 1/s, got 367"),
        ({"m_w": 600.0}, "unsprung share"),
        ({"l_r": 0.02}, "front share of the static load"),
        ({"drive_torque_max": 3.6e5}, "drive force"),
        ({"power_max": 9e6}, "drive power"),
        ({"h_cg": 6.38}, "CG height"),
        ({"I_w": 186.0}, "of a wheel over its radius"),
    ],
)
def test_wrong_vehicle_value_is_refused(changes, message):
    with pytest.raises(InvalidParameter, match=message):
        make_vehicle("mrzr", **changes)


@pytest.mark.parametrize("scale", [0.1, 10.0])
@pytest.mark.parametrize("field", ["m", "I_z", "I_y", "r", "h_cg"])
def test_one_power_of_ten_in_a_geometric_or_inertial_number_never_passes(field, scale):
    mrzr = VEHICLES["mrzr"]
    with pytest.raises(InvalidParameter):
        make_vehicle(mrzr, **{field: scale * getattr(mrzr, field)})


def test_undamped_and_unpowered_vehicles_are_allowed():
    vehicle = make_vehicle("paper", c_f=0.0, c_r=0.0, drive_torque_max=0.0, power_max=0.0, drag_area=0.0)
    assert vehicle.c_f == 0.0


def test_misspelt_vehicle_field_and_base_are_refused():
    with pytest.raises(TypeError, match=r"unexpected field .mass."):
        make_vehicle("mrzr", mass=1000.0)
    with pytest.raises(InvalidParameter, match="mrzr"):
        make_vehicle("mzrr")
    with pytest.raises(InvalidParameter, match="base must be"):
        make_vehicle(3.0)


def test_wheel_is_checked():
    assert make_wheel(r=0.3, b=0.2) == (0.3, 0.2)
    with pytest.raises(InvalidParameter, match="mm"):
        make_wheel(r=330.0, b=0.2)
    with pytest.raises(InvalidParameter, match="b must"):
        make_wheel(r=0.3, b=0.0)
