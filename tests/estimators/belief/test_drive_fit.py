"""The belief fitted to a whole drive: it finds soil and vehicle together, and weighs errors as it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.belief import drive_fit, drive_problem
from estimators.belief.drive_errors import DISCREPANCY, GROUPS, HEADING, ROAD_ERRORS, errors_of
from estimators.belief.drive_fit import fit_drive
from estimators.belief.drive_numbers import (
    DRIVE_NUMBERS,
    bounds_of_drive,
    numbers_of,
    plant_of_drive,
    prior_of_drive,
)
from estimators.belief.drive_problem import DriveProblem
from estimators.belief.drive_samples import COMPARED, DriveSamples, simulated_drive
from estimators.experiments.adaptation import nominal_plant, predicted, samples_until, true_plant
from estimators.experiments.motion_sequences import drive_of, prediction_error
from estimators.experiments.unknown_soils import draw_run
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.simulation.sensors import ImuConfig


@pytest.fixture(scope="module")
def run():
    return drive_of(0, "tuning")


@pytest.fixture(scope="module")
def samples(run) -> DriveSamples:
    return samples_until(run, 4.0)


@pytest.fixture(scope="module")
def fit(samples):
    return fit_drive(nominal_plant("population"), samples)


def test_the_fit_predicts_nearly_as_who_knows_soil_and_vehicle(run, fit) -> None:
    def error(plant) -> float:
        return prediction_error(run, 5.0, predicted([plant], run, 5.0)).position

    assert error(fit.plant) < 0.25 * error(nominal_plant("population"))
    assert error(fit.plant) < 2.0 * error(true_plant(run))


def test_a_search_ends_at_the_optimum_of_a_bent_ridge() -> None:
    """With differences over whole steps it ended where the true numbers are more probable."""
    run = draw_run("matched", 302, split="tuning", duration=5.0)
    seen = replace(samples_until(run, 5.0), unit=ImuConfig())
    plant = nominal_plant("population")
    fit = fit_drive(plant, seen)
    problem = DriveProblem(plant, seen)
    problem.whiten = problem.model_errors().factor(fit.scales)
    truth = numbers_of(run.record.plant, plant)
    # The optimum lies below the truth, by half the number of unknowns in the mean.
    assert fit.loss < 0.5 * float((problem.residuals(truth) ** 2).sum())


def test_its_standard_deviations_hold_the_vehicle_and_have_shrunk(run, fit) -> None:
    truth, nominal = run.record.plant.vehicle, nominal_plant("population").vehicle
    sd = np.sqrt(np.diag(fit.covariance))
    mass = DRIVE_NUMBERS.index("log mass")
    off = fit.numbers[mass] - math.log(truth.m / nominal.m)
    assert abs(off) < 3.0 * sd[mass]
    _, prior = prior_of_drive()
    assert sd[mass] < 0.8 * math.sqrt(prior[mass, mass])
    low, high = bounds_of_drive()
    assert (fit.numbers > low).all()
    assert (fit.numbers < high).all()


def test_an_earlier_fit_is_where_the_search_goes_on(samples, fit) -> None:
    again = fit_drive(nominal_plant("population"), samples, fit)
    assert again.loss < fit.loss + 5.0
    start = nominal_plant("population")
    assert plant_of_drive(start, again.numbers).soil.n == pytest.approx(again.numbers[1])


def test_where_the_middle_of_the_population_stops_the_vehicle_another_soil_is_the_start(
    samples, monkeypatch
) -> None:
    able = prior_of_drive()[0] + 0.01

    def only_some(plant, given):
        if plant.soil.n < able[1]:
            raise SolverFailure("stuck")
        return simulated_drive(plant, given)

    monkeypatch.setattr(drive_problem, "simulated_drive", only_some)
    problem = DriveProblem(nominal_plant("population"), samples)
    problem.whiten = np.eye(problem.means.size)
    starts = drive_fit._starts(problem, None)
    assert len(starts) == 2
    assert all(start[1] >= able[1] for start in starts)
    white = problem.residuals(prior_of_drive()[0])
    assert (white[: problem.means.size] == 30.0).all()
    monkeypatch.setattr(
        drive_problem, "simulated_drive", lambda *_: (_ for _ in ()).throw(SolverFailure("stuck"))
    )
    with pytest.raises(SolverFailure, match="12 soils"):
        drive_fit._starts(problem, None)


def test_a_sensor_without_samples_is_named(samples) -> None:
    with pytest.raises(InvalidParameter, match="wheel_f, wheel_r"):
        replace(samples, wheel=np.full_like(samples.wheel, math.nan)).measured()
    with pytest.raises(InvalidParameter, match=r"0.2 s or more"):
        replace(samples, commands=samples.commands[:5])


def test_a_course_is_counted_on_beyond_half_a_turn(samples) -> None:
    turned = samples.gnss.copy()
    turned[:, 3] = np.angle(np.exp(1j * (turned[:, 3] + 3.0)))
    pose = samples.pose._replace(yaw=samples.pose.yaw + 3.0)
    course = COMPARED.index("course")
    moved, _ = replace(samples, gnss=turned, pose=pose).measured()
    np.testing.assert_allclose(moved[:, course], samples.measured()[0][:, course] + 3.0, atol=1e-9)


def test_factors_on_the_errors_of_the_model_are_found(samples) -> None:
    means, counts = samples.measured()
    errors = errors_of(samples, counts, means[:, 5])
    true = np.array([0.5, 2.0, 3.0])
    L = errors.factor(true)
    rng = np.random.default_rng(3)
    slopes, information = np.ones((len(L), 1)), np.eye(1)
    drawn = [L @ rng.standard_normal(len(L)) for _ in range(6)]
    found = np.array([np.log(errors.scales(errors_, slopes, information)) for errors_ in drawn])
    np.testing.assert_allclose(found.mean(axis=0), np.log(true), atol=0.3)


def test_constant_errors_and_noise_have_their_standard_deviations(samples) -> None:
    means, counts = samples.measured()
    speed = means[:, 5]
    sensors, B = errors_of(samples, counts, speed).sensors, samples.blocks
    block = {name: slice(i * B, (i + 1) * B) for i, name in enumerate(COMPARED)}
    shared = {name: sensors[block[name], block[name]][0, -1] for name in COMPARED}
    assert shared["a_x"] == pytest.approx(0.1**2 + (9.81 * math.radians(2.0)) ** 2, rel=0.01)
    assert shared["yaw_rate"] == pytest.approx(0.005**2)
    assert shared["wheel_f"] == pytest.approx(0.01**2 * speed[0] * speed[-1])
    assert shared["speed"] == 0.0
    assert math.sqrt(shared["course"]) == pytest.approx(math.radians(1.0))
    assert sensors[block["speed"], block["speed"]][0, 0] == pytest.approx(0.05**2 / counts[0, 5])
    assert sensors[block["a_y"], block["a_y"]][0, 0] - shared["a_y"] == pytest.approx(0.2**2 / counts[0, 1])


def test_discrepancies_are_those_of_the_tuning_drives() -> None:
    """Measured on tuning drives; whoever changes one measures again."""
    sds = {name: process.sd for name, process in DISCREPANCY.items()}
    assert sds == {
        "speed": 0.09,
        "a_x": 0.03,
        "wheel_f": 0.12,
        "wheel_r": 0.04,
        "yaw_rate": 0.01,
        "side": 0.014,
        "a_y": 0.055,
    }
    times = [process.time for process in DISCREPANCY.values()]
    assert times == [4.0, 0.4, 0.8, 0.7, 0.45, 0.7, 0.45]
    assert {process.group for process in DISCREPANCY.values()} == set(GROUPS)
    assert {name: process.sd for name, process in ROAD_ERRORS.items()} == {
        "speed": 0.006,
        "a_x": 0.021,
        "wheel_f": 0.017,
        "wheel_r": 0.01,
        "yaw_rate": 0.0023,
        "side": 0.01,
        "a_y": 0.014,
    }
    assert [process.time for process in ROAD_ERRORS.values()] == [1.0, 0.05, 0.05, 0.05, 0.3, 0.5, 0.1]
    assert {name: process.group for name, process in ROAD_ERRORS.items()} == {
        name: process.group for name, process in DISCREPANCY.items()
    }
    assert math.degrees(HEADING) == pytest.approx(1.0)


def test_the_speed_is_right_at_the_start_and_wrong_later(samples) -> None:
    means, counts = samples.measured()
    along = errors_of(samples, counts, means[:, 5]).groups[GROUPS.index("along")]
    B = samples.blocks
    speed = np.sqrt(np.diag(along)[5 * B : 6 * B])
    assert speed[0] < 0.3 * speed[-1] < 0.09
