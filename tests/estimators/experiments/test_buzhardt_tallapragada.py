"""The paper's experiments."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.experiments.buzhardt_tallapragada import (
    CHOICES,
    ROWS,
    exponent_sweep,
    find_slip,
    forward_comparison,
    row_truth,
    run_row,
)
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at


@pytest.fixture(scope="module")
def truths():
    return {row.number: row_truth(row) for row in ROWS}


def test_on_level_ground_both_models_drive_the_same_path():
    # The paper says so: the sprung mass is not displaced. What is left is the sinkage solve.
    assert forward_comparison(H0=0.0, duration=20.0).largest_distance < 1e-6


def test_on_uneven_ground_loads_vary_in_the_half_car_only():
    comparison = forward_comparison(duration=20.0)
    loads = {name: getattr(comparison, name).readings[:, at.N] for name in ("half_car", "bicycle")}
    assert np.ptp(loads["bicycle"]) < 1e-6 * loads["bicycle"].mean()
    assert np.ptp(loads["half_car"]) > 0.05 * loads["half_car"].mean()
    assert comparison.distance[0] == 0.0
    assert comparison.largest_distance > 1e-3


def test_the_nominal_soil_under_its_own_prescribed_speed_repeats_the_nominal_path():
    speed = exponent_sweep(n=(0.5,), duration=20.0).runs[0]
    force = exponent_sweep(mode="force", n=(0.5,), duration=20.0).runs[0]
    # The speed passes through a cubic spline of its 100 Hz samples.
    assert speed.states[:, : at.YAW] == pytest.approx(force.states[:, : at.YAW], abs=1e-4)


def test_prescribed_speed_is_the_same_on_every_soil_and_the_paths_still_part():
    sweep = exponent_sweep(n=(0.4, 0.5, 0.6), duration=30.0)
    speeds = np.array([run.states[:, at.V_X] for run in sweep.runs])
    assert np.ptp(speeds, axis=0).max() < 1e-9
    assert sweep.spread > 1.0
    assert sweep.paths.shape == (3, 3001, 2)


def test_an_unknown_mode_is_refused():
    with pytest.raises(InvalidParameter, match='mode must be "speed" or "force"'):
        exponent_sweep(mode="throttle")


def test_every_row_stays_within_the_speeds_of_the_model(truths):
    for truth in truths.values():
        v = truth.run.states[:, at.V_X]
        assert v.min() > 0.5, truth.row
        assert v.max() < 25.0, truth.row


@pytest.mark.parametrize(("soil", "step"), [("clay", 0.0025), ("dry_sand", 0.0005)])
def test_the_chosen_slip_is_the_one_the_search_finds(soil, step):
    chosen = CHOICES[f"slip_{soil}"].value
    found, margin = find_slip(soil, chosen + step * np.array([-1.0, 0.0, 1.0]))
    assert found == pytest.approx(chosen, abs=1e-12)
    assert margin > 1.2


def test_the_truth_starts_settled(truths):
    # An unsettled start would hand n to the first vertical accelerations.
    for truth in truths.values():
        assert np.abs(truth.run.readings[0, at.A_Z]) < 0.05


def test_with_steering_on_sand_the_estimate_is_as_good_as_the_papers(truths):
    run = run_row(ROWS[7], truth=truths[8])
    assert run.mse < run.paper_mse
    assert run.filter.belief.n[-1] == pytest.approx(run.truth.n, abs=4.0 * run.filter.belief.sd[-1])


def test_without_steering_the_bicycle_stays_at_another_root_and_the_half_car_does_not(truths):
    # On level clay F_x(n) takes the truth's value at n = 0.97 too, next to the first guess. Only
    # the vertical dynamics tell the two soils apart (the paper's rows 1 and 2).
    half_car, bicycle = (run_row(ROWS[1], model, truth=truths[2]) for model in ("half_car", "bicycle"))
    assert bicycle.filter.belief.n[-1] == pytest.approx(0.98, abs=0.05)
    assert half_car.mse < 0.5 * bicycle.mse
    assert half_car.filter.belief.n[-1] < 0.78  # beyond the turning point that separates the roots


def test_on_rough_clay_the_estimate_leaves_the_first_guess_for_the_right_side(truths):
    # Sigma points without a height of their own feel the forces at a sinkage that belongs to
    # another n, where F_x falls with n instead of rising, and run to the upper bound.
    run = run_row(ROWS[0], truth=truths[1])
    assert run.filter.belief.n[run.t > 20.0].max() < 0.9
    assert run.mse < 0.1


def test_the_seed_is_the_noise(truths):
    short = row_truth(ROWS[6], duration=2.0)
    same, again, other = (run_row(ROWS[6], truth=short, seed=seed).filter.belief.n for seed in (5, 5, 6))
    assert np.array_equal(same, again)
    assert not np.array_equal(same, other)


def test_an_unknown_source_is_refused():
    with pytest.raises(InvalidParameter, match="source must be one of propagated, known"):
        run_row(ROWS[0], source="oracle")
