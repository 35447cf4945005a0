"""``offroad replay``: its files, its JSON, and its refusals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.commands.cli import main
from estimators.logs import log_from_run, read_log, write_log
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


def offroad(*arguments) -> int:
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A log of 6 s as a file; with much less torque the vehicle would get stuck."""
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand"), flat())
    t = 0.01 * np.arange(600)
    commands = np.column_stack([0.1 * np.sin(2.0 * t), np.full(600, 1500.0), np.zeros(600)])
    run = simulate_commands(plant, *settled_state(plant, v_x=3.0), commands, interval=0.01)
    sensors = SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=GnssConfig())
    log = log_from_run(run, plant, commands, sensors, np.random.default_rng(3), name="short")
    return write_log(tmp_path_factory.mktemp("logs") / "short.csv", log)


def test_numbers_and_picture_are_written_and_the_table_names_every_model(drive, tmp_path, capsys):
    options = ("--structure", "paper", "full", "--window", "2", "--jobs", "1")
    assert offroad("replay", drive, *options, "--out", tmp_path, "--json", tmp_path / "r.json") == 0
    printed = capsys.readouterr().out
    assert "paper" in printed
    assert "half_car" in printed
    numbers = json.loads((tmp_path / "r.json").read_text())
    assert [(run["log"], run["structure"], run["vehicle_model"]) for run in numbers["runs"]] == [
        ("short", "paper", "half_car"),
        ("short", "full", "half_car"),
    ]
    for run in numbers["runs"]:
        assert run["window_s"] == 2.0
        assert {"v_x", "v_y", "yaw_rate", "omega_f", "omega_r", "a_y", "position"} <= set(run["rms"])
        assert all(0.0 < error < 10.0 for error in run["rms"].values())
    assert (tmp_path / "replay.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_wrong_with_the_data_is_printed_and_the_log_is_replayed(drive, tmp_path, capsys):
    log = read_log(drive)
    channels = {**log.channels, "yaw_rate": -log.channels["yaw_rate"]}
    path = write_log(tmp_path / "reversed.csv", replace(log, channels=channels))
    offroad("replay", path, "--structure", "full", "--window", "2", "--jobs", "1", "--out", tmp_path)
    assert "reversed: problem: yaw_rate" in capsys.readouterr().out
    offroad("replay", drive, "--structure", "full", "--window", "2", "--jobs", "1", "--out", tmp_path)
    assert "problem: yaw_rate" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "logs must name at least one file"),
        (("--window", "60"), "choose a shorter one"),
        (("--structure", "fulll"), "got 'fulll'"),
        (("--jobs", "0"), "jobs must be >= 1"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(options, words, drive, capsys):
    logs = (drive,) if options else ()
    assert offroad("replay", *logs, *options) == 1
    assert words in capsys.readouterr().err
