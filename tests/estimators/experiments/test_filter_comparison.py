"""One protocol for all filters: what they report on one twin, and how it is scored."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.consistency import innovation_flag
from estimators.analysis.scores import score
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.filter_comparison import COMPARED, row_bound, run_filter, scored
from estimators.experiments.simulated_rows import simulate_row
from estimators.filters.belief_history import BeliefHistory
from estimators.models.half_car_on_map import JointSettings
from offroad_env.errors import InvalidParameter

pytestmark = pytest.mark.check

SETTINGS = JointSettings()
ROW = ROWS[6]


@pytest.fixture(scope="module")
def twin():
    return simulate_row(ROW, 101, SETTINGS, duration=1.0)


@pytest.fixture(scope="module")
def outcomes(twin):
    return {name: run_filter(name, twin) for name in COMPARED}


@pytest.mark.parametrize("name", COMPARED)
def test_every_filter_reports_the_same_things(twin, outcomes, name):
    outcome = outcomes[name]
    for part in ("n", "sd", "low", "high", "nis", "valid"):
        assert getattr(outcome, part).shape == twin.n.shape, part
    assert (outcome.low < outcome.n).all()
    assert (outcome.n < outcome.high).all()
    assert np.isfinite(outcome.nis[1:]).all()
    assert (outcome.channels, outcome.repairs, outcome.lost) == (5, 0, 0)
    assert outcome.seconds > 0.0


@pytest.mark.parametrize("name", ["map_joint_ukf", "map_ekf", "map_particle_filter", "map_ukf_bank"])
def test_filters_of_the_state_start_from_one_prior(outcomes, name):
    # N(1.0, 0.3) cut to the soils of the fan; the single filters see it through eta.
    assert outcomes[name].n[0] == pytest.approx(0.93, abs=0.07)
    assert outcomes[name].sd[0] == pytest.approx(0.24, abs=0.07)
    assert not outcomes[name].valid[0]


def test_on_sand_all_but_the_propagated_state_find_the_soil(twin, outcomes):
    for name, outcome in outcomes.items():
        if name != "parameter_ukf":
            assert abs(outcome.n[-1] - twin.n[-1]) < 0.05, name
    assert outcomes["map_smoother"].sd[0] == pytest.approx(outcomes["map_smoother"].sd[-1], rel=0.01)


def test_more_sensors_are_used_where_a_filter_can(twin):
    every = run_filter("bank", twin, sensors="imu+wheels+gnss")
    assert every.channels == 7
    # A sample with a satellite fix has more channels: it is left out of the NIS.
    assert np.isnan(every.nis[10::10]).all()
    assert np.isfinite(every.nis[1:10]).all()
    with pytest.raises(InvalidParameter, match="parameter_ukf_known_state cannot use"):
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
    return BeliefHistory(
        t=0.01 * np.arange(len(n)),
        n=n,
        sd=sd,
        low=n - 0.02,
        high=n + 0.02,
        nis=np.full(n.shape, 5.0),
        channels=5,
        valid=flag,
        seconds=2e-4,
    )


def test_score_follows_from_the_run(twin):
    off = np.where(twin.t < 0.5, 0.1, 0.001)
    found = score(_outcome(twin.n + off), twin.n)
    assert found.mse == pytest.approx(np.mean(off**2))
    assert math.isnan(found.late_mse)
    assert found.coverage == pytest.approx(51 / 101)
    assert found.time_to_5pct == pytest.approx(0.5)
    assert (found.nis, found.nis_count, found.updates) == (5.0, 101, 100)
    assert not found.wrong


def test_a_wrong_soil_counts_only_with_the_flag_up(twin):
    assert score(_outcome(twin.n + 0.06), twin.n).wrong
    assert not score(_outcome(twin.n + 0.06, valid=False), twin.n).wrong
    assert not score(_outcome(twin.n + 0.04), twin.n).wrong


def test_flag_asks_for_a_narrow_belief_and_calm_innovations():
    width, nis = np.full(1000, 0.05), np.full(1000, 5.0)
    flag = innovation_flag(nis, width, 5, 0.01)
    assert not flag[:200].any(), "not before the innovations have been watched"
    assert flag[201:].all()
    assert not innovation_flag(nis, width + 0.05, 5, 0.01).any()
    loud = np.where(np.arange(1000) < 500, 5.0, 9.0)
    assert not innovation_flag(loud, width, 5, 0.01)[700:].any()


def test_a_filter_that_stops_counts_as_failed(twin):
    lost = simulate_row(ROW, 101, SETTINGS, duration=0.1)
    lost.inputs[6:] = math.nan
    found = scored("particle", lost)
    assert math.isinf(found.mse)
    assert (found.valid, found.wrong) == (0.0, False)
