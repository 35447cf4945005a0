"""Bounds of what the soil holds, and what who knows the soil foresees."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.belief.drive_numbers import numbers_of, plant_of_drive, prior_of_drive
from estimators.experiments.adaptation import nominal_plant
from estimators.experiments.soil_belief import believe, believe_fitted, foreseen, stuck_at
from estimators.experiments.soil_bound import limit_bounds
from estimators.experiments.unknown_soils import draw_run
from offroad_env.simulation.soil_holds import SoilHolds


def test_a_bound_falls_with_the_drive_and_rises_with_what_is_unknown() -> None:
    run = draw_run("matched", 0, split="tuning", duration=6.0)
    early, late = limit_bounds(run, 2.0), limit_bounds(run, 6.0)
    assert (late < early).all()
    assert (late[0] < late[1]).all()
    # n is a number of the prior.
    assert late[1, -1] < early[1, -1] < math.sqrt(prior_of_drive()[1][1, 1])


def test_a_filter_that_counts_errors_of_the_model_is_above_the_bound_of_an_exact_one() -> None:
    run = draw_run("matched", 0, split="tuning", duration=6.0)
    history = believe(run, until=6.0)
    assert (history.sd[-1, :2] > limit_bounds(run, 6.0)[0, :2]).all()


def test_the_numbers_of_a_vehicle_on_its_soil_are_the_way_back() -> None:
    run = draw_run("nuisances", 3, split="tuning", duration=0.5)
    nominal, truth = nominal_plant("population"), run.record.plant
    again = plant_of_drive(nominal, numbers_of(truth, nominal))
    for name in ("n", "c", "phi", "k_x", "a_0", "b_0"):
        np.testing.assert_allclose(getattr(again.soil, name), getattr(truth.soil, name), rtol=1e-9)
    for name in ("m", "torque_lag", "drag_area"):
        np.testing.assert_allclose(getattr(again.vehicle, name), getattr(truth.vehicle, name), rtol=1e-9)


def test_who_knows_the_soil_foresees_a_stop_and_nobody_foresees_none() -> None:
    runs = [draw_run("soft", seed, split="tuning", duration=14.0) for seed in range(8)]
    late = [run for run in runs if 3.0 < stuck_at(run) < math.inf]
    assert sum(foreseen(run, 3.0, 4.0) for run in late) >= 0.7 * len(late) > 0
    free = next(run for run in runs if stuck_at(run) == math.inf)
    assert not foreseen(free, 3.0, 4.0)
    # A tenth of a second later it still drives.
    assert not foreseen(late[0], 3.0, 0.1)


@pytest.mark.check
def test_a_fitted_belief_counts_from_its_first_fit_and_is_narrower_where_nothing_differs() -> None:
    run = draw_run("matched", 0, split="tuning", duration=5.0)
    fitted, online = believe_fitted(run), believe(run)
    np.testing.assert_array_equal(fitted.t, online.t)
    early = fitted.t < 1.0
    assert not fitted.valid[early].any()
    assert np.isnan(fitted.centre[early]).all()
    assert fitted.valid[-1]
    kept = [i for i, name in enumerate(SoilHolds._fields) if name != "pull_slip"]
    assert (fitted.sd[-1, kept] < online.sd[-1, kept]).all()
    # Between two fits the last one is believed.
    between = (fitted.t >= 1.8) & (fitted.t < 4.8)
    assert (fitted.sd[between] == fitted.sd[between][0]).all()
    assert (fitted.sd[-1, kept] < fitted.sd[between][0, kept]).all()
