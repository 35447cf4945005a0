"""What an unknown road does to scores: drawn runs of a healthy vehicle set how far scores may go."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.discrepancy.fit import fit_runs
from estimators.discrepancy.hide import draw_case, hidden_log
from estimators.discrepancy.road import chance_of_gain, widening
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.windows import FIT


def _fit(healthy: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(healthy=healthy, without_states=lambda table: table)


def test_white_noise_widens_nothing_and_a_common_push_widens_what_it_looks_like():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((4000, 3))
    noise = rng.standard_normal((4000, 400))
    assert widening(_fit(noise), columns, 1, np.ones(1)) == pytest.approx([1.0, 1.0], abs=0.25)
    push = 2.0 * columns[:, 1:2] / np.linalg.norm(columns[:, 1]) * rng.standard_normal(400)
    assert widening(_fit(noise + push), columns, 1, np.ones(1)) == pytest.approx([5.0, 1.0], rel=0.25)


def test_a_push_along_what_is_fitted_anyway_widens_nothing():
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((4000, 2))
    push = 0.2 * columns[:, :1] * rng.standard_normal(400)
    healthy = rng.standard_normal((4000, 400)) + push
    assert widening(_fit(healthy), columns, 1, np.zeros(1)) == pytest.approx([1.0], abs=0.25)
    # Each with all others: the first carries the push, the second does not.
    both = widening(_fit(healthy), columns, 0, np.zeros(1))
    assert both[0] > 10.0
    assert both[1] == pytest.approx(1.0, abs=0.25)


def test_gains_are_judged_by_those_of_healthy_runs():
    assert chance_of_gain(30.0, 12, None) == pytest.approx(chi2.sf(30.0, 12))
    healthy = 2.0 * chi2.rvs(12, size=2000, random_state=1)
    assert chance_of_gain(60.0, 12, healthy) == pytest.approx(chi2.sf(30.0, 12), rel=0.3)
    assert chance_of_gain(30.0, 12, 0.1 * healthy) == pytest.approx(chi2.sf(30.0, 12))


def test_only_an_unknown_road_is_drawn_and_it_shakes_as_much_as_the_true_one():
    level, rough = (
        fit_runs([RunModel(hidden_log(draw_case(51, road=road, duration=12.0, gnss=True)), use=FIT)])
        for road in ("flat", "unknown")
    )
    assert level.drawn is None
    residual = rough.residual()
    for run in rough.runs:
        for channel in run.channels:
            if channel.name in ("a_z", "pitch_rate"):
                drawn = np.median(rough.drawn[channel.rows].std(axis=0))
                assert drawn == pytest.approx(residual[channel.rows].std(), rel=0.5)
