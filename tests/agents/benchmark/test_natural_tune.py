"""The search of knobs on natural soils: successive halving, and who drives with what it finds."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agents.benchmark import natural_tune, study
from agents.benchmark.natural_tune import NaturalTuneArgs, Stage, search, tune_common, write_settings
from agents.controllers import natural_tuned
from agents.controllers.nmpc import NmpcSettings
from offroad_env.errors import InvalidParameter

ARGS = NaturalTuneArgs(stages=(Stage(8, 4), Stage(2, 6)))


@pytest.fixture
def driven(monkeypatch):
    """Who drove how many episodes with what; a score is the distance of ``brake_share`` from 0.4."""
    kept = []

    def run_jobs(task, jobs, draws, **_):
        kept.append(({arm.name for arm in jobs.values()}, len(jobs), len(draws)))
        return {
            i: SimpleNamespace(scores=np.full(100, arm.cost), success=np.arange(100) >= (arm.cost < 0.01) * 3)
            for i, arm in jobs.items()
        }

    def made(arm, task, settings):
        aside = settings.get("z", 0.4) - 0.4 + settings.get("n", 0.18) - 0.18
        return SimpleNamespace(name=arm, cost=abs(settings["brake_share"] - 0.4) + abs(aside))

    monkeypatch.setattr(natural_tune, "run_jobs", run_jobs)
    monkeypatch.setattr(natural_tune, "_made", made)
    return kept


def test_the_better_candidates_drive_more_episodes_and_the_best_is_kept(driven):
    found = tune_common(ARGS)
    assert [entry[1:] for entry in driven] == [(8, 4), (2, 6), (6, 40)]
    best = found["oracle"].settings["brake_share"]
    shares = [row["brake_share"] for row in natural_tune._sample(natural_tune.BOXES["speed"], ARGS)]
    assert best == min(shares, key=lambda share: abs(share - 0.4))
    assert found["nominal"].settings == {**found["oracle"].settings, "n": 0.18}
    assert found["aware"].settings == {**found["oracle"].settings, "z": 1.0}


def test_predictive_control_shares_what_was_searched_for_the_truth(driven):
    pytest.importorskip("casadi")
    found = natural_tune.tune_predictive(ARGS)
    truth = found["nmpc_truth"].settings
    assert found["nmpc_nominal"].settings == {**truth, "n": 0.18}
    assert found["nmpc_belief"].settings == {**truth, "z": 0.4}
    NmpcSettings(**truth)
    # As many episodes as the search of an arm has; what is nominal's and the belief's alone comes on top.
    whole = sum(jobs * draws for _, jobs, draws in driven[:3])
    assert whole == NaturalTuneArgs().budget


@pytest.mark.parametrize(("most", "best"), [(0.02, 0.3), (0.04, 0.4), (1.0, 0.4)])
def test_who_fails_too_often_is_not_the_best_however_fast(driven, most, best):
    """Three of a hundred fail at a share of 0.4."""
    args = replace(ARGS, most_failures=most, stages=(Stage(2, 4),))
    found = search("oracle", [{"brake_share": 0.3}, {"brake_share": 0.4}], args)
    assert found.settings["brake_share"] == best
    assert natural_tune._MOST_FAILURES == 0.02


def test_what_was_found_is_written_and_the_rest_is_kept(driven, tmp_path):
    path = tmp_path / "tuned.py"
    path.write_text(Path(natural_tuned.__file__).read_text(encoding="utf-8"), encoding="utf-8")
    found = {("nmpc_truth", "common"): natural_tune.Found({"margin": 0.5}, 30.0, 44)}
    write_settings(path, ARGS, found)
    written = runpy.run_path(str(path))
    assert written["SETTINGS"] == {
        **natural_tuned.SETTINGS,
        ("speed", "nmpc_truth", "common"): {"margin": 0.5},
    }
    assert written["RUNS"]["speed nmpc_truth common"] == "seed 0, 44 episodes: 30 in training"
    assert written["__doc__"] == natural_tuned.__doc__


@pytest.mark.parametrize(
    ("agent", "task"), [("nmpc_truth", "speed"), ("nmpc_truth", "track"), ("oracle", "speed")]
)
def test_episodes_that_were_driven_with_other_knobs_do_not_count(monkeypatch, agent, task):
    """On tasks without knobs of its own, model-predictive control drives with those of `speed`."""
    before = study._stamp(task, agent, "natural")
    monkeypatch.setitem(natural_tuned.SETTINGS, ("speed", agent, "common"), {"brake_share": 0.123})
    assert study._stamp(task, agent, "natural") != before


def test_predictive_knobs_are_searched_for_one_task_alone(driven):
    with pytest.raises(InvalidParameter, match="speed"):
        natural_tune.tune_predictive(replace(ARGS, task="brake"))
