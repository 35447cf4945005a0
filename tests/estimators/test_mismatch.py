"""A truth that no filter believes in, and the bank that doubts its own model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.joint import ETA, JointSettings
from estimators.mismatch import MISMATCHES, excited, mismatched_twin
from estimators.mismatch_runs import FILTERS, Belief, judge, run_filter, summarise_verdicts
from estimators.nuisances import LAG, MASS, doubt_model
from estimators.paper import ROWS
from estimators.protocol_runs import row_plant, row_twin
from estimators.robust import RobustSettings, run_robust_bank
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY

ROW = ROWS[2]
TIME = 5.0


@pytest.fixture(scope="module")
def twins():
    return {name: mismatched_twin(ROW, name, 101, duration=TIME) for name in MISMATCHES}


def test_the_driver_keeps_every_vehicle_at_the_same_speed(twins):
    speeds = np.array([twin.truth[:, 5] for twin in twins.values()])
    assert np.ptp(speeds, axis=0).max() < 0.5
    for name, twin in twins.items():
        assert twin.mismatch == name
        assert (twin.n == twin.n[0]).all()


def test_each_mismatch_shows_where_it_should(twins):
    exact = twins["none"]
    force = {name: twin.inputs[100:, 1].mean() for name, twin in twins.items()}
    # The same speed of another mass on the same slip needs another force.
    assert abs(force["mass"] - force["none"]) > 0.02 * abs(force["none"])
    assert abs(force["slip_sinkage"] - force["none"]) > 1.0
    apart = (twins["imu"].z - exact.z)[:, :5]
    assert np.abs(apart[:, :2].mean(axis=0)).min() > 0.5 * GRAVITY * math.radians(2.0)
    np.testing.assert_allclose(twins["imu"].truth, exact.truth)
    # Wheels that follow late: the yaw rate lags.
    late, soon = twins["lag"].truth[:, 9], exact.truth[:, 9]
    shifts = [np.corrcoef(late[50:], soon[50 - k : len(soon) - k])[0, 1] for k in range(10)]
    assert 3 <= int(np.argmax(shifts)) <= 7
    # The command that filters know does not lag.
    np.testing.assert_array_equal(twins["lag"].inputs[:, 0], exact.inputs[:, 0])


def test_excitation_is_steering_or_roughness():
    level = np.zeros((600, 2))
    assert not excited(level, 0.01).any()
    level[300:, 0] = 1.0
    acts = excited(level, 0.01)
    assert not acts[:300].any()
    assert acts[340:].all()


@pytest.fixture(scope="module")
def robust(twins):
    settings, runs = RobustSettings(), {}
    model = doubt_model(row_plant(ROW), 0.01, settings.joint, settings.doubt)
    for name in ("mass", "lag", "all"):
        twin = twins[name]
        seen = twin.readings("imu" if name == "lag" else "imu+wheels")
        runs[name] = run_robust_bank(model, settings, twin.inputs, seen, v_x=5.0)
    return runs


def test_the_robust_bank_learns_what_it_doubts(twins, robust):
    weight = twins["mass"]
    sign = np.sign(robust["mass"].means[-1, MASS])
    assert abs(robust["mass"].means[-1, MASS] - math.log(1.0 + 0.1 * sign)) < 0.04
    assert weight.inputs.shape == twins["none"].inputs.shape
    assert robust["lag"].means[-1, LAG] == pytest.approx(0.05, abs=0.02)
    assert robust["lag"].sds[-1, LAG] < 0.02


def test_the_robust_bank_stays_honest_where_the_plain_one_is_sure_of_a_wrong_soil(twins, robust):
    twin, run = twins["all"], robust["all"].bank
    assert run.valid[-1]
    assert run.low[-1] < twin.n[-1] < run.high[-1]
    assert (run.repairs, run.failed) == (0, 0)
    plain = run_filter("bank", twin)
    assert not plain.low[-1] < twin.n[-1] < plain.high[-1]


def test_the_robust_bank_does_not_vouch_for_a_soil_that_has_changed():
    settings = RobustSettings()
    twin = row_twin(ROW, 101, settings.joint, duration=8.0, change=(5.0, 0.75))
    model = doubt_model(row_plant(ROW), twin.dt, settings.joint, settings.doubt)
    run = run_robust_bank(model, settings, twin.inputs, twin.readings("imu+wheels"), v_x=5.0).bank
    before = (twin.t > 3.0) & (twin.t < 5.0)
    assert run.valid[before].all()
    assert run.surprise[before].max() < settings.surprise
    # Within a second the innovations have a mean, and a new fan is drawn.
    assert not run.valid[(twin.t > 5.8) & (twin.t < 7.0)].any()
    assert run.renewed >= 1
    assert abs(run.n[-1] - 0.75) < 0.5 * abs(run.n[499] - 0.75)


def test_verdict_counts_only_what_the_filter_vouches_for(twins):
    twin = twins["none"]
    T = len(twin.n)
    n, valid = np.full(T, 0.5), np.arange(T) >= T // 2
    n[T // 2 :] = 0.7  # 40 % wrong, outside of its interval, and vouched for
    belief = Belief(n, np.full(T, 0.01), n - 0.02, n + 0.02, valid, np.full(T, 5.0), 1.0)
    verdict = judge("bank", twin, belief)
    assert verdict.errors == pytest.approx([0.4] * len(verdict.errors))
    assert verdict.covered == 0.0
    assert verdict.covered_all == pytest.approx(0.5, abs=0.01)
    assert verdict.silent
    silent = judge("bank", twin, belief._replace(valid=np.zeros(T, dtype=bool)))
    assert silent.errors == []
    assert not silent.silent
    both = summarise_verdicts([verdict, silent])
    assert both.error == pytest.approx(0.4)
    assert both.silent == 1
    assert both.flag < verdict.flag_excited


@pytest.mark.parametrize("name", ["embedded", "propagated"])
def test_every_filter_of_the_study_runs(twins, name):
    belief = run_filter(name, twins["none"])
    assert np.isfinite([belief.n, belief.sd, belief.low, belief.high, belief.speed]).all()
    assert (belief.low <= belief.n).all()
    assert name in FILTERS


def test_wrong_names_are_refused():
    with pytest.raises(InvalidParameter, match="mismatch"):
        mismatched_twin(ROW, "wind", 0)
    with pytest.raises(InvalidParameter, match="n_fan"):
        RobustSettings(n_fan=(0.1, 1.3))
    with pytest.raises(InvalidParameter, match="components"):
        RobustSettings(components=0)
    with pytest.raises(InvalidParameter, match="in mm or cm"):
        RobustSettings(bump=3.0)
    assert JointSettings().n_range[0] < RobustSettings().n_fan[0]
    assert ETA == 10
