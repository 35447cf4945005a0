"""The mismatch study: what it makes of verdicts, and its figure."""

from __future__ import annotations

import math

import pytest

from agents.figures.mismatch import mismatch_figure
from agents.studies.mismatch import BARS, Mismatches, bounds_of, run_unit, summaries_of
from estimators.mismatch import MISMATCHES
from estimators.mismatch_runs import FILTERS, Verdict
from offroad_env.errors import InvalidParameter


def _verdict(name, mismatch, row, error, flagged=100):
    word = Verdict(
        filter=name,
        mismatch=mismatch,
        row=row,
        seed=0,
        errors=[error] * 19 if flagged else [],
        flagged=flagged,
        covered=1.0 if flagged else math.nan,
        flag_excited=1.0 if flagged else 0.0,
        excited=100,
        error_all=error,
        covered_all=1.0,
        end_error=error,
        end_sd=0.02,
        silent=False,
        real_time_factor=20.0,
    )
    sure = word._replace(silent=True, covered=0.0 if flagged else math.nan)
    return {"doubted": word._asdict(), "alone": sure._asdict()}


@pytest.fixture(scope="module")
def results():
    found = {("bound", "none", 3, 0, 60.0): {"doubting": 0.06, "moduli_only": 0.04, "certain": 0.002}}
    for name in FILTERS:
        for mismatch in MISMATCHES:
            found[name, mismatch, 3, 0, 60.0] = _verdict(name, mismatch, 3, 0.02)
            found[name, mismatch, 1, 0, 60.0] = _verdict(name, mismatch, 1, 0.9, flagged=0)
    return found


def test_a_run_without_flag_counts_against_the_flag_and_not_in_the_error(results):
    lines = summaries_of(results)
    assert len(lines) == len(FILTERS) * len(MISMATCHES)
    for line in lines:
        assert line.runs == 2
        assert line.error == pytest.approx(0.02)
        assert line.coverage == 1.0
        assert line.flag == pytest.approx(0.5)
        assert line.error_all == pytest.approx(0.46)
    for line in summaries_of(results, "alone"):
        assert line.silent == 2
        assert line.coverage == 0.0


def test_the_figure_shows_every_filter_under_every_mismatch(results):
    figure = mismatch_figure(summaries_of(results), summaries_of(results, "alone"), BARS)
    for axes in figure.axes:
        assert len(axes.patches) == len(FILTERS) * len(MISMATCHES)
    shown = {text.get_text() for text in figure.legends[0].get_texts()}
    assert shown == {"asked for", "by its own word"} | {candidate.title for candidate in FILTERS.values()}


def test_the_bound_names_what_costs_most(results):
    (line,) = bounds_of(results)
    assert line.certain < line.moduli_only < line.doubting
    unit = run_unit("bound", "none", 3, 101, 2.0)
    assert unit["certain"] < unit["moduli_only"] < unit["doubting"]


def test_wrong_names_are_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="only must name"):
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
