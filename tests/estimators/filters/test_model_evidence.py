"""What an estimate is worth once its model may be wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.experiments.buzhardt_tallapragada import ROWS, row_plant, row_truth
from estimators.experiments.mismatch_comparison import robust_history, run_filter, score_mismatch
from estimators.experiments.model_mismatch import mismatched_row
from estimators.experiments.simulated_rows import simulate_row
from estimators.filters.model_evidence import EvidenceSettings, log_evidence, model_evidence
from estimators.models.half_car_on_map import JointSettings
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

pytestmark = pytest.mark.check

ROUGH, STRAIGHT, STEERED, BENDS = ROWS[:4]  # on clay
SETTINGS = EvidenceSettings()
#: The other soil that pulls as the clay of the rows does, straight ahead.
OTHER_ROOT = 0.97


def _posterior(twin, speed=None, **changes):
    settings = EvidenceSettings(**changes)
    speed = twin.truth[:, at.V_X] if speed is None else speed
    return model_evidence(row_plant(twin.row), settings, twin.inputs, twin.z[:, :5], speed, twin.dt)


def _linear(rng, count=40, nuisances=7):
    return rng.normal(size=(count, nuisances)), rng.uniform(0.5, 2.0, count), rng.uniform(0.2, 3.0, nuisances)


def test_evidence_is_the_density_of_what_was_seen():
    rng = np.random.default_rng(0)
    H, R, P = _linear(rng)
    values = []
    for e in rng.normal(size=(2, len(R))):
        S = H @ np.diag(P) @ H.T + np.diag(R)
        density = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1])
        weighted = H.T / R
        values.append((log_evidence(weighted @ H, weighted @ e, float(e @ (e / R)), P), density))
    (a, a_true), (b, b_true) = values
    # Up to what all soils share: the determinant of R.
    assert a - b == pytest.approx(a_true - b_true, rel=1e-9)
    assert a - a_true == pytest.approx(0.5 * np.log(R).sum(), rel=1e-9)


def test_the_robust_spread_is_the_spread_that_wrong_models_cause():
    rng = np.random.default_rng(1)
    H, R, P = _linear(rng)
    slope, grid = rng.normal(size=len(R)), np.linspace(-3.0, 3.0, 241)
    weighted = H.T / R
    N = weighted @ H
    errors, spreads = [], []
    for _ in range(200):
        # Drives of a vehicle that is not as believed, and a batch least-squares estimate of each.
        e = H @ (rng.normal(size=len(P)) * np.sqrt(P)) + rng.normal(size=len(R)) * np.sqrt(R)
        A = np.column_stack([slope, H]) / np.sqrt(R)[:, None]
        prior = np.diag([0.0, *(1.0 / P)])
        errors.append(np.linalg.solve(A.T @ A + prior, A.T @ (e / np.sqrt(R)))[0])
        left = [e - n * slope for n in grid]
        logs = np.array([log_evidence(N, weighted @ r, float(r @ (r / R)), P) for r in left])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ grid
        spreads.append(math.sqrt(weights @ np.square(grid - mean)))
        assert mean == pytest.approx(errors[-1], abs=0.02)
    assert np.mean(spreads) == pytest.approx(np.std(errors), rel=0.2)


@pytest.mark.parametrize("name", ["online_parameter_ukf", "map_ukf_bank"])
def test_a_filter_that_reads_a_wrong_mass_as_another_soil_is_not_trusted(name):
    twin = mismatched_row(ROUGH, "mass", 101, duration=15.0)
    alone = run_filter(name, twin)
    robust = robust_history(name, twin, alone)
    sure = alone.valid & ~((alone.low <= twin.n) & (twin.n <= alone.high))
    assert sure.mean() > 0.2  # as stated it is certain, and wrong
    assert not robust.valid.any()
    late = twin.t > 2.0
    assert ((robust.low <= twin.n) & (twin.n <= robust.high))[late].mean() > 0.95
    assert score_mismatch(name, twin, alone).score.silent
    assert not score_mismatch(name, twin, robust).score.silent


@pytest.fixture(scope="module")
def turning():
    """Straight ahead on clay for six seconds, then steering."""
    inputs = row_truth(STRAIGHT, duration=14.0).inputs.copy()
    t = 0.005 * np.arange(len(inputs))
    inputs[:, 0] = np.where(t > 6.0, 0.2 * np.sin(t - 6.0), 0.0)
    return simulate_row(STRAIGHT, 101, JointSettings(), inputs=inputs)


def test_straight_ahead_every_root_remains_possible_until_the_steering_decides(turning):
    posterior = _posterior(turning)
    n = posterior.n
    near, far = np.abs(n - turning.n[0]) < 0.06, np.abs(n - OTHER_ROOT) < 0.06
    before, after = 599, len(turning.z) - 1
    assert posterior.weights[before, near].sum() > 0.1
    assert posterior.weights[before, far].sum() > 0.02
    assert posterior.weights[after, far].sum() < 1e-4
    T = len(turning.z)
    flag, sd = np.ones(T, dtype=bool), np.full(T, 0.002)
    _, right = posterior.robust(turning.n, sd, flag)
    _, wrong = posterior.robust(np.full(T, OTHER_ROOT), sd, flag)
    assert not right[before]
    assert right[after]
    assert not wrong.any()


def test_with_a_matched_model_a_filter_is_trusted_while_it_steers():
    twin = mismatched_row(STEERED, "none", 101, duration=15.0)
    alone = run_filter("map_ukf_bank", twin)
    robust = robust_history("map_ukf_bank", twin, alone)
    late = twin.t > 4.0
    assert robust.valid[late].mean() >= 0.9
    assert (robust.sd >= alone.sd).all()
    assert (robust.low <= alone.low).all()
    assert (robust.valid <= alone.valid).all()
    np.testing.assert_array_equal(robust.n, alone.n)


def test_a_biased_unit_costs_width_and_not_the_truth():
    twin = mismatched_row(BENDS, "imu", 101, duration=15.0)
    posterior = _posterior(twin)
    late = twin.t > 4.0
    assert (np.abs(posterior.mean - twin.n) < 2.0 * posterior.sd)[late].all()
    sure = _posterior(twin, uncertainty=type(SETTINGS.uncertainty)(acceleration_bias=1e-3, misalignment=1e-4))
    assert sure.sd[-1] < posterior.sd[-1]
    assert np.abs(sure.mean - twin.n)[-1] > 2.0 * sure.sd[-1]


def test_samples_that_are_missing_cost_width_only(turning):
    whole, T = _posterior(turning), len(turning.z)
    z = turning.z.copy()
    z[1:700] = math.nan  # nothing until the steering has begun
    blind = _posterior(replace(turning, z=z))
    assert np.ptp(blind.weights[600]) < 1e-9
    assert whole.sd[T - 1] < blind.sd[T - 1] < 0.2
    assert abs(blind.mean[T - 1] - turning.n[0]) < 2.0 * blind.sd[T - 1]


def test_a_filter_that_estimates_its_model_errors_is_robust_already():
    twin = mismatched_row(STEERED, "none", 101, duration=3.0)
    belief = run_filter("augmented_ekf_bank", twin)
    assert robust_history("augmented_ekf_bank", twin, belief) is belief


def test_a_drive_that_does_not_fit_is_refused():
    twin = mismatched_row(STEERED, "none", 101, duration=3.0)
    plant, speed = row_plant(STEERED), twin.truth[:, at.V_X]
    with pytest.raises(InvalidParameter, match="half steps"):
        model_evidence(plant, SETTINGS, twin.inputs[:-2], twin.z[:, :5], speed, twin.dt)
    hard = make_plant(VEHICLES["mrzr"], make_soil("hard_ground"), flat())
    with pytest.raises(InvalidParameter, match="hard ground"):
        model_evidence(hard, SETTINGS, twin.inputs, twin.z[:, :5], speed, twin.dt)
    with pytest.raises(InvalidParameter, match="soils"):
        EvidenceSettings(soils=(1.3, 0.3))
    with pytest.raises(InvalidParameter, match="count"):
        EvidenceSettings(count=2)
    with pytest.raises(InvalidParameter, match="memory"):
        EvidenceSettings(memory=0.0)
