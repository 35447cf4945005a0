"""Logs: read as they stand, written exactly, told from each other."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import yaml

from estimators.logs import (
    GnssSpec,
    ImuSpec,
    Recorder,
    StartSpec,
    TerrainSpec,
    commands_at,
    config_of,
    held,
    log_from_run,
    log_of_drive,
    plant_of,
    read_log,
    read_logs,
    start_of,
    with_structure,
    write_log,
)
from helpers import run_fresh
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.drive import simulate_drive
from offroad_env.simulation.sensors import ImuConfig, SensorSuite
from offroad_env.simulation.simulator import make_plant, settled_state, simulate, simulate_commands
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.structures import read_structure
from offroad_env.world.terrain import add, flat, grade, paper_terrain, rough_terrain
from offroad_env.world.tyres import make_tyre
from offroad_env.world.vehicles import VEHICLES
from simulated_logs import BELIEVED_N, STEP, TRUE_N, changed, plant_with, same_columns, sensors_for


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_what_is_written_is_read_back_bit_for_bit(ending, log, tmp_path):
    if ending == ".parquet":
        pytest.importorskip("pyarrow")
    rng = np.random.default_rng(3)
    awkward = rng.standard_normal(len(log)) * 10.0 ** rng.integers(-300, 0, len(log))
    awkward[::7] = math.nan
    odd = changed(log, a_y=awkward)
    path = write_log(tmp_path / f"run{ending}", odd)
    back = read_log(path)
    assert np.array_equal(back.t, odd.t)
    assert same_columns(back.channels, odd.channels)
    assert same_columns(back.references, odd.references)
    assert back.config == odd.config
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"run{ending}", "run.yaml"]


def test_a_simulated_log_has_the_hash_that_its_file_will_have(log, tmp_path):
    assert read_log(write_log(tmp_path / "slalom.csv", log)).hash == log.hash


def test_a_hash_tells_logs_apart_by_data_and_by_description(log, tmp_path):
    write_log(tmp_path / "a.csv", log)
    other = log.channels["a_x"].copy()
    other[5] = np.nextafter(other[5], 1.0)
    write_log(tmp_path / "b.csv", changed(log, a_x=other))
    heavier = replace(log.config, vehicle=log.config.vehicle._replace(m=1400.0))
    write_log(tmp_path / "c.csv", replace(log, config=heavier))
    hashes = {one.hash for one in read_logs(tmp_path / f"{name}.csv" for name in "abc")}
    assert len(hashes) == 3


def test_a_description_of_another_file_is_never_replaced(log, tmp_path):
    write_log(tmp_path / "run.csv", log)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    heavier = replace(log.config, vehicle=log.config.vehicle._replace(m=1400.0))
    write_log(tmp_path / "run.mcap", replace(log, config=heavier))
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert (tmp_path / "run.mcap.yaml").is_file()
    assert read_log(tmp_path / "run.csv").config.vehicle.m == log.config.vehicle.m
    assert read_log(tmp_path / "run.mcap").config.vehicle.m == 1400.0


def test_a_log_that_is_written_again_is_described_anew(log, tmp_path):
    for name in ("run.csv", "run.mcap"):
        write_log(tmp_path / name, log)
    for m in (1400.0, 1500.0):
        heavier = replace(log.config, vehicle=log.config.vehicle._replace(m=m))
        for name in ("run.csv", "run.mcap"):
            write_log(tmp_path / name, replace(log, config=heavier))
            assert read_log(tmp_path / name).config.vehicle.m == m
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.csv", "run.mcap", "run.mcap.yaml", "run.yaml"]


def test_beside_a_description_that_ends_in_yml_a_log_has_its_own(log, tmp_path):
    (tmp_path / "drive.yml").write_text("vehicle: mrzr")
    write_log(tmp_path / "drive.csv", log)
    assert (tmp_path / "drive.yml").read_text() == "vehicle: mrzr"
    assert read_log(tmp_path / "drive.csv").config == read_log(write_log(tmp_path / "other.csv", log)).config


def test_two_descriptions_of_its_own_are_refused(log, tmp_path):
    path = write_log(tmp_path / "run.csv", log)
    for ending in (".yaml", ".yml"):
        (tmp_path / f"run.csv{ending}").write_text("vehicle: mrzr")
    with pytest.raises(DataError, match=r"two descriptions, run\.csv\.yaml and run\.csv\.yml: keep one"):
        read_log(path)


def test_two_formats_of_one_log_share_their_description(log, tmp_path):
    pytest.importorskip("pyarrow")
    paths = [write_log(tmp_path / name, log) for name in ("run.csv", "run.parquet")]
    first, second = (read_log(path) for path in paths)
    assert same_columns(first.channels, second.channels)


def test_writing_that_fails_leaves_the_old_files_whole(log, tmp_path, monkeypatch):
    path = write_log(tmp_path / "run.csv", log)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def full_disk(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full_disk)
    with pytest.raises(DataError, match=r"run\.csv: cannot be written: No space left"):
        write_log(path, changed(log, a_x=log.channels["a_y"]))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize(("name", "words"), [("run.txt", "written as .csv"), ("no/such/run.csv", "No such")])
def test_a_log_is_not_written_where_it_cannot_be_read(name, words, log, tmp_path):
    with pytest.raises(DataError, match=words):
        write_log(tmp_path / name, log)
    assert list(tmp_path.iterdir()) == []


def test_a_log_survives_pickling(log):
    back = pickle.loads(pickle.dumps(log))
    assert same_columns(back.channels, log.channels)
    assert (back.config, back.hash) == (log.config, log.hash)


def test_channels_of_a_log_cannot_be_changed_by_accident(log, tmp_path):
    for one in (log, read_log(write_log(tmp_path / "run.csv", log))):
        for array in (one.t, *one.channels.values(), *one.references.values()):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0.0


def test_a_byte_order_mark_and_windows_line_ends_are_no_reason_to_refuse(log, tmp_path):
    path = write_log(tmp_path / "run.csv", log)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert same_columns(read_log(path).channels, log.channels)


def test_reading_logs_needs_no_package_of_the_data_extra():
    loaded = run_fresh("import estimators.logs, sys; print(*sys.modules)").split()
    assert "yaml" in loaded
    assert not {"pandas", "pyarrow", "rosbags"} & set(loaded)


def test_references_are_kept_but_never_among_the_channels(log):
    assert {"ref_yaw", "ref_n_f", "ref_sinkage_r"} <= set(log.references)
    assert not any(name.startswith("ref_") for name in log.channels)


# ------------------------------------------------------------------ units, YAML


@pytest.mark.parametrize(
    ("column", "unit", "factor"),
    [
        ("steer", "deg", math.degrees(1.0)),
        ("yaw_rate", "deg/s", math.degrees(1.0)),
        ("pitch_rate", "°/s", math.degrees(1.0)),
        ("omega_f", "rpm", 30.0 / math.pi),
        ("a_x", "g", 1.0 / 9.80665),
        ("a_y", "mg", 1000.0 / 9.80665),
        ("torque_f", "kN m", 1e-3),
        ("speed", "km/h", 3.6),
        ("x", "mm", 1e3),
        ("t", "ms", 1e3),
    ],
)
def test_a_named_unit_gives_the_log_in_si(column, unit, factor, log, tmp_path):
    path = write_log(tmp_path / "run.csv", log)
    lines = path.read_text().split("\n")
    i = lines[0].split(",").index(column)
    rows = [line.split(",") for line in lines[1:-1]]
    for row in rows:
        row[i] = repr(float(row[i]) * factor) if row[i] else ""
    path.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    description = tmp_path / "run.yaml"
    description.write_text(description.read_text() + f"units: {{{column}: {unit}}}\n")
    back = read_log(path)
    expected = log.t if column == "t" else log.channels[column]
    found = back.t if column == "t" else back.channels[column]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    others = {name: values for name, values in log.channels.items() if name != column}
    assert same_columns({name: back.channels[name] for name in others}, others)  # bit for bit


def test_numbers_are_read_as_people_write_them(log, tmp_path):
    path = write_log(tmp_path / "run.csv", log)
    data = yaml.safe_load((tmp_path / "run.yaml").read_text())
    data["soil"] |= {"k_c": "K_C", "k_phi": "K_PHI"}
    text = yaml.safe_dump(data).replace("K_C", "13.19e3").replace("K_PHI", "692e3")
    (tmp_path / "run.yaml").write_text(text)
    soil = read_log(path).config.soil
    assert (soil.k_c, soil.k_phi) == (13190.0, 692000.0)


@pytest.mark.parametrize(
    "terrain",
    [
        TerrainSpec(kind="flat"),
        TerrainSpec(kind="paper", H_0=0.05),
        TerrainSpec(kind="unknown", rms=0.02),
        TerrainSpec(kind="waves", plane=(0.1, 0.01, -0.02), waves=((0.05, 0.3, 0.4, 1.0),)),
    ],
    ids=lambda terrain: terrain.kind,
)
@pytest.mark.parametrize("rigid", [False, True])
def test_a_description_survives_its_yaml(terrain, rigid, log, tmp_path):
    soil = make_soil(kind="rigid", mu=0.7, C_alpha=8.0, C_kappa=12.0) if rigid else SOILS["clay"]
    config = replace(
        log.config,
        soil=soil,
        terrain=terrain,
        hold="linear",
        gnss=GnssSpec(sd_position=0.02),
        imu=ImuSpec(kinematic=True, position=(0.1, -0.2, 0.3), sd_a=0.1, sd_rate=0.01),
        start=StartSpec(
            x=1.0, yaw=0.3, v_x=3.0, state=(("x", 1.0), ("yaw", 0.3), ("v_x", 3.0), ("z", -0.04))
        ),
        unknown=("imu.position", "suspension"),
    )
    path = write_log(tmp_path / "run.csv", replace(log, config=config))
    back = read_log(path).config
    if rigid:  # what deformable soil would need is not written: hard ground has none of it
        assert (back.soil.rigid, back.soil.mu, back.soil.C_alpha, back.soil.C_kappa) == (1.0, 0.7, 8.0, 12.0)
        back = replace(back, soil=soil)
    assert replace(back, start=config.start) == config
    assert dict(back.start.state) == dict(config.start.state)


def test_a_log_states_the_laws_of_its_wheels(log, tmp_path):
    [changed_log] = with_structure([log], "grid,ruts=none")
    write_log(tmp_path / "run.csv", changed_log)
    read = read_log(tmp_path / "run.csv")
    assert read.config.structure == "grid,ruts=none"
    assert plant_of(read).structure == read_structure("grid,ruts=none")
    assert plant_of(log).structure is None
    [tyred] = with_structure([log], "field,tyre=mrzr,tyre_inflation=12e4")
    write_log(tmp_path / "tyred.csv", tyred)
    assert plant_of(read_log(tmp_path / "tyred.csv")).structure.tyre == make_tyre("mrzr", inflation=12e4)
    text = (tmp_path / "tyred.yaml").read_text()
    (tmp_path / "tyred.yaml").write_text(text.replace("tyre=mrzr", "tyre=hmmwv"))
    with pytest.raises(DataError, match=r"tyred.yaml.*the tyre's radius must be within 15 %"):
        read_log(tmp_path / "tyred.csv")
    text = (tmp_path / "run.yaml").read_text()
    (tmp_path / "run.yaml").write_text(text.replace("grid,ruts=none", "grid,ruts=deep"))
    with pytest.raises(DataError, match=r"ruts must be one of none, pressure"):
        read_log(tmp_path / "run.csv")


def test_a_stated_state_overrules_the_settled_vehicle(log):
    start = StartSpec(x=1.0, v_x=3.0, state=(("v_x", 3.0), ("pitch", 0.02), ("omega_f", 11.0)))
    with_state = replace(log, config=replace(log.config, start=start))
    settled = replace(log, config=replace(log.config, start=StartSpec(x=1.0, v_x=3.0)))
    a, b = start_of(with_state)[0], start_of(settled)[0]
    assert (a[at.PITCH], a[at.OMEGA_F], a[at.V_X]) == (0.02, 11.0, 3.0)
    assert a[at.Z] == b[at.Z] < 0.0


def test_optional_vehicle_keys_follow_the_proportions_of_known_vehicles(log, tmp_path):
    path = write_log(tmp_path / "run.csv", log)
    data = yaml.safe_load((tmp_path / "run.yaml").read_text())
    needed = ("m", "I_z", "I_y", "l_f", "l_r", "k_f", "k_r", "c_f", "c_r", "m_w", "r", "b", "wheels_per_axle")
    data["vehicle"] = {name: data["vehicle"][name] for name in needed}
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(data))
    vehicle, true = read_log(path).config.vehicle, VEHICLES["mrzr"]
    for name in ("h_cg", "track", "I_w"):
        assert 0.5 < getattr(vehicle, name) / getattr(true, name) < 2.0
    # What the file does not name is not there: no drag, no lag.
    assert (vehicle.drag_area, vehicle.rolling_resistance, vehicle.steer_lag, vehicle.torque_lag) == (0,) * 4
    # The measured torques say how the drive is shared.
    assert vehicle.drive_front == pytest.approx(true.drive_front, abs=1e-12)


# ------------------------------------------------------------------ from runs and back


def test_a_log_replays_the_run_it_came_from(run, log, tmp_path):
    trajectory, plant, commands = run
    back = read_log(write_log(tmp_path / "run.csv", log))
    replayed_plant = plant_of(back)._replace(soil=plant.soil)
    state, warm = start_of(back, replayed_plant)
    replayed_commands = commands_at(back, back.t[:-1])
    # The torques of the axles add up to the command but for rounding; all else is exact.
    np.testing.assert_allclose(replayed_commands, commands, rtol=1e-14)
    replayed = simulate_commands(replayed_plant, state, warm, replayed_commands, interval=STEP)
    np.testing.assert_allclose(replayed.states, trajectory.states, rtol=1e-9, atol=1e-9)


def test_a_log_of_a_run_gives_its_soil_and_settling_depth_away_nowhere_but_in_references(run, log, tmp_path):
    write_log(tmp_path / "run.csv", log)
    text = (tmp_path / "run.yaml").read_text()
    assert f"n: {BELIEVED_N}" in text
    assert str(TRUE_N) not in text
    assert np.nanmax(np.abs(log.references["ref_n_f"] - TRUE_N)) < 1e-12
    depth = repr(float(run[0].states[0, at.Z]))
    assert depth not in text
    channels_only = replace(log, references={})
    write_log(tmp_path / "bare.csv", channels_only)
    assert repr(TRUE_N) not in (tmp_path / "bare.csv").read_text()


def test_sensors_of_a_log_scatter_about_the_truth_by_their_noise(run, log):
    trajectory = run[0]
    wheel_t, omega = log.samples("omega_f")
    assert len(omega) == pytest.approx(len(log) / 2, abs=1)  # 50 Hz beside an IMU of 100 Hz
    slip_free = trajectory.readings[::2, at.R_OMEGA] / VEHICLES["mrzr"].r
    assert np.std(omega - slip_free) == pytest.approx(0.01 / VEHICLES["mrzr"].r, rel=0.1)
    x_t, x = log.samples("x")
    assert np.array_equal(x_t, log.t[::10])
    assert np.std(x - trajectory.states[::10, at.X]) == pytest.approx(0.03, rel=0.2)
    noise = log.channels["yaw_rate"] - trajectory.states[:, at.YAW_RATE] * np.cos(
        trajectory.states[:, at.PITCH]
    )
    assert np.std(noise) == pytest.approx(0.003, rel=0.1)
    assert np.median(log.channels["a_z"]) == pytest.approx(GRAVITY, abs=0.1)
    assert wheel_t[1] == pytest.approx(0.02)


def test_a_brake_is_a_negative_torque(log):
    config = replace(log.config, vehicle=VEHICLES["mrzr"])
    recorder = Recorder(config, period=STEP)
    sample = np.zeros(11)
    recorder.start(sample)
    recorder.hold((0.1, 1000.0, 0.0), np.stack([sample, sample]))
    recorder.hold((0.2, 0.0, 500.0), np.stack([sample, sample]))
    braked = recorder.log("braked")
    assert np.array_equal(
        commands_at(braked, np.array([0.0, 0.01, 0.02, 0.03, 9.0]))[:, 0], [0.1, 0.1, 0.2, 0.2, 0.2]
    )
    np.testing.assert_allclose(
        commands_at(braked, np.array([0.0, 0.02]))[:, 1:], [[1000.0, 0.0], [0.0, 500.0]]
    )
    assert braked.channels["torque_f"][2] == pytest.approx(-0.6 * 500.0)
    assert np.isnan(braked.channels["steer"][1])


def test_held_inputs_jump_and_linear_ones_do_not(log):
    halfway = log.t[:-2] + 0.5 * STEP
    steer = log.channels["steer"]
    assert np.array_equal(held(log, "steer", halfway), steer[:-2])
    linear = replace(log, config=replace(log.config, hold="linear"))
    np.testing.assert_allclose(
        held(linear, "steer", halfway[:-1]), 0.5 * (steer[:-3] + steer[1:-2]), atol=1e-12
    )


def test_the_papers_model_logs_its_force(tmp_path):
    plant = make_plant(VEHICLES["paper"], SOILS["clay"], paper_terrain(0.01), model="paper", slip=0.0275)
    state, warm = settled_state(plant, v_x=3.0)

    def steer(t: float) -> float:
        return 0.2 * math.sin(t)

    trajectory = simulate(plant, state, warm, steer=steer, force=600.0, duration=3.0, dt=STEP)
    commands = np.column_stack([[steer(t) for t in trajectory.t], np.full(len(trajectory.t), 600.0)])
    sensors = SensorSuite(imu=ImuConfig(body_axes=False))
    made = log_from_run(trajectory, plant, commands, sensors, np.random.default_rng(1), hold="linear")
    back = read_log(write_log(tmp_path / "paper.csv", made))
    assert back.config.terrain == TerrainSpec(kind="paper", H_0=0.01)
    assert (back.config.model, back.config.drivetrain, back.config.slip) == ("paper", "force", 0.0275)
    assert set(back.channels["drive_force"][:-1]) == {600.0}
    assert plant_of(back).soil == plant.soil
    assert "x" not in back.channels  # no GNSS, no columns


@pytest.mark.parametrize(
    "ground", [grade(0.1), rough_terrain("C", np.random.default_rng(2))], ids=["grade", "rough"]
)
def test_any_ground_of_the_simulator_comes_back_from_the_yaml_exactly(ground, log, tmp_path):
    ground = add(ground, paper_terrain(0.03))
    config = config_of(plant_with(0.8, ground), sensors_for(), StartSpec(v_x=3.0))
    back = read_log(write_log(tmp_path / "run.csv", replace(log, config=config)))
    restored = plant_of(back).ground
    assert np.array_equal(restored.waves, ground.waves)
    assert restored[:3] == ground[:3]


def test_hard_ground_works_from_yaml_to_motion(log, tmp_path):
    config = replace(
        log.config, soil=make_soil(kind="rigid", mu=0.9, C_alpha=9.0), terrain=TerrainSpec(kind="flat")
    )
    back = read_log(write_log(tmp_path / "hard.csv", replace(log, config=config)))
    plant = plant_of(back)
    state, warm = start_of(back)
    moved = simulate_commands(plant, state, warm, commands_at(back, back.t[:300]), interval=STEP)
    assert np.max(np.abs(moved.readings[:, at.SINKAGE])) < 1e-3
    assert moved.states[-1, at.X] > 10.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, p, c, s: (t, p, c[:-5], s), "commands must have"),
        (lambda t, p, c, s: (t, p, c, SensorSuite(imu=ImuConfig(rate=50.0))), "period"),
        (lambda t, p, c, s: (t, p, c, sensors_for(accel_noise=0.0)), "accel_noise must be > 0"),
        (lambda t, p, c, s: (t, p, c, sensors_for(body_axes=False)), "body_axes"),
    ],
)
def test_a_run_and_sensors_that_do_not_fit_are_refused(change, words, run):
    arguments = change(*run, sensors_for())
    with pytest.raises(InvalidParameter, match=words):
        log_from_run(*arguments, np.random.default_rng(0))


def test_the_log_of_a_drive_holds_its_samples_its_commands_and_only_on_request_its_truth():
    plant, sensors = plant_with(0.8, flat()), sensors_for()
    drive = simulate_drive(
        plant, lambda t, v: (0.1 * math.sin(t), 300.0 * (6.0 - v), 0.0), sensors, 4, duration=1.0
    )
    made = log_of_drive(drive, config_of(plant, sensors, StartSpec(v_x=3.0)), "weave")
    assert made.references == {}
    np.testing.assert_array_equal(made.channels["a_x"], drive.imu[:, 0])
    np.testing.assert_array_equal(made.channels["omega_r"], drive.wheel[:, 1] / plant.vehicle.r)
    before = 0.5 * (drive.t[1:] + drive.t[:-1])
    np.testing.assert_allclose(commands_at(made, before), drive.commands[1:], rtol=1e-12)
    assert np.isfinite(made.channels["steer"]).sum() == 50
    known = log_of_drive(drive, made.config, "weave", references=True)
    last = slice(None, None, 2)  # the truth stands where a command ends
    np.testing.assert_array_equal(known.references["ref_v_x"][last], drive.states[last, at.V_X])


def test_a_recorder_refuses_calls_out_of_order(log):
    recorder = Recorder(log.config, period=STEP)
    with pytest.raises(InvalidParameter, match="start"):
        recorder.hold((0.0, 0.0, 0.0), np.zeros((2, 11)))
    with pytest.raises(InvalidParameter, match="at least one command"):
        recorder.log("early")
    recorder.start(np.zeros(11))
    with pytest.raises(InvalidParameter, match="new Recorder"):
        recorder.start(np.zeros(11))
    with pytest.raises(InvalidParameter, match="11 channels"):
        recorder.hold((0.0, 0.0, 0.0), np.zeros((2, 5)))
