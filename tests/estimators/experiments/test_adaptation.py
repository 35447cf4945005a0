"""Prediction on unseen soils by physical models, and the sequences that models are learnt from."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.experiments.adaptation import base_soil, believed, nominal_plant, predicted, true_plant
from estimators.experiments.motion_sequences import AT, HORIZON, STEP, drive_of, prediction_error, sequence_of
from offroad_env.physics import state as at
from offroad_env.world.soil_prior import SoilPrior


def _error(plants, run, start: float) -> float:
    return prediction_error(run, start, predicted(plants, run, start)).position


def test_who_knows_the_soil_predicts_and_who_has_driven_on_it_nearly_so() -> None:
    errors = []
    for seed in (0, 1, 2):
        run = drive_of(seed, "tuning")
        models = ([true_plant(run)], believed(run)[2], [nominal_plant("population")])
        errors.append([_error(plants, run, AT[2]) for plants in models])
    oracle, belief, nominal = np.mean(errors, axis=0)
    assert oracle < 0.3  # m in 3 s, on a rough road, on soil that scatters
    assert oracle < belief < 0.5 * nominal


def test_a_soil_that_does_not_carry_the_vehicle_stops_it_at_once() -> None:
    run, plant = drive_of(0, "tuning"), nominal_plant("clay")
    soft = plant._replace(soil=plant.soil._replace(k_phi=1e2, k_c=0.0))
    end = predicted([soft], run, AT[0])
    state = run.record.states[round(AT[0] / run.record.timing.period)]
    np.testing.assert_array_equal(end, [state[at.X], state[at.Y], state[at.YAW], 0.0])


def test_the_soil_of_the_population_is_its_middle() -> None:
    soil, prior = base_soil("population"), SoilPrior.fitted()
    assert soil.n == pytest.approx(prior.mean[1])
    assert np.log(soil.k_phi * 0.05**soil.n) == pytest.approx(prior.mean[0])


def test_a_sequence_is_the_drive_in_steps_and_sensors_are_near_it() -> None:
    run = drive_of(0, "tuning")
    found = sequence_of(run)
    assert len(found.true) == len(found.inputs) + 1 == round((AT[-1] + HORIZON) / STEP) + 1
    every = round(STEP / run.record.timing.period)
    np.testing.assert_array_equal(found.true[:, 0], run.record.states[::every, at.V_X])
    # What acts after the lags is what the true actuators do, but for a lag that differs by 20 %.
    steer = run.record.states[:, at.STEER]
    means = 0.5 * (steer[1:] + steer[:-1]).reshape(-1, every).mean(axis=1)
    np.testing.assert_allclose(found.inputs[:, 0], means, atol=0.02)
    assert np.abs(found.measured[20:, 0] - found.true[20:, 0]).mean() < 0.15
    assert np.abs(found.measured[20:, 2] - found.true[20:, 2]).mean() < 0.05
