"""A drive as a log: what was driven can be driven again, and what was measured can be filtered."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

from agents.commands.cli import main
from agents.driving.recording import MeasuredRun
from agents.reports.figures import soil_belief
from estimators.logs import commands_at, f1tenth_log, plant_of, read_log, start_of, write_log
from offroad_env.physics import state as at
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.simulation.simulator import FULL_STEP, simulate_commands

REFERENCES = {"ref_x": at.X, "ref_y": at.Y, "ref_yaw": at.YAW, "ref_v_x": at.V_X, "ref_steer": at.STEER}


def offroad(*arguments):
    """Exit status of ``offroad`` with these arguments."""
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


def driven(duration=3.0, **options):
    """The log of an environment that somebody weaves through."""
    env = gym.make("offroad_env:OffroadBekker-v0", **options)
    env.reset(seed=2, options={"n": 0.55})
    run = MeasuredRun(env)
    for k in range(round(50 * duration)):
        env.step(np.array([0.2 * np.sin(0.04 * k), 0.3 if k % 60 < 45 else -0.4]))
        run.add(env)
    return run.log("weave")


def true_plant(log):
    """The plant of the description with the soil that only the references know."""
    plant = plant_of(log)
    assert plant.soil.n != log.references["ref_n_f"][0]
    return plant._replace(soil=plant.soil._replace(n=float(log.references["ref_n_f"][0])))


def test_a_drive_that_is_written_and_read_runs_again_on_the_same_path(tmp_path):
    path = tmp_path / "logs" / "track.csv"
    arguments = ("--duration", 4, "--n", 0.6, "--seed", 3, "--log", path, "--out", tmp_path)
    assert offroad("drive", *arguments) == 0
    log = read_log(path)
    assert log.config.soil.n == pytest.approx(0.7)  # the middle of the scenario's range, not the truth
    plant = true_plant(log)
    again = simulate_commands(
        plant, *start_of(log, plant), commands_at(log, log.t[:-1] + 1e-6), interval=0.01
    )
    known = ~np.isnan(log.references["ref_x"])
    assert known.sum() == 201
    for name, state in REFERENCES.items():
        # What torques lose by going through both axles and back.
        assert again.states[known, state] == pytest.approx(log.references[name][known], abs=1e-9), name


def test_the_papers_vehicle_runs_again_on_the_same_path():
    log = driven(model="paper", scenario="track")
    plant = true_plant(log)
    (x, warm), readings = start_of(log, plant), np.empty(at.READINGS_SIZE)
    states = [x.copy()]
    for command in commands_at(log, log.t[:-1] + 1e-6):
        paper_advance(x, warm, tuple(command.tolist()), plant, FULL_STEP, 2, readings)
        states.append(x.copy())
    # Once it has come to rest, it chatters: the model divides by its speed, and last bits grow.
    moving = log.references["ref_v_x"] > 0.1
    assert moving.sum() > 80
    for name in ("ref_x", "ref_y", "ref_yaw", "ref_v_x"):
        found = np.array(states)[moving, REFERENCES[name]]
        assert found == pytest.approx(log.references[name][moving], abs=1e-9), name


def test_a_log_holds_what_the_sensors_said_and_no_more():
    log = driven(duration=1.0)
    assert len(log) == 101
    rates = {name: int(np.isfinite(log.channels[name]).sum()) for name in ("a_x", "omega_f", "x", "steer")}
    # 100 Hz, 50 Hz, 10 Hz, and a command every 0.02 s.
    assert rates == {"a_x": 101, "omega_f": 51, "x": 11, "steer": 50}
    assert not {"v_x", "v_y", "yaw", "pitch"} & set(log.channels)


def test_a_ground_that_is_not_known_is_described_by_its_roughness_only(tmp_path):
    path = tmp_path / "run.parquet"
    pytest.importorskip("pyarrow")
    arguments = ("--duration", 1, "--log", path, "--log-ground", "unknown", "--out", tmp_path)
    assert offroad("drive", *arguments) == 0
    terrain = read_log(path).config.terrain
    assert terrain.kind == "unknown"
    assert 0.003 < terrain.rms < 0.05
    assert not terrain.waves


def test_an_episode_that_breaks_off_ends_its_log():
    env = gym.make("offroad_env:OffroadBekker-v0")
    env.reset(seed=2)
    run = MeasuredRun(env)
    env.step(np.zeros(2))
    run.add(env)
    env.unwrapped.state[at.Z] = -5.0  # as if it had dropped into a pit: the wheels find no contact
    *_, info = env.step(np.zeros(2))
    run.add(env)
    assert info["failure"]
    assert len(run.log("pit")) == 3


@pytest.mark.parametrize("name", ["run.txt", "run"])
def test_a_log_of_another_kind_is_refused(name, tmp_path, capsys):
    assert offroad("drive", "--log", tmp_path / name, "--out", tmp_path) == 1
    assert "log must end in .csv, .parquet or .mcap" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------------- offroad estimate


def test_estimate_reads_a_drive_and_writes_table_figure_and_numbers(tmp_path, capsys):
    path = write_log(tmp_path / "weave.csv", driven(duration=6.0))
    numbers = tmp_path / "numbers.json"
    assert offroad("estimate", path, "--filter", "parameter", "--out", tmp_path, "--json", numbers) == 0
    (found,) = json.loads(numbers.read_text())["logs"]
    assert abs(found["n"] - 0.55) < 2.0 * found["sd"]
    assert found["truth_at_end"] == pytest.approx(0.55)
    assert found["quality"]["channels"]
    assert (tmp_path / "estimate_weave_online_parameter_ukf.png").stat().st_size > 10000
    assert len((tmp_path / "estimate_weave_online_parameter_ukf.csv").read_text().splitlines()) == 602
    assert "signal/noise" in capsys.readouterr().out


def test_estimate_gives_the_soil_with_one_number_and_one_interval_a_quantity(tmp_path, capsys):
    path = write_log(tmp_path / "weave.csv", driven(duration=6.0))
    numbers = tmp_path / "numbers.json"
    options = ("--structure", "full", "--details", "--out", tmp_path, "--json", numbers)
    assert offroad("estimate", path, *options) == 0
    (found,) = json.loads(numbers.read_text())["runs"]
    n = found["soil"]["n"]
    assert n["low"] < 0.55 < n["high"]
    assert n["low"] < n["mean"] < n["high"]
    assert set(found["soil"]) == {"n", "phi", "k_phi", "c", "K"}
    assert {"lateral", "pull", "resistance"} <= set(found["holds"])
    assert 0.0 <= found["valid_share"] <= 1.0
    assert found["structure"][0]["structure"] == "full"
    assert set(found["prediction"]) == {"1", "3"}
    assert (tmp_path / "soil_weave.png").stat().st_size > 10000
    printed = capsys.readouterr().out
    assert printed.count("sinkage exponent n") == 1
    assert found["sentence"] in printed
    assert "n given it" in printed


def test_a_figure_that_fails_loses_no_number(tmp_path, capsys, monkeypatch):
    def broken(report):
        raise ValueError("no axis has room for this")

    monkeypatch.setattr(soil_belief, "soil_belief_figure", broken)
    path = write_log(tmp_path / "weave.csv", driven(duration=6.0))
    numbers = tmp_path / "n.json"
    with pytest.raises(ValueError, match="no axis"):
        main(["estimate", str(path), "--structure", "full", "--out", str(tmp_path), "--json", str(numbers)])
    assert "sinkage exponent n" in capsys.readouterr().out
    assert json.loads(numbers.read_text())["runs"][0]["log"] == "weave"


def test_estimate_falls_back_to_a_filter_where_no_torque_was_measured(tmp_path, capsys):
    path = write_log(tmp_path / "forced.csv", driven(duration=4.0, model="paper"))
    numbers = tmp_path / "numbers.json"
    assert offroad("estimate", path, "--out", tmp_path, "--json", numbers) == 0
    assert "can only be filtered: --filter online_joint_ukf" in capsys.readouterr().out
    assert json.loads(numbers.read_text())["filter"] == "online_joint_ukf"


def test_estimate_blames_the_data_before_the_model(tmp_path, capsys):
    log = driven(duration=4.0)
    flat = np.where(np.isnan(log.channels["yaw_rate"]), np.nan, 0.25)
    write_log(
        tmp_path / "stuck.csv", type(log)(**{**vars(log), "channels": log.channels | {"yaw_rate": flat}})
    )
    assert offroad("estimate", tmp_path / "stuck.csv", "--out", tmp_path) == 1
    said = capsys.readouterr()
    assert "yaw_rate stays at exactly 0.25" in said.err
    assert "--accept" in said.err
    assert not list(tmp_path.glob("estimate_*"))


def test_estimate_refuses_measured_drives_on_a_hard_floor(offroad_data, tmp_path, capsys):
    drive = f1tenth_log(offroad_data("f1tenth_indoor") / "DS1.csv", corrected=True)
    write_log(tmp_path / "DS1.csv", drive)
    assert offroad("estimate", tmp_path / "DS1.csv", "--accept", "--out", tmp_path) == 1
    assert "stands on hard ground" in capsys.readouterr().err


def test_estimate_takes_logs_of_an_independent_simulator(offroad_data, tmp_path):
    """A multibody vehicle on a soil grid: the filter is certain of a wrong n, the model evidence is not."""
    path = offroad_data("chrono_scm") / "clay_0.01_sin02_R0.csv"
    numbers = tmp_path / "numbers.json"
    options = ("--filter", "joint", "--n-prior", 0.6, "--out", tmp_path, "--json", numbers)
    assert offroad("estimate", path, *options) == 0
    (found,) = json.loads(numbers.read_text())["logs"]
    assert 0.2 < found["n"] < 0.8
    true_n = 0.5
    assert found["valid"]
    assert abs(found["n"] - true_n) > 3.0 * found["sd"]
    assert abs(found["n"] - true_n) < 2.0 * found["robust_sd"]
    assert not found["robust_valid"]
    mean, sd = found["evidence"]
    assert abs(mean - true_n) < 2.0 * sd
    assert found["truth_at_end"] is None
