"""The report of a diagnosis: complete, self-contained, and the same in page, file and terminal."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from agents.commands.diagnose import Diagnose
from agents.reports.diagnosis import render_diagnosis
from estimators.discrepancy.checks.misfit import _binned
from estimators.discrepancy.checks.whiteness import likelihood_gains, whiteness_of
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.evidence import gather
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.next_experiment import advise
from estimators.discrepancy.search.result import Alternative, Cause
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.wording import terminal_lines

_SHARE = 0.03  #: rolling resistance that is added
#: Effects that compete: the cause, what is like it, and some that these pages must show as rejected.
_LIBRARY = (
    "rolling_resistance", "grade", "aero_drag", "torque_scale", "payload", "wheel_radius_scale", "steer_lag",
    "yaw_moment", "accel_bias_z", "n_step", "n_trend",
)  # fmt: skip


@pytest.fixture(scope="module")
def found():
    """A diagnosis of a log with more rolling resistance than stated."""
    case = draw_case(35, road="flat", gnss=True, duration=40.0)
    diagnosis = diagnose([simulated_log(case, FAULTS["rolling_resistance"](_SHARE))], library=_LIBRARY)
    return diagnosis, summarise(diagnosis, gather(diagnosis))


@pytest.fixture(scope="module")
def folder(found, tmp_path_factory):
    """What the command writes about it."""
    folder = tmp_path_factory.mktemp("report")
    Diagnose(logs=(folder / "run.csv",), out=folder).publish(*found)
    return folder


@pytest.fixture(scope="module")
def numbers(folder):
    return json.loads((folder / "diagnosis.json").read_text())


def test_the_page_has_ten_parts_and_needs_nothing_from_elsewhere(folder):
    page = (folder / "diagnosis.html").read_text()
    assert len(page) < 2_000_000
    assert re.findall(r"<h2>(\d+)\. ", page) == [str(i) for i in range(1, 11)]
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", page)
    assert "<script" not in page
    assert "url(" not in page


def test_page_and_file_hold_the_same_numbers(folder, numbers):
    page = (folder / "diagnosis.html").read_text()
    assert f"{numbers['n']['single']['value']:.3f}" in page
    for gain in numbers["gain"].values():
        assert f">{gain['nominal']:.3g}<" in page
        assert f">{gain['extended']:.3g}<" in page
    for one in numbers["prediction"]:
        assert f">{one['nominal']:.3g}<" in page
    assert next(iter(numbers["checks"]["logs"].values())) in page
    assert numbers["command"] in page


def test_the_file_holds_what_the_command_promises(numbers):
    assert set(numbers) >= {
        "verdict", "sentence", "causes", "unexplained", "not_testable", "gain", "n", "next_experiment",
        "checks", "prediction", "misfit", "scores", "isolability", "profiles", "whiteness",
        "split_seconds", "made_by",
    }  # fmt: skip
    assert {one["horizon"] for one in numbers["prediction"]} >= {1.0, 3.0}
    assert {one["quantity"] for one in numbers["prediction"]} == {"position", "speed", "heading"}


def test_the_terminal_gets_at_most_25_lines(found):
    # Three names of files follow.
    assert len(terminal_lines(found[1])) <= 22


def test_the_environment_drives_the_vehicle_that_was_diagnosed(folder):
    speeds = []
    for model in ("full", str(folder / "extended.json")):
        env = gym.make("offroad_env:OffroadBekker-v0", model=model)
        env.reset(seed=3, options={"n": 0.9})
        for _ in range(20):
            env.step(np.array([0.0, 0.4]))
        speeds.append(env.unwrapped.state[5])
        env.close()
    # About half a second of 0.03 g, on both axles' slip.
    assert speeds[1] < speeds[0] - 0.03


def test_forecasts_of_the_extended_model_miss_by_less(found):
    table = {(one.quantity, one.horizon): one for one in found[1].evidence.predictions}
    far = table["position", 3.0]
    assert far.extended < 0.7 * far.nominal
    assert far.count >= 3
    # Without a model the speed would drift by the added force alone.
    assert table["speed", 3.0].extended < 0.3 * 3.0 * 9.81 * _SHARE


def test_a_profile_has_its_minimum_at_the_fit_and_holds_the_truth(found):
    (profile,) = found[1].evidence.profiles
    assert profile.low < profile.size < profile.high
    lowest = profile.sizes[int(np.argmin(profile.likelihood_ratio))]
    assert lowest == pytest.approx(profile.size, abs=0.5 * profile.deviation)
    assert (profile.high - profile.low) == pytest.approx(2.0 * 1.96 * profile.deviation, rel=0.2)
    assert profile.low - profile.deviation < _SHARE < profile.high + profile.deviation


def test_what_the_likelihood_gains_by_channel_is_what_the_whole_gains(found):
    nominal, extended = found[0].on_test_data
    seconds = sum(run.windows.count.sum() * run.step for run in nominal.fit.runs)
    total = sum(one.gain for one in likelihood_gains(nominal, extended)) * seconds

    def loss(held):
        white = held.fit.noise.whiten(held.residual)
        return 0.5 * float(white @ white) + held.fit.noise.log_scale()

    # The windows end within a block of a second.
    assert total == pytest.approx(loss(nominal) - loss(extended), rel=0.15)


def test_noise_that_was_taken_for_white_is_seen_not_to_be(found):
    wrong = replace(found[0].search.nominal, white=True).with_learned_noise()
    assert not all(one.white for one in whiteness_of(wrong))
    right = whiteness_of(found[0].model)
    assert sum(one.white for one in right) >= len(right) - 2


def test_where_a_residual_depends_on_a_quantity_its_bins_leave_their_band():
    rng = np.random.default_rng(0)
    blocks = np.repeat(np.arange(200), 20)
    bins = rng.integers(0, 8, 4000)
    noise = np.repeat(rng.standard_normal(200), 20)  # errs alike for a second
    mean, band, share = _binned(noise, bins, np.bincount(bins), blocks)
    assert (np.abs(mean) < band).all()
    assert share < 0.02
    mean, band, share = _binned(noise + 0.5 * (bins - 3.5), bins, np.bincount(bins), blocks)
    assert (np.abs(mean) > band).sum() >= 4
    assert 0.3 < share < 0.8


def test_no_single_n_is_quoted_where_explanations_as_good_put_it_elsewhere(found):
    diagnosis = found[0]
    assert summarise(diagnosis).n.single is not None
    (cause,) = diagnosis.causes
    grade = replace(cause.best.candidate, effect="grade")
    other = replace(cause.best, candidate=grade, ground=cause.best.ground + 0.1)
    open_set = replace(diagnosis, causes=(replace(cause, alternatives=(cause.best, other)),))
    summary = summarise(open_set)
    assert summary.n.single is None
    assert set(summary.n.after) == {"rolling_resistance", "grade"}
    assert any("no single value" in line for line in terminal_lines(summary))


def test_more_data_never_raise_a_limit_and_the_advice_names_the_best(found):
    advice = found[1].evidence.advice
    for trial in advice.trials:
        assert all(trial.limits[name] <= 1.001 * advice.limits[name] for name in advice.limits)
    assert advice.best is advice.trials[0]
    assert advice.best.limits[advice.effect] < advice.limits[advice.effect]


@pytest.mark.parametrize(
    ("now", "then", "said"),
    [
        (0.04, 0.02, "(detectable from 0.02 instead of 0.04)"),
        (
            3e3,
            0.02,
            "(detectable from 0.02; these data alone do not show it at any plausible size, up to 0.09)",
        ),
        (1e150, 1e149, "(even then not detectable at any plausible size, up to 0.09)"),
    ],
)
def test_a_limit_beyond_the_plausible_is_said_in_words(found, now, then, said):
    advice = found[1].evidence.advice
    best = replace(advice.best, power=None, limits={"grade": then})
    advice = replace(advice, effect="grade", best=best, limits={"grade": now}, most=0.09)
    assert said in advice.sentence


@pytest.mark.check
def test_grade_and_rolling_resistance_are_told_apart_by_driving_both_ways(found):
    diagnosis = found[0]
    (cause,) = diagnosis.causes
    first = diagnosis.search.first
    grade = next(candidate for candidate in first.candidates if candidate.effect == "grade")
    other = Alternative(
        candidate=grade, size=0.03, deviation=0.01, likelihood_ratio=1.0, ground=0.0, ground_deviation=0.01
    )
    # So small that these data alone cannot tell them apart.
    best = replace(cause.best, size=0.002)
    open_set = replace(
        diagnosis,
        causes=(Cause(alternatives=(best, other), likelihood_ratio=cause.likelihood_ratio, p_value=0.0),),
    )
    advice = advise(open_set)
    power = {trial.name: trial.power for trial in advice.trials}
    assert "grade" in advice.question
    assert power["both_ways"] > power["steady"] + 0.1
    assert advice.best.power >= power["both_ways"] >= advice.power


def test_effects_that_cannot_be_tested_say_why(found):
    diagnosis = replace(
        found[0], missing={"torque_scale": "torque_f or torque_r"}, not_testable={"payload": 1.0}
    )
    reasons = {score.effect: score.reason for score in summarise(diagnosis).scores}
    assert reasons["torque_scale"] == "the log has no torque_f or torque_r"
    assert "not plausible" in reasons["payload"]
    assert reasons["rolling_resistance"] == ""


@pytest.mark.check
def test_data_that_are_not_informative_still_make_a_page():
    log = simulated_log(draw_case(5, drive="steady", road="flat", gnss=False, duration=24.0))
    channels = {name: values for name, values in log.channels.items() if not name.startswith("omega")}
    diagnosis = diagnose([replace(log, channels=channels)])
    assert diagnosis.verdict == "NOT TESTABLE"
    summary = summarise(diagnosis, gather(diagnosis))
    page = render_diagnosis(summary, "offroad diagnose run.csv")
    assert "NOT TESTABLE" in page
    assert "the log has no omega_f" in "".join(score.reason for score in summary.scores)
    assert "position" in summary.next_experiment.alternative
    assert summary.evidence.predictions == ()
