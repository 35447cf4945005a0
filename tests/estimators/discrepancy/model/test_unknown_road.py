"""Scores on an unknown road: null simulations set how far they scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.null_simulations import p_value_of_gain, variance_inflation
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT


def test_white_noise_widens_nothing_and_a_common_push_widens_what_it_looks_like():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((4000, 3))
    noise = rng.standard_normal((4000, 400))
    assert variance_inflation(columns, noise, 1, np.ones(1)) == pytest.approx([1.0, 1.0], abs=0.25)
    push = 2.0 * columns[:, 1:2] / np.linalg.norm(columns[:, 1]) * rng.standard_normal(400)
    assert variance_inflation(columns, noise + push, 1, np.ones(1)) == pytest.approx([5.0, 1.0], rel=0.25)


def test_a_push_along_what_is_fitted_anyway_widens_nothing():
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((4000, 2))
    push = 0.2 * columns[:, :1] * rng.standard_normal(400)
    null = rng.standard_normal((4000, 400)) + push
    assert variance_inflation(columns, null, 1, np.zeros(1)) == pytest.approx([1.0], abs=0.25)
    # Each with all others: the first carries the push, the second does not.
    both = variance_inflation(columns, null, 0, np.zeros(1))
    assert both[0] > 10.0
    assert both[1] == pytest.approx(1.0, abs=0.25)


def test_gains_are_judged_by_those_of_null_simulations():
    assert p_value_of_gain(30.0, 12, None) == pytest.approx(chi2.sf(30.0, 12))
    null = 2.0 * chi2.rvs(12, size=2000, random_state=1)
    assert p_value_of_gain(60.0, 12, null) == pytest.approx(chi2.sf(30.0, 12), rel=0.3)
    assert p_value_of_gain(30.0, 12, 0.1 * null) == pytest.approx(chi2.sf(30.0, 12))


def test_only_an_unknown_road_is_drawn_and_it_shakes_as_much_as_the_true_one():
    level, rough = (
        fit_runs([RunModel(simulated_log(draw_case(51, road=road, duration=12.0, gnss=True)), use=FIT)])
        for road in ("flat", "unknown")
    )
    assert level.null is None
    residual = rough.residual
    for run in rough.runs:
        for channel in run.channels:
            if channel.name in ("a_z", "pitch_rate"):
                drawn = np.median(rough.null.residuals[channel.rows].std(axis=0))
                assert drawn == pytest.approx(residual[channel.rows].std(), rel=0.5)


def test_an_effect_that_is_held_at_nothing_takes_nothing_away_from_the_others():
    """Its column is zero, since its range allows no size: once the search ended with a singular matrix."""
    rng = np.random.default_rng(3)
    column, noise = rng.standard_normal((400, 1)), rng.standard_normal((400, 48))
    columns = np.column_stack([np.zeros(400), column])
    alone = variance_inflation(column, noise, 0, np.zeros(0))
    assert variance_inflation(columns, noise, 1, np.zeros(0)) == pytest.approx(alone)
