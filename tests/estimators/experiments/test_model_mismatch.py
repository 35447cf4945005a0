"""A truth that differs from every filter's model, and the bank that estimates the errors of its model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.mismatch_comparison import COMPARED, run_filter, score_mismatch, summarise_scores
from estimators.experiments.model_mismatch import MISMATCHES, excited, mismatched_row
from estimators.experiments.simulated_rows import row_plant, simulate_row
from estimators.filters.augmented_ekf_bank import AugmentedBankSettings, run_augmented_ekf_bank
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.registry import filter_id
from estimators.models.half_car_on_map import ETA, JointSettings
from estimators.models.uncertain_half_car import LAG, MASS, uncertain_model
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY

pytestmark = pytest.mark.check

ROW = ROWS[2]
TIME = 5.0


@pytest.fixture(scope="module")
def twins():
    return {name: mismatched_row(ROW, name, 101, duration=TIME) for name in MISMATCHES}


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
    settings, runs = AugmentedBankSettings(), {}
    model = uncertain_model(row_plant(ROW), 0.01, settings.joint, settings.uncertainty)
    for name in ("mass", "lag", "all"):
        twin = twins[name]
        seen = twin.readings("imu" if name == "lag" else "imu+wheels")
        runs[name] = run_augmented_ekf_bank(model, settings, twin.inputs, seen, v_x=5.0)
    return runs


def test_the_augmented_bank_estimates_the_errors_of_its_model(twins, robust):
    weight = twins["mass"]
    sign = np.sign(robust["mass"].means[-1, MASS])
    assert abs(robust["mass"].means[-1, MASS] - math.log(1.0 + 0.1 * sign)) < 0.04
    assert weight.inputs.shape == twins["none"].inputs.shape
    assert robust["lag"].means[-1, LAG] == pytest.approx(0.05, abs=0.02)
    assert robust["lag"].sds[-1, LAG] < 0.02


def test_the_augmented_bank_covers_the_truth_where_the_plain_one_is_sure_of_a_wrong_soil(twins, robust):
    twin, bank = twins["all"], robust["all"].bank
    run = bank.belief
    assert run.valid[-1]
    assert run.low[-1] < twin.n[-1] < run.high[-1]
    assert (run.repairs, run.lost) == (0, 0)
    plain = run_filter("map_ukf_bank", twin)
    assert not plain.low[-1] < twin.n[-1] < plain.high[-1]


def test_the_augmented_bank_lowers_its_flag_for_a_soil_that_has_changed():
    settings = AugmentedBankSettings()
    twin = simulate_row(ROW, 101, settings.joint, duration=8.0, change=(5.0, 0.75))
    model = uncertain_model(row_plant(ROW), twin.dt, settings.joint, settings.uncertainty)
    bank = run_augmented_ekf_bank(model, settings, twin.inputs, twin.readings("imu+wheels"), v_x=5.0).bank
    run = bank.belief
    before = (twin.t > 3.0) & (twin.t < 5.0)
    assert run.valid[before].all()
    assert bank.surprise[before].max() < settings.surprise
    # Within a second the innovations have a mean, and a new fan is drawn.
    assert not run.valid[(twin.t > 5.8) & (twin.t < 7.0)].any()
    assert bank.renewed >= 1
    assert abs(run.n[-1] - 0.75) < 0.5 * abs(run.n[499] - 0.75)


def test_errors_count_only_while_the_flag_is_up(twins):
    twin = twins["none"]
    T = len(twin.n)
    n, valid = np.full(T, 0.5), np.arange(T) >= T // 2
    n[T // 2 :] = 0.7  # 40 % wrong, outside of its interval, with the flag up
    history = BeliefHistory(
        t=twin.t,
        n=n,
        sd=np.full(T, 0.01),
        low=n - 0.02,
        high=n + 0.02,
        nis=np.full(T, math.nan),
        valid=valid,
        seconds=1.0,
    )
    run = score_mismatch("map_ukf_bank", twin, history)
    assert run.score.flagged_errors == pytest.approx([0.4] * len(run.score.flagged_errors))
    assert run.score.coverage_valid == 0.0
    assert run.score.coverage == pytest.approx(0.5, abs=0.01)
    assert run.score.silent
    down = score_mismatch("map_ukf_bank", twin, replace(history, valid=np.zeros(T, dtype=bool)))
    assert down.score.flagged_errors == ()
    assert not down.score.silent
    both = summarise_scores([run, down])
    assert both.error == pytest.approx(0.4)
    assert both.silent == 1
    assert both.flag < run.flag_excited


@pytest.mark.parametrize("name", ["embedded", "propagated", "online_parameter_ukf"])
def test_every_filter_of_the_study_runs(twins, name):
    belief = run_filter(name, twins["none"])
    assert np.isfinite([belief.n, belief.sd, belief.low, belief.high, belief.speed]).all()
    assert (belief.low <= belief.n).all()
    assert filter_id(name) in COMPARED


def test_wrong_names_are_refused():
    with pytest.raises(InvalidParameter, match="mismatch"):
        mismatched_row(ROW, "wind", 0)
    with pytest.raises(InvalidParameter, match="n_fan"):
        AugmentedBankSettings(n_fan=(0.1, 1.3))
    with pytest.raises(InvalidParameter, match="components"):
        AugmentedBankSettings(components=0)
    with pytest.raises(InvalidParameter, match="in mm or cm"):
        AugmentedBankSettings(bump=3.0)
    assert JointSettings().n_range[0] < AugmentedBankSettings().n_fan[0]
    assert ETA == 10
