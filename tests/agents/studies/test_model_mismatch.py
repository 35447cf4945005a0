"""The mismatch study: what it makes of scores, and its figure."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.studies.model_mismatch.figure import mismatch_figure
from agents.studies.model_mismatch.study import BARS, Mismatches, bounds_of, run_unit, summaries_of
from estimators.analysis.scores import failed_score
from estimators.experiments.mismatch_comparison import COMPARED, MismatchScore
from estimators.experiments.model_mismatch import MISMATCHES
from estimators.filters.registry import FILTERS
from offroad_env.errors import InvalidParameter


def _unit(name, mismatch, row, error, flagged=100):
    robust = MismatchScore(
        filter=name,
        mismatch=mismatch,
        row=row,
        seed=0,
        flag_excited=1.0 if flagged else 0.0,
        excited=100,
        real_time_factor=20.0,
        score=failed_score(np.full(101, 0.5), 5)._replace(
            median_error=error,
            coverage=1.0,
            coverage_valid=1.0 if flagged else math.nan,
            flagged=flagged,
            flagged_errors=(error,) * 19 if flagged else (),
        ),
    )
    stated = robust._replace(
        score=robust.score._replace(silent=True, coverage_valid=0.0 if flagged else math.nan)
    )
    return {
        part: {**run._asdict(), "score": run.score._asdict()}
        for part, run in (("robust", robust), ("stated", stated))
    }


@pytest.fixture(scope="module")
def results():
    found = {("bound", "none", 3, 0, 60.0): {"all_uncertain": 0.06, "moduli_only": 0.04, "certain": 0.002}}
    for name in COMPARED:
        for mismatch in MISMATCHES:
            found[name, mismatch, 3, 0, 60.0] = _unit(name, mismatch, 3, 0.02)
            found[name, mismatch, 1, 0, 60.0] = _unit(name, mismatch, 1, 0.9, flagged=0)
    return found


def test_a_run_without_flag_counts_against_the_flag_and_not_in_the_error(results):
    lines = summaries_of(results)
    assert len(lines) == len(COMPARED) * len(MISMATCHES)
    for line in lines:
        assert line.runs == 2
        assert line.error == pytest.approx(0.02)
        assert line.coverage == 1.0
        assert line.flag == pytest.approx(0.5)
        assert line.error_all == pytest.approx(0.46)
    for line in summaries_of(results, "stated"):
        assert line.silent == 2
        assert line.coverage == 0.0


def test_the_figure_shows_every_filter_under_every_mismatch(results):
    figure = mismatch_figure(summaries_of(results), summaries_of(results, "stated"), BARS)
    for axes in figure.axes:
        assert len(axes.patches) == len(COMPARED) * len(MISMATCHES)
    shown = {text.get_text() for text in figure.legends[0].get_texts()}
    assert shown == {"required", "as stated by the filter"} | {FILTERS[name].title for name in COMPARED}


@pytest.mark.check
def test_the_bound_names_what_costs_most(results):
    (line,) = bounds_of(results)
    assert line.certain < line.moduli_only < line.all_uncertain
    unit = run_unit("bound", "none", 3, 101, 2.0)
    assert unit["certain"] < unit["moduli_only"] < unit["all_uncertain"]


def test_wrong_names_are_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="only must be one of"):
        Mismatches(out=tmp_path, only=("kalman",)).run()
    with pytest.raises(InvalidParameter, match="under must name"):
        Mismatches(out=tmp_path, under=("wind",)).run()
    with pytest.raises(InvalidParameter, match="first_seed"):
        Mismatches(out=tmp_path, first_seed=20).run()
    with pytest.raises(InvalidParameter, match="seeds"):
        Mismatches(out=tmp_path, first_seed=18, seeds=3).run()


def test_seeds_that_nobody_has_looked_at_can_be_asked_for():
    study = Mismatches(first_seed=5, seeds=2, only=("robust",), under=("all",), rows=(3,))
    assert {key[3] for key in study._units()} == {5, 6}
