"""Effects: off is the base model bit for bit, a little changes a little, and a file brings them to others."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.physical_ranges import NEVER_NEGATIVE
from helpers import REPOSITORY
from offroad_env.effects import EFFECTS, Extension, Inputs, Setup, apply, find_effect, read_extension
from offroad_env.environment.extended import InputChain
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.axle import contact_shape
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.imu import imu_reading
from offroad_env.physics.paper_vehicle import paper_advance, paper_derivative
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import paper_terrain
from offroad_env.world.vehicles import VEHICLES

_ROUTE = np.column_stack([np.linspace(0.0, 4.0, 50), np.linspace(0.0, 0.3, 50)])


#: Effects of a wheel rig alone are tried on trials: tests/estimators/discrepancy/test_rig_diagnosis.py.
_ON_VEHICLES = [name for name, effect in EFFECTS.items() if "full" in effect.models and not effect.tyres_only]
#: Effects on a receiver, which the drive here lacks: see the tests of the environment.
_RECEIVED = ("antenna_x", "pose_delay")


def _setup(model: str = "full", soil: str = "dry_sand") -> Setup:
    plant = make_plant(VEHICLES["mrzr"], SOILS[soil], paper_terrain(0.1), model=model, slip=0.05)
    return Setup(plant=plant, mount=ImuConfig(lever_arm=(0.3, 0.1, 0.2), body_axes=model == "full").mount())


def _setup_for(name: str) -> Setup:
    """Where the effect means something."""
    return _setup(soil="hard_ground" if EFFECTS[name].hard_only else "dry_sand")


def _values(name: str, size: float) -> dict[str, float]:
    effect = EFFECTS[name]
    place = {} if effect.places is None else effect.places(_ROUTE)[0]
    return {effect.size.name: size, **place}


def _drive(setup: Setup, start: tuple | None = None) -> np.ndarray:
    """What sensors and state say along a short, lively drive that begins with braking."""
    soil = "hard_ground" if setup.plant.soil.rigid > 0.5 else "dry_sand"
    state, warm = settled_state(_setup(setup.model, soil).plant, v_x=4.0)
    readings, chain, rows = np.zeros(at.READINGS_SIZE), InputChain(setup.inputs), []
    for k in range(60):
        steer, drive, brake = 0.15 * np.sin(0.4 * k), 900.0 * (k >= 20), 800.0 * (k < 20)
        third = brake if setup.model == "full" else 0.0
        chain.push(0.02 * k, (steer, drive - (brake if setup.model == "paper" else 0.0), third))
        command = chain.acting(0.02 * k, 0.02)
        if setup.model == "full":
            full_advance(state, warm, command, setup.plant, 0.005, 4, readings)
        else:
            paper_advance(state, warm, (*command[:2], np.nan), setup.plant, 0.01, 2, readings)
        acceleration = tuple(readings[at.A_X : at.A_Z + 1])
        imu = np.array(
            imu_reading(
                acceleration,
                state[at.YAW_RATE],
                state[at.PITCH_RATE],
                readings[at.YAW_ACC],
                readings[at.PITCH_ACC],
                state[at.PITCH],
                setup.mount,
            )
        )
        imu[:3] *= setup.errors.accel_scale
        rims = setup.errors.wheel_scale * state[at.OMEGA_F : at.STEER]
        rows.append(np.concatenate([state[:10], imu + setup.errors.offset, rims]))
    return np.array(rows)


@pytest.mark.parametrize("name", _ON_VEHICLES)
def test_an_effect_at_its_off_value_leaves_not_a_trace(name):
    setup = _setup_for(name)
    off = apply(setup, [(name, _values(name, EFFECTS[name].size.off))])
    assert off is setup


def test_the_base_model_has_no_effects_and_inactive_rows_change_rounding_at_most():
    setup = _setup()
    assert setup.plant.effects is None
    base = _drive(setup)
    rows = np.zeros_like(apply(setup, [("grade", {"slope": 0.1})]).plant.effects)
    idle = Setup(plant=setup.plant._replace(effects=rows), mount=setup.mount)
    # Rounding of 1e-16 changes where the contact's iterations end, within their tolerance.
    assert np.max(np.abs(_drive(idle) - base)) < 1e-6


@pytest.mark.parametrize("name", [name for name in _ON_VEHICLES if name not in _RECEIVED])
def test_an_effect_acts_at_its_plausible_size_and_fades_as_it_shrinks(name):
    effect = EFFECTS[name]
    setup = _setup_for(name)
    reach = effect.plausible(setup.plant.vehicle)
    base = _drive(setup)
    away = [
        np.max(np.abs(_drive(apply(setup, [(name, _values(name, share * reach))])) - base))
        for share in (0.5, 1e-4)
    ]
    assert away[0] > 1e-6
    assert away[1] < 0.05 * away[0]


@pytest.mark.parametrize("name", ["multi_pass", "rate_damping", "grouser_thrust", "rut_drag"])
def test_twice_a_small_effect_leaves_twice_the_trace(name):
    """The solver's Jacobian must be that of the forces that act, or its error hides small effects."""
    setup = _setup()
    reach = EFFECTS[name].plausible(setup.plant.vehicle)
    sizes = [k * 1e-3 * reach + 1e-12 for k in (0, 1, 2)]
    off, one, two = (_drive(apply(setup, [(name, _values(name, size))])) for size in sizes)
    assert np.max(np.abs((two - off) - 2.0 * (one - off))) < 0.03 * np.max(np.abs(two - off))


@pytest.mark.parametrize(
    "name", ["aero_drag", "grade", "n_step", "multi_pass", "bulldozing", "one_sided_brake"]
)
def test_effects_act_in_the_papers_model_too(name):
    setup = _setup("paper")
    reach = EFFECTS[name].plausible(setup.plant.vehicle)
    assert not np.array_equal(_drive(apply(setup, [(name, _values(name, 0.5 * reach))])), _drive(setup))


def test_one_sided_braking_turns_the_vehicle_as_much_where_the_drive_is_a_force():
    """Left brakes give 0.7, right ones 0.3 of it, as from a brake torque; driving forces have no side."""
    setup = apply(_setup("paper"), [("one_sided_brake", {"share": 0.4})])
    state, _ = settled_state(_setup("paper").plant, v_x=4.0)
    vehicle, turn = setup.plant.vehicle, []
    for plant in (setup.plant, _setup("paper").plant):
        for force in (-800.0, 800.0):
            change, readings = np.zeros(at.STATE_SIZE), np.zeros(at.READINGS_SIZE)
            warm = np.zeros(contact_shape(plant.structure))
            paper_derivative(state, (0.0, force, np.nan), plant, warm, change, readings)
            turn.append(change[at.YAW_RATE])
    moment = (0.7 - 0.3) * 800.0 * 0.5 * vehicle.track
    assert turn[0] - turn[2] == pytest.approx(moment / vehicle.I_z, rel=1e-6)
    assert turn[1] == pytest.approx(turn[3], abs=1e-12)


def test_two_effects_at_once_are_both_there():
    setup = _setup()
    drag, grade = ("aero_drag", {"area": 2.0}), ("grade", {"slope": 0.05})
    both, alone = apply(setup, [drag, grade]), apply(setup, [drag])
    assert np.count_nonzero(both.plant.effects[:, 0]) == 2
    assert _drive(both)[-1, at.V_X] < _drive(alone)[-1, at.V_X] < _drive(setup)[-1, at.V_X]


def test_air_drag_as_an_effect_is_the_air_drag_of_the_vehicles_record():
    setup = _setup()
    vehicle = setup.plant.vehicle
    record = setup.with_vehicle(drag_area=vehicle.drag_area + 2.0)
    effect = apply(setup, [("aero_drag", {"area": 2.0})])
    assert np.allclose(_drive(effect), _drive(record), atol=1e-9)


def test_a_load_at_one_place_moves_the_centre_and_the_inertias_as_two_bodies_do():
    setup = _setup()
    v = setup.plant.vehicle
    load, arm = 0.2 * v.m, 0.4 * (v.l_f + v.l_r)
    changed = apply(setup, [("placed_payload", {"share": 0.2, "place": 0.4})]).plant.vehicle
    centre = load * arm / (v.m + load)
    assert changed.m == pytest.approx(v.m + load)
    assert (changed.l_f, changed.l_r) == pytest.approx((v.l_f - centre, v.l_r + centre))
    steiner = v.m * centre**2 + load * (arm - centre) ** 2
    assert (changed.I_z - v.I_z, changed.I_y - v.I_y) == pytest.approx((steiner, steiner))
    at_the_centre = apply(setup, [("placed_payload", {"share": 0.2, "place": 0.0})]).plant.vehicle
    assert at_the_centre == v._replace(m=1.2 * v.m)


def test_another_pressure_of_the_tyres_is_that_of_their_record():
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], paper_terrain(0.1), structure="grid", tyre="mrzr")
    changed = apply(Setup(plant=plant, mount=_setup().mount), [("tyre_pressure", {"share": -0.3})]).plant
    tyre = plant.structure.tyre
    assert changed.structure.tyre == tyre._replace(inflation=0.7 * tyre.inflation)
    assert changed._replace(structure=plant.structure) == plant


def test_wrong_use_is_refused_with_the_reason():
    setup = _setup()
    hard = replace(setup, plant=make_plant(VEHICLES["mrzr"], SOILS["hard_ground"], paper_terrain(0.1)))
    for start, effects, message in (
        (setup, [("no_such", {})], "no effect 'no_such'"),
        (setup, [("payload", {"mass": 3.0})], "payload takes share"),
        (setup, [("slip_sinkage", {"slope": 0.3})], "takes power, got slope - slip_exponent had this id"),
        (setup, [("sinkage_offset", {"depth": 0.01})], "means nothing in the full model"),
        (setup, [("payload", {"share": 30.0})], "payload: share must be in"),
        (_setup("paper"), [("spin_rear", {"torque": 10.0})], "means nothing in the paper model"),
        (hard, [("multi_pass", {"share": 0.1})], "means nothing on hard ground"),
        (setup, [("road_grip", {"share": 0.1})], "means nothing on soil"),
        (setup, [("tyre_pressure", {"share": 0.1})], "means nothing on rigid rims"),
    ):
        with pytest.raises(InvalidParameter, match=message):
            apply(start, effects)


def test_every_effect_says_what_it_is_and_names_only_look_alikes_that_exist():
    for name, effect in EFFECTS.items():
        assert "{size}" in effect.sentence
        assert effect.describe(0.1).startswith(effect.sentence.split("{size}")[0])
        for other in effect.look_alikes:
            assert find_effect(other).id == other != name
        assert effect.separated_by or not effect.look_alikes


def test_every_effect_has_a_source():
    """The literature with its year, a definition, or an assumption that is named as one."""
    for effect in EFFECTS.values():
        ours = effect.source.startswith(("definition: ", "assumption of this project: "))
        assert ours or re.search(r"\d{4}|IEEE Std \d+", effect.source), effect.id
    with pytest.raises(InvalidParameter, match="needs a source"):
        replace(EFFECTS["payload"], source=" ")


def test_the_table_of_the_docs_is_that_of_the_library():
    """What is printed where this fails belongs between the headings of docs/effects.md."""
    table = "\n".join(
        [
            "| effect | what it is | hook | models | source |",
            "|---|---|---|---|---|",
            *(
                f"| `{name}` | {effect.sentence.format(size=f'`{effect.size.name}` [{effect.size.unit}]')} "
                f"| {effect.hook} | {', '.join(effect.models)} | {effect.source} |"
                for name, effect in sorted(EFFECTS.items())
            ),
        ]
    )
    page = (REPOSITORY / "docs" / "effects.md").read_text(encoding="utf-8")
    assert table in page, f"docs/effects.md needs this table:\n{table}"


def test_one_id_names_one_law():
    laws = [effect.law for effect in EFFECTS.values() if effect.law is not None]
    assert len(set(map(id, laws))) == len(laws)
    assert EFFECTS["slip_exponent"].size.name == "slope"
    assert EFFECTS["slip_sinkage"].size.name == "power"


def test_effects_stand_in_the_order_of_their_first_ids():
    """Rows of compiled laws and ties of a search depend on it: a new id keeps the place of the old one."""
    first = [effect.former_ids[0] if effect.former_ids else name for name, effect in EFFECTS.items()]
    assert first == sorted(first)
    names = list(EFFECTS)
    assert names.index("slip_sinkage") == names.index("slip_exponent") - 1


def test_lyaskos_factor_deepens_the_sinkage_by_its_power():
    """Bekker's pressure at depth z d must be that of the base soil at z, d being the factor."""
    soil = SOILS["dry_sand"]
    slip, depth, width = 0.4, 0.03, 0.2
    deeper = lyasko_sinkage_factor(slip)
    weaker = deeper**-soil.n
    pressure = (soil.k_c / width + soil.k_phi) * depth**soil.n
    assert weaker * (soil.k_c / width + soil.k_phi) * (deeper * depth) ** soil.n == pytest.approx(pressure)
    assert lyasko_sinkage_factor(-slip) == deeper


def test_inputs_reach_the_vehicle_late_scaled_and_smoothed():
    chain = InputChain(
        Inputs(steer_delay=0.1, steer_gain=2.0, steer_offset=0.01, drive_scale=0.5, brake_scale=2.0)
    )
    seen = []
    for k in range(20):
        chain.push(0.02 * k, (0.1 if k >= 5 else 0.0, 100.0, 30.0))
        seen.append(chain.acting(0.02 * k, 0.02))
    steer = np.array(seen)[:, 0]
    assert np.allclose(steer[:10], 0.01)
    assert np.allclose(steer[10:], 0.21)
    assert seen[0][1:] == (50.0, 60.0)
    lag = InputChain(Inputs(steer_lag=0.2))
    for k in range(20):
        lag.push(0.02 * k, (0.0 if k == 0 else 1.0, 0.0, 0.0))
        last = lag.acting(0.02 * k, 0.02)[0]
    assert last == pytest.approx(1.0 - np.exp(-0.37 / 0.2), abs=0.01)


def test_an_extended_model_survives_its_file(tmp_path):
    extension = Extension(model="full", effects=(("payload", {"share": 0.1}), ("grade", {"slope": 0.02})))
    path = tmp_path / "extended.json"
    path.write_text(json.dumps(extension.to_dict()))
    assert read_extension(path) == extension


def test_a_file_with_former_ids_is_read_with_the_laws_of_its_time(tmp_path):
    """`slip_sinkage` was the id of what is `slip_exponent` today; the format tells which is meant."""
    entries = [
        {"id": "slip_sinkage", "parameters": {"slope": 0.3}},
        {"id": "slip_digging", "parameters": {"power": 1.2}},
    ]
    path = tmp_path / "extended.json"
    path.write_text(json.dumps({"format": "offroad-extension-1", "model": "rig", "effects": entries}))
    read = read_extension(path)
    assert read.effects == (("slip_exponent", {"slope": 0.3}), ("slip_sinkage", {"power": 1.2}))
    path.write_text(json.dumps(read.to_dict()))
    assert read_extension(path) == read
    path.write_text(json.dumps({"format": "offroad-extension-2", "model": "rig", "effects": entries}))
    with pytest.raises(DataError, match="slip_sinkage takes power"):
        read_extension(path)


def test_a_former_id_is_found_where_no_effect_has_it_today():
    assert find_effect("slip_digging") is EFFECTS["slip_sinkage"]
    assert find_effect("slip_sinkage").size.name == "power"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not JSON"),
        ("[]", "must hold a JSON object"),
        ('{"format": "offroad-extension-2", "model": "third", "effects": []}', "model must be one of"),
        ('{"format": "offroad-extension-2", "model": "full"}', "effects must be a list"),
        ('{"format": "offroad-extension-2", "model": "full", "effects": [{"id": "x"}]}', "no effect 'x'"),
        (
            '{"format": "offroad-extension-2", "model": "full", '
            '"effects": [{"id": "payload", "parameters": {"share": NaN}}]}',
            "each a number",
        ),
    ],
)
def test_a_damaged_file_of_an_extended_model_is_refused(tmp_path, content, message):
    path = tmp_path / "extended.json"
    path.write_text(content)
    with pytest.raises(DataError, match=message):
        read_extension(path)


def test_a_negative_size_is_worded_as_less_and_a_share_in_per_cent():
    assert EFFECTS["torque_scale"].describe(-0.18) == "drive and brake give 18 % less than logged"
    assert EFFECTS["lever_arm_x"].describe(-0.1).startswith("the IMU sits 0.1 m further behind the centre")
    assert EFFECTS["n_step"].describe(-0.2).startswith("n is 0.2 smaller")
    for effect in EFFECTS.values():
        sentence = effect.describe(-0.1)
        # Only what can never be less than nothing, such as soil that pushes, has no opposite.
        possible = effect.id not in (*NEVER_NEGATIVE, "soil_loosening")
        assert not possible or (effect.wording(-0.1)[1] == -1.0 and "-" not in sentence), effect.id
        assert sentence != effect.describe(0.1)
