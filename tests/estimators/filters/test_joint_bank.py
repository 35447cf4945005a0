"""The bank: several soils held open while they explain the same, one when steering tells them apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from estimators.experiments.buzhardt_tallapragada import CHOICES, ROWS
from estimators.experiments.simulated_rows import row_model, row_plant, simulate_row
from estimators.filters.joint_bank import BankSettings, bank_rules, bank_step, run_bank, start_bank
from estimators.filters.joint_ukf import run_joint_filter
from estimators.models.half_car_on_map import ETA, JointSettings, only_imu, prior
from estimators.numerics.bounded import to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.axle import static_loads
from offroad_env.physics.records import Wheel
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import make_soil
from offroad_env.world.vehicles import VEHICLES

pytestmark = pytest.mark.check

SETTINGS = BankSettings()
SPEED = CHOICES["start_speed"].value
STRAIGHT, STEERED = ROWS[1], ROWS[2]


def _bank(row, seed, duration, settings=SETTINGS, **kwargs):
    twin = simulate_row(row, seed, settings.joint, duration=duration, **kwargs)
    model = row_model(row, settings.joint)
    return twin, run_bank(model, settings, twin.inputs, only_imu(twin.z[:, :5]), v_x=SPEED)


@pytest.fixture(scope="module")
def straight():
    return _bank(STRAIGHT, 101, 2.5)


@pytest.fixture(scope="module")
def steered():
    return _bank(STEERED, 101, 5.0)


def _mass(run, k, n, width):
    """Weight of the sum within ``width`` of ``n`` at sample ``k``."""
    z = (np.array([n - width, n + width])[:, None] - run.exponents[k]) / run.spreads[k]
    return float((run.weights[k] * np.diff(norm.cdf(z), axis=0)[0]).sum())


def _force_roots(n_true):
    """Exponents with which clay pulls the rolling vehicle as strongly as with the true one."""
    plant = row_plant(STRAIGHT)
    vehicle = VEHICLES["paper"]
    load = static_loads(vehicle)[0] / vehicle.wheels_per_axle

    def pull(n):
        soil = make_soil("clay", n=float(n))
        return float(wheel_forces(soil, Wheel(vehicle.r, vehicle.b), load=load, slip=plant.slip).F_x)

    grid = np.linspace(0.35, 1.2, 60)
    excess = np.array([pull(n) - pull(n_true) for n in grid])
    change = np.flatnonzero(np.sign(excess[1:]) != np.sign(excess[:-1]))
    return [brentq(lambda n: pull(n) - pull(n_true), grid[i], grid[i + 1]) for i in change]


def test_fan_is_the_stated_prior():
    model = row_model(STRAIGHT, SETTINGS.joint)
    state = start_bank(model, SETTINGS, (0.0, 0.0, 0.0), SPEED)
    n = np.array([to_range(eta, model.low, model.high) for eta in state.means[:, ETA]])
    weights = np.exp(state.log_weights)
    assert weights.sum() == pytest.approx(1.0)
    low, high = SETTINGS.n_fan
    expected = norm.pdf(n, SETTINGS.n_prior, SETTINGS.n_prior_sd)
    np.testing.assert_allclose(weights, expected / expected.sum(), rtol=1e-9)
    assert n.min() > low
    assert n.max() < high
    # Each hypothesis stands on its own soil: the softer, the deeper.
    assert (np.diff(state.means[np.argsort(n), 3]) < 0.0).all()


def test_every_root_of_the_force_keeps_weight_while_driving_straight(straight):
    twin, run = straight
    roots = _force_roots(twin.n[0])
    assert len(roots) == 3, "clay pulls equally at three exponents"
    # Half a second: what the settled start and the vertical motion tell has not yet decided.
    assert min(_mass(run, 50, root, 0.05) for root in roots) > 0.01
    assert run.belief.sd[50] > SETTINGS.widest, "several soils: no estimate that is valid"
    # Once the components are narrow, what is left of them stands apart.
    modes = run.modes(-1)
    assert len(modes) >= 2
    assert run.belief.valid[-1] == (modes[0].weight >= SETTINGS.sure and run.belief.sd[-1] <= SETTINGS.widest)
    assert run.belief.low[50] < twin.n[0] < run.belief.high[50]


def test_steering_decides_within_five_seconds(steered):
    twin, run = steered
    assert _mass(run, -1, twin.n[-1], 0.05) > 0.95
    assert len(run.modes(-1)) == 1
    assert run.belief.valid[-1]
    assert abs(run.belief.n[-1] - twin.n[-1]) < 4.0 * run.belief.sd[-1]
    assert (run.belief.repairs, run.belief.lost, run.renewed) == (0, 0, 0)


def test_report_is_the_mixture(straight):
    _, run = straight
    model = row_model(STRAIGHT, SETTINGS.joint)
    for k in (20, 100, 200):
        rng = np.random.default_rng(k)
        w = run.weights[k] / run.weights[k].sum()
        slope = (run.exponents[k] - model.low) * (model.high - run.exponents[k]) / (model.high - model.low)
        which = rng.choice(len(w), p=w, size=100_000)
        centre = np.log((run.exponents[k] - model.low) / (model.high - run.exponents[k]))
        eta = rng.normal(centre[which], (run.spreads[k] / slope)[which])
        n = model.low + (model.high - model.low) / (1.0 + np.exp(-eta))
        # Row k reports what the tidied components of the same sample say; merging keeps the moments.
        assert run.belief.n[k] == pytest.approx(n.mean(), abs=0.004)
        assert run.belief.sd[k] == pytest.approx(n.std(), rel=0.03)
        assert np.mean((run.belief.low[k] < n) & (n < run.belief.high[k])) == pytest.approx(0.95, abs=0.01)
        assert sum(mode.weight for mode in run.modes(k)) == pytest.approx(1.0)


def test_one_component_is_the_joint_filter():
    settings = BankSettings(n_fan=(0.45, 0.55), components=1, overlap=0.3)
    twin, run = _bank(STEERED, 102, 1.0, settings)
    model = row_model(STEERED, settings.joint)
    start = prior(model, settings.joint, 0.5, 0.03, (0.0, 0.0, 0.0), SPEED)
    single = run_joint_filter(model, start, twin.inputs, only_imu(twin.z[:, :5]))
    np.testing.assert_allclose(run.belief.n, single.belief.n, rtol=1e-9)
    np.testing.assert_allclose(run.belief.sd, single.belief.sd, rtol=1e-9)
    np.testing.assert_allclose(run.belief.low, single.belief.low, atol=1e-8)
    np.testing.assert_allclose(run.belief.nis[1:], single.belief.nis[1:], rtol=1e-8)


def test_a_change_of_soil_is_noticed_and_followed():
    twin, run = _bank(STEERED, 101, 8.0, change=(4.0, 0.8))
    assert run.renewed == 1
    assert run.belief.valid[390]
    wrong = run.belief.valid & (np.abs(run.belief.n - twin.n) > 0.05)
    # From the change until it shows: some tenths of a second.
    assert wrong.sum() * twin.dt < 0.5
    assert run.belief.n[-1] == pytest.approx(0.8, abs=0.03)


def test_a_soil_that_changes_slowly_is_noticed_before_the_innovations_tell():
    slowly = np.interp(0.01 * np.arange(1201), (5.0, 12.0), (0.5, 0.6))

    def seconds_wrong(settings):
        twin, run = _bank(STEERED, 101, 12.0, settings, exponents=slowly)
        return np.sum(run.belief.valid & (np.abs(run.belief.n - twin.n) > 0.05)) * twin.dt

    assert seconds_wrong(SETTINGS) < 1.0
    assert seconds_wrong(BankSettings(change_level=1e9)) > 2.0


def test_a_sample_that_no_soil_explains_moves_no_weight():
    model = row_model(STRAIGHT, SETTINGS.joint)
    state, rules = start_bank(model, SETTINGS, (0.0, 0.0, 0.0), SPEED), bank_rules(model, SETTINGS)
    before = state.log_weights.copy()
    state.covs[:, 3, 3] = 1e4  # sigma points far below the ground
    twin = simulate_row(STRAIGHT, 101, SETTINGS.joint, duration=0.02)
    z, out = only_imu(twin.z[1:2, :5])[0], np.empty(8)
    _, failed, _ = bank_step(state, twin.inputs[:3], z, rules, model, out)
    assert failed == SETTINGS.components
    np.testing.assert_array_equal(state.log_weights, before)


def test_wrong_settings_are_refused():
    with pytest.raises(InvalidParameter, match="n_fan"):
        BankSettings(n_fan=(0.1, 1.3))
    with pytest.raises(InvalidParameter, match="components"):
        BankSettings(components=0)
    with pytest.raises(InvalidParameter, match="drop"):
        BankSettings(drop=0.0)
    with pytest.raises(InvalidParameter, match="renew"):
        BankSettings(renew=math.nan)
    with pytest.raises(InvalidParameter, match="change_level"):
        BankSettings(change_level=0.0)
    soft = BankSettings(joint=JointSettings(n_range=(0.2, 2.5)), n_fan=(0.3, 2.4))
    with pytest.raises(SolverFailure, match="n_fan"):
        start_bank(row_model(STRAIGHT, soft.joint), soft, (0.0, 0.0, 0.0), SPEED)
