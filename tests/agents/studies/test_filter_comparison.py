"""Studies of the filters: kept units, and the arithmetic between runs and tables."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from agents.commands.cli import main
from agents.studies.changing_soil.figure import changing_figure
from agents.studies.changing_soil.study import change_lines, changes_of
from agents.studies.filter_comparison.figure import filters_figure
from agents.studies.filter_comparison.study import Filters, lines_of, totals_of
from agents.studies.information_gate.figure import gate_figure
from agents.studies.information_gate.study import MAP_PHASES, ONLINE_PHASES, phase_lines
from agents.studies.prediction.figure import prediction_figure
from agents.studies.prediction.study import MODELS, SOURCES, predict, prediction_lines
from agents.studies.runner import checked_rows, checked_seeds, run_units, stamp_of
from agents.studies.sensors.figure import sensors_figure
from agents.studies.sensors.study import sensor_lines
from estimators.experiments.buzhardt_tallapragada import ROWS, row_plant, row_truth
from estimators.models.half_car_on_map import ETA
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at


def square(base, number):
    """Work of a unit; notes every call in the file ``base``."""
    with open(base, "a", encoding="utf-8") as file:
        file.write(f"{number}\n")
    return {"square": number**2, "limit": math.inf}


@pytest.fixture
def calls(tmp_path):
    """(path of the note, function that reads it)."""
    note = tmp_path / "calls"
    return str(note), lambda: note.read_text().split() if note.exists() else []


def test_units_that_are_there_are_not_run_again(tmp_path, calls):
    note, read = calls
    path, label = tmp_path / "parts" / "x.jsonl", {"label": "x", "n_jobs": 1}
    first = run_units(path, square, {(note, 2): "a", (note, 3): "a"}, **label)
    assert first[note, 3] == {"square": 9, "limit": math.inf}
    again = run_units(path, square, {(note, 2): "a", (note, 3): "a", (note, 4): "a"}, **label)
    assert list(again) == [(note, 2), (note, 3), (note, 4)]
    assert again[note, 2] == first[note, 2]
    assert read() == ["2", "3", "4"]


def interrupted(base, number):
    """Work that somebody stops at the third unit."""
    if number == 4:
        raise KeyboardInterrupt
    return square(base, number)


def test_a_run_that_is_stopped_says_what_is_kept_and_how_to_go_on(tmp_path, calls):
    note, _ = calls
    units = {(note, 2): "a", (note, 3): "a", (note, 4): "a"}
    with pytest.raises(KeyboardInterrupt, match=r"2 of 3 squares are kept in .*the same command goes on"):
        run_units(tmp_path / "x.jsonl", interrupted, units, label="squares", n_jobs=1)


def test_units_of_other_sources_and_lines_cut_off_are_run_again(tmp_path, calls):
    note, read = calls
    path, label = tmp_path / "x.jsonl", {"label": "x", "n_jobs": 1}
    run_units(path, square, {(note, 2): "old", (note, 3): "old"}, **label)
    path.write_bytes(path.read_bytes()[:-20])
    done = run_units(path, square, {(note, 2): "new", (note, 3): "old"}, **label)
    assert [done[note, k]["square"] for k in (2, 3)] == [4, 9]
    assert read() == ["2", "3", "2", "3"]
    # The line that was cut off does not swallow the next one.
    assert run_units(path, square, {(note, 3): "old"}, **label)[note, 3]["square"] == 9
    assert len(read()) == 4
    assert any(json.loads(line)["stamp"] == "new" for line in path.read_text().splitlines() if "new" in line)


def test_stamp_is_that_of_the_sources():
    assert stamp_of("estimators.filters.joint_ukf") != stamp_of("estimators.filters.joint_bank")
    assert stamp_of("estimators.filters.joint_ukf", "estimators.filters.joint_bank").startswith(
        stamp_of("estimators.filters.joint_ukf")
    )


def test_rows_and_seeds_out_of_range_are_refused():
    assert checked_rows((3, 1, 3)) == (3, 1)
    assert checked_seeds(2, (5, 6, 7)) == (5, 6)
    for rows in ((), (0,), (9,)):
        with pytest.raises(InvalidParameter, match="rows must be"):
            checked_rows(rows)
    with pytest.raises(InvalidParameter, match="seeds must be in"):
        checked_seeds(4, (5, 6, 7))
    with pytest.raises(InvalidParameter, match="'kalman'"):
        Filters(only=("kalman",))._units()


def _score(**kwargs):
    score = {
        "mse": 1e-4, "late_mse": 4e-6, "coverage": 0.95, "coverage_late": 0.95, "coverage_valid": 0.96,
        "valid": 0.5, "nis": 5.1, "nis_count": 1000, "channels": 5, "time_to_5pct": 2.0, "end": 0.5,
        "end_sd": 0.002, "wrong": False, "repairs": 0, "lost": 0, "seconds": 0.3, "updates": 1000,
    }  # fmt: skip
    return {**score, **kwargs}


def test_table_of_filters_is_that_of_its_runs():
    results = {}
    for row, bound in ((1, 0.001), (2, 0.004)):
        for seed in (0, 1):
            results["bound", row, seed, 30.0] = {"bound": [bound] * 4}
            results["map_ukf_bank", row, seed, 30.0] = _score(wrong=seed == 1, nis=5.0 + seed)
            results["map_ekf", row, seed, 30.0] = _score(mse=math.inf if seed else 1e-3, late_mse=math.inf)
    lines = lines_of(results)
    bank = next(line for line in lines if (line.filter, line.row) == ("map_ukf_bank", 1))
    assert bank.rmse_after_20s == pytest.approx(0.002)
    assert bank.ratio == pytest.approx(2.0)
    assert (bank.nis, bank.wrong_with_flag) == (5.5, 1)
    assert not bank.nis_band.holds(bank.nis)
    assert bank.microseconds == pytest.approx(300.0)
    totals = {total.filter: total for total in totals_of(results, lines, 0.01)}
    # sqrt(2 * 0.5) over the two rows.
    assert totals["map_ukf_bank"].ratio == pytest.approx(1.0)
    assert totals["map_ukf_bank"].real_time == pytest.approx(0.01 / 300e-6)
    assert totals["map_ukf_bank"].coverage_valid == pytest.approx(0.96)
    assert totals["map_ekf"].stopped == 2
    assert filters_figure(
        [line for line in lines if line.filter == "map_ukf_bank"], [totals["map_ukf_bank"]]
    ).axes


def test_changes_are_found_and_answers_timed():
    t = 0.05 * np.arange(1201)
    truth = np.interp(t, [10.0, 10.05, 20.0, 30.0], [0.5, 0.7, 0.7, 0.5])
    step, ramp = changes_of(t, truth)
    assert (step.begin, step.end, step.until) == pytest.approx((10.0, 10.05, 20.0))
    assert (ramp.half, ramp.before, ramp.after) == pytest.approx((25.0, 0.7, 0.5))
    late = np.interp(t - 2.0, t, truth, left=0.5)
    run = {"n": late, "sd": np.full(t.shape, 0.01), "valid": np.ones(t.shape, bool), "renewed": math.nan}
    unit = {"truth": truth.tolist(), "runs": {"late": run}}
    line = change_lines({("paper", "both", 0): unit})[0]
    assert line.delay == pytest.approx(2.0, abs=0.06)
    assert line.wrong == pytest.approx(2.0 / 50.0, abs=0.01)
    assert len(changing_figure({("paper", "both"): unit}, step=0.05).axes) == 1


def test_phases_of_the_gate_are_cut_where_they_end():
    sd = np.concatenate((np.linspace(0.05, 0.01, 200), np.full(200, 0.02), np.full(201, 0.01)))
    unit = {
        "bound": (0.5 * sd).tolist(),
        "truth": [0.5] * 601,
        "runs": {"map_joint_ukf": {"n": [0.5] * 601, "sd": sd}},
    }
    lines = phase_lines({("map", 0, 0.02): unit})
    assert [line.phase for line in lines] == ["steering", "straight", "steering again"]
    assert (lines[0].sd_begin, lines[0].sd_end) == pytest.approx((0.05, 0.01))
    assert (lines[1].sd_begin, lines[1].sd_end, lines[1].least_over_bound) == pytest.approx((0.02, 0.02, 2.0))
    board = {"truth": [0.8] * 800, "runs": {"online_joint_ukf": {"n": [0.8] * 800, "sd": [0.02] * 800}}}
    assert gate_figure({("map", 0, 0.02): unit, ("online", 0, 0.0): board}, MAP_PHASES, ONLINE_PHASES).axes
    assert math.isnan(phase_lines({("online", 0, 0.0): board})[2].least_over_bound)


def test_a_prediction_with_the_true_soil_repeats_the_truth_and_with_another_does_not():
    truth = row_truth(ROWS[2], duration=3.0)
    inputs, dt = truth.inputs, 0.01
    start = truth.run.states[0, :ETA]
    place = truth.run.states[:, [at.X, at.Y]]
    same = predict(row_plant(ROWS[2]), start, inputs, dt)
    np.testing.assert_allclose(same, place, atol=1e-9)
    other = predict(row_plant(ROWS[2], n=0.8), start, inputs, dt)
    assert np.hypot(*(other[-1] - place[-1])) > 0.05
    with pytest.raises(SolverFailure):
        predict(
            row_plant(ROWS[2]), start, np.where(np.arange(len(inputs))[:, None] > 100, np.nan, inputs), dt
        )


def test_table_of_predictions_holds_medians_and_counts_what_left_the_model():
    unit = {model: {source: [1.0, 3.0, math.inf] for source in SOURCES} for model in MODELS}
    lines = prediction_lines({(4, 0): unit})
    assert len(lines) == len(MODELS) * len(SOURCES)
    assert (lines[0].row, lines[0].median, lines[0].left, lines[0].predictions) == (4, 3.0, 1, 3)
    assert math.isinf(lines[0].high)
    assert len(prediction_figure(lines).axes) == 2


def test_table_of_sensors_averages_information_over_seeds():
    results = {
        ("imu", 2, seed, 30.0): {"bound": [bound] * 3, "score": _score()}
        for seed, bound in ((0, 0.1), (1, 10.0))
    }
    line = sensor_lines(results)[0]
    assert line.bound_rmse_after_20s == pytest.approx(0.1 * math.sqrt(2.0), rel=1e-3)
    assert line.rmse_after_20s == pytest.approx(0.002)
    assert sensors_figure([line]).axes


@pytest.mark.check
def test_the_command_prints_draws_and_goes_on_where_it_stopped(tmp_path, capsys):
    arguments = ["filters", "--quick", "--rows", "6", "--only", "known", "--n-jobs", "1"]
    arguments += ["--out", str(tmp_path), "--json", str(tmp_path / "filters.json")]
    for _ in range(2):
        with pytest.raises(SystemExit) as end:
            main(["reproduce", *arguments])
        assert end.value.code == 0
    numbers = json.loads((tmp_path / "filters.json").read_text())
    (line,) = numbers["rows"]
    assert (line["filter"], line["row"], line["seeds"]) == ("parameter_ukf_known_state", 6, 1)
    assert line["coverage"] > 0.9
    assert 0.0 < line["bound_rmse_after_20s"] < line["rmse_after_20s"]
    assert (tmp_path / "filters.png").stat().st_size > 10_000
    # A unit each for the bound and the filter: the second time they were read.
    assert len((tmp_path / "filters.jsonl").read_text().splitlines()) == 2
    assert "x real time" in capsys.readouterr().out
