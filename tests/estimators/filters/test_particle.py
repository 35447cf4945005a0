"""The particle filter: the bank's answer by other means, and nothing lost on the way to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_bank import BankSettings, run_bank
from estimators.filters.particle import ParticleSettings, particle_density, run_particles
from estimators.models.half_car_on_map import CHANNELS, JointSettings
from offroad_env.errors import InvalidParameter, SolverFailure

pytestmark = pytest.mark.check

SETTINGS = ParticleSettings()
STRAIGHT, STEERED = ROWS[1], ROWS[2]
SPEED = 5.0


@pytest.fixture(scope="module")
def steered():
    twin = simulate_row(STEERED, 101, SETTINGS.joint, duration=4.0)
    model, z = row_model(STEERED, SETTINGS.joint), twin.readings()
    return twin, run_particles(model, SETTINGS, twin.inputs, z, v_x=SPEED, seed=1)


def test_it_agrees_with_the_bank(steered):
    twin, run = steered
    bank = run_bank(
        row_model(STEERED, SETTINGS.joint), BankSettings(), twin.inputs, twin.readings(), v_x=SPEED
    )
    after = slice(50, None)
    # Two approximations of one posterior: linearised at particles, and by sigma points.
    assert (np.abs(run.belief.n - bank.belief.n)[after] < 0.8 * bank.belief.sd[after]).all()
    np.testing.assert_allclose(run.belief.sd[-1], bank.belief.sd[-1], rtol=0.4)
    assert abs(run.belief.n[-1] - 0.5) < 4.0 * run.belief.sd[-1]
    assert (run.belief.repairs, run.belief.lost) == (0, 0)


def test_drawing_all_the_time_loses_no_soil(steered):
    twin, run = steered
    model, cut = row_model(STEERED, SETTINGS.joint), 60
    inputs, z = twin.inputs[: 2 * cut + 1], twin.readings()[: cut + 1]
    eager = run_particles(model, replace(SETTINGS, scarce=0.95), inputs, z, v_x=SPEED, seed=1)
    assert eager.resampled > 30
    assert abs(eager.belief.n[cut] - 0.5) < 3.0 * eager.belief.sd[cut]
    # Every draw blurs the density by a fraction of a cell, and no more.
    assert run.belief.sd[cut] * 0.9 < eager.belief.sd[cut] < 2.0 * run.belief.sd[cut]


def test_fewer_particles_carry_a_narrow_belief(steered):
    _, run = steered
    assert run.count[0] == SETTINGS.particles
    assert run.count[-1] == SETTINGS.least


def test_straight_on_clay_leaves_several_soils_open():
    twin = simulate_row(STRAIGHT, 101, SETTINGS.joint, duration=0.6)
    model = row_model(STRAIGHT, SETTINGS.joint)
    run = run_particles(model, SETTINGS, twin.inputs, twin.readings(), v_x=SPEED)
    assert run.width[-1] > 0.4
    assert run.belief.low[-1] < 0.5 < run.belief.high[-1]


def test_innovations_are_as_large_as_they_should_be(steered):
    _, run = steered
    # 350 updates of 5 channels: the mean of a chi-square is 5 +- 0.17.
    assert run.belief.nis[50:].mean() == pytest.approx(5.0, abs=0.6)


def test_the_seed_is_the_resampling(steered):
    twin, run = steered
    model, cut = row_model(STEERED, SETTINGS.joint), 100
    inputs, z = twin.inputs[: 2 * cut + 1], twin.readings()[: cut + 1]
    again = run_particles(model, SETTINGS, inputs, z, v_x=SPEED, seed=1)
    other = run_particles(model, SETTINGS, inputs, z, v_x=SPEED, seed=2)
    np.testing.assert_array_equal(again.belief.n, run.belief.n[: cut + 1])
    assert not np.array_equal(again.belief.n, other.belief.n)


def test_a_drifting_soil_widens_the_belief_when_nothing_is_measured():
    joint = JointSettings(drift=0.3)
    settings = ParticleSettings(joint=joint, n_fan=(0.49, 0.51), n_prior=0.5, n_prior_sd=0.003)
    twin = simulate_row(STEERED, 101, JointSettings(), duration=2.0)
    blind = np.full((201, len(CHANNELS)), math.nan)
    run = run_particles(row_model(STEERED, joint), settings, twin.inputs, blind, v_x=SPEED)
    # Two seconds of random walk of eta, times dn/deta = 0.225 at n = 0.5.
    expected = math.hypot(run.belief.sd[0], 0.225 * 0.3 * math.sqrt(1.5))
    assert run.belief.sd[-1] == pytest.approx(expected, rel=0.25)
    assert np.isnan(run.belief.nis).all()


def test_density_is_the_weights_over_their_cells():
    etas, weights = np.array([1.0, 0.0, 3.0]), np.array([0.5, 0.2, 0.3])
    order, edges, cumulative = particle_density(etas, np.log(weights))
    np.testing.assert_array_equal(etas[order], [0.0, 1.0, 3.0])
    np.testing.assert_allclose(edges, [-0.5, 0.5, 2.0, 4.0])
    np.testing.assert_allclose(cumulative, [0.0, 0.2, 0.7, 1.0])


def test_without_a_soil_that_carries_the_vehicle_it_stops():
    twin = simulate_row(STEERED, 101, SETTINGS.joint, duration=0.1)
    model, inputs = row_model(STEERED, SETTINGS.joint), twin.inputs.copy()
    inputs[4:] = math.nan
    with pytest.raises(SolverFailure, match=r"no particle carries the vehicle at t = 0\.0"):
        run_particles(model, SETTINGS, inputs, twin.readings(), v_x=SPEED)
    soft = ParticleSettings(joint=JointSettings(n_range=(0.2, 2.5)), n_fan=(0.3, 2.4))
    with pytest.raises(SolverFailure, match="n_fan"):
        run_particles(row_model(STEERED, soft.joint), soft, twin.inputs, twin.readings(), v_x=SPEED)


@pytest.mark.parametrize(
    "wrong",
    [
        {"n_fan": (0.1, 1.3)},
        {"particles": 2},
        {"scarce": 0.0},
        {"defence": 1.0},
        {"refresh": 0},
        {"drop": 0.0},
    ],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(InvalidParameter, match=next(iter(wrong))):
        ParticleSettings(**wrong)
