"""One protocol for all filters: what they report on one twin, and how it is scored."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.joint import JointSettings
from estimators.paper import ROWS
from estimators.protocol_runs import row_twin
from estimators.row_filters import (
    FILTERS,
    RowOutcome,
    ends_wrong,
    innovation_flag,
    row_bound,
    run_filter,
    score_run,
    scored,
)
from offroad_env.errors import InvalidParameter

SETTINGS = JointSettings()
ROW = ROWS[6]


@pytest.fixture(scope="module")
def twin():
    return row_twin(ROW, 101, SETTINGS, duration=1.0)


@pytest.fixture(scope="module")
def outcomes(twin):
    return {name: run_filter(name, twin) for name in FILTERS}


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_reports_the_same_things(twin, outcomes, name):
    outcome = outcomes[name]
    for part in ("n", "sd", "low", "high", "nis", "valid"):
        assert getattr(outcome, part).shape == twin.n.shape, part
    assert (outcome.low < outcome.n).all()
    assert (outcome.n < outcome.high).all()
    assert np.isfinite(outcome.nis[1:]).all()
    assert (outcome.channels, outcome.repairs, outcome.lost) == (5, 0, 0)
    assert outcome.seconds > 0.0


@pytest.mark.parametrize("name", ["joint", "ekf", "particle", "bank"])
def test_filters_of_the_state_start_from_one_prior(outcomes, name):
    # N(1.0, 0.3) cut to the soils of the fan; the single filters see it through eta.
    assert outcomes[name].n[0] == pytest.approx(0.93, abs=0.07)
    assert outcomes[name].sd[0] == pytest.approx(0.24, abs=0.07)
    assert not outcomes[name].valid[0]


def test_on_sand_all_but_the_propagated_state_find_the_soil(twin, outcomes):
    for name, outcome in outcomes.items():
        if name != "propagated":
            assert abs(outcome.n[-1] - twin.n[-1]) < 0.05, name
    assert outcomes["smoother"].sd[0] == pytest.approx(outcomes["smoother"].sd[-1], rel=0.01)


def test_more_sensors_are_used_where_a_filter_can(twin):
    every = run_filter("bank", twin, sensors="imu+wheels+gnss")
    assert every.channels == 7
    # A sample with a satellite fix has more channels: it is left out of the NIS.
    assert np.isnan(every.nis[10::10]).all()
    assert np.isfinite(every.nis[1:10]).all()
    with pytest.raises(InvalidParameter, match="known cannot use"):
        run_filter("known", twin, sensors="imu+wheels")
    with pytest.raises(InvalidParameter, match="filter must be one of"):
        run_filter("crystal ball", twin)


def test_bound_starts_with_the_prior(twin):
    bound = row_bound(twin)
    assert bound[0] == pytest.approx(0.3, rel=1e-6)
    assert bound[-1] < 0.01
    assert row_bound(twin, sensors="imu+wheels+gnss")[-1] < bound[-1]


def _outcome(n, *, valid=True):
    n = np.asarray(n, dtype=np.float64)
    sd = np.full(n.shape, 0.01)
    flag = np.full(n.shape, valid)
    return RowOutcome(n, sd, n - 0.02, n + 0.02, np.full(n.shape, 5.0), flag, 5, 0, 0, 2e-4)


def test_score_is_what_the_run_says(twin):
    off = np.where(twin.t < 0.5, 0.1, 0.001)
    score = score_run(_outcome(twin.n + off), twin)
    assert score.mse == pytest.approx(np.mean(off**2))
    assert math.isnan(score.late_mse)
    assert score.coverage == pytest.approx(51 / 101)
    assert score.time_to_5pct == pytest.approx(0.5)
    assert (score.nis, score.nis_count, score.updates) == (5.0, 101, 100)
    assert not score.wrong


def test_a_wrong_soil_counts_only_with_the_flag_up(twin):
    assert ends_wrong(_outcome(twin.n + 0.06), twin)
    assert not ends_wrong(_outcome(twin.n + 0.06, valid=False), twin)
    assert not ends_wrong(_outcome(twin.n + 0.04), twin)


def test_flag_asks_for_a_narrow_belief_and_calm_innovations():
    width, nis = np.full(1000, 0.05), np.full(1000, 5.0)
    flag = innovation_flag(nis, width, 5, 0.01)
    assert not flag[:200].any(), "not before the innovations have been watched"
    assert flag[201:].all()
    assert not innovation_flag(nis, width + 0.05, 5, 0.01).any()
    loud = np.where(np.arange(1000) < 500, 5.0, 9.0)
    assert not innovation_flag(loud, width, 5, 0.01)[700:].any()


def test_a_filter_that_stops_counts_as_failed(twin):
    lost = row_twin(ROW, 101, SETTINGS, duration=0.1)
    lost.inputs[6:] = math.nan
    score = scored("particle", lost)
    assert math.isinf(score.mse)
    assert (score.valid, score.wrong) == (0.0, False)
