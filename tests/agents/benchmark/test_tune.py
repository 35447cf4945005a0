"""The tuner, on a made-up score whose best knobs are known."""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.benchmark import tune
from agents.controllers import tuned
from agents.controllers.arms import ARMS, ArmSettings


@pytest.fixture
def easy(monkeypatch):
    """Score: squared distance of the common knobs from a point; counts the episodes driven."""
    driven = dict.fromkeys(ARMS, 0)

    def scores(name, candidates, args, episodes, progress):
        driven[name] += episodes * len(candidates)
        return np.array([(c.margin - 0.9) ** 2 + (c.slip_angle - 0.3) ** 2 for c in candidates])

    monkeypatch.setattr(tune, "_scores", scores)
    monkeypatch.setattr(tune, "SETTINGS", {("speed", name): {} for name in ARMS})  # no search before
    return driven


def test_every_arm_gets_the_same_budget_and_finds_the_best(easy):
    found = tune.tune_scenario(tune.TuneArgs())
    assert {result.episodes for result in found.values()} == set(easy.values())
    assert len(set(easy.values())) == 1
    best = {(result.settings.margin, result.settings.slip_angle) for result in found.values()}
    assert len(best) == 1  # the final is shared, so nobody is left behind
    assert best.pop() == pytest.approx((0.9, 0.3), abs=0.08)


def test_knobs_stay_inside_their_ranges(easy):
    finalists, _ = tune.search_arm("nominal", tune.TuneArgs(spread=5.0))
    for settings in finalists:
        for knob, (low, high) in tune.knobs("speed", "nominal").items():
            assert low <= getattr(settings, knob) <= high


def test_the_written_module_gives_the_settings_back(tmp_path):
    settings = ArmSettings(margin=0.8, slip_angle=0.25, feed_forward=0.5, integral=0.3, n=0.1, z=1.5)
    found = {name: tune.Tuned(settings=settings, score=42.0, episodes=9) for name in ARMS}
    tune.write_settings(tmp_path / "tuned.py", tune.TuneArgs(scenario="patches"), found)
    table = runpy.run_path(str(tmp_path / "tuned.py"))["SETTINGS"]
    corners = {"margin": 0.8, "slip_angle": 0.25, "feed_forward": 0.5}
    assert table["patches", "nominal"] == {**corners, "integral": 0.3, "n": 0.1}
    assert ("speed", "oracle") in table


def test_a_search_is_written_where_the_arms_read_it(monkeypatch):
    written = []
    monkeypatch.setattr(sys, "argv", ["tune", "--scenario", "brake"])
    monkeypatch.setattr(tune, "tune_scenario", lambda args, progress: {})
    monkeypatch.setattr(
        tune, "write_settings", lambda path, args, tuned, place: written.append((path, place))
    )
    tune.main()
    assert written == [(Path(importlib.import_module("agents.controllers.tuned").__file__), None)]


def test_common_knobs_are_those_of_the_oracle_and_nominal_gets_the_best_place(monkeypatch, tmp_path):
    def scores(name, candidates, args, episodes, progress):
        assert name == "nominal"
        assert {c.margin for c in candidates} == {0.77}
        return np.array([abs(c.n - 0.4) for c in candidates])

    monkeypatch.setattr(tune, "_scores", scores)
    monkeypatch.setattr(tune, "SETTINGS", {("speed", "oracle"): {"margin": 0.77}})
    args = tune.TuneArgs(knobs="common")
    place, score = tune.tune_place(args)
    assert place == pytest.approx(0.375)
    assert score == pytest.approx(0.025)
    tune.write_settings(tmp_path / "tuned.py", args, {}, (place, score))
    tune.write_settings(tmp_path / "tuned.py", tune.TuneArgs(scenario="brake"), {}, (0.5, 9.0))
    written = runpy.run_path(str(tmp_path / "tuned.py"))
    assert (written["COMMON_PLACES"]["speed"], written["COMMON_PLACES"]["brake"]) == (0.375, 0.5)
    assert written["SETTINGS"] == tuned.SETTINGS
    assert written["RUNS"]["speed common"] == "seed 0, 9 x 30 episodes: nominal 0.025"
