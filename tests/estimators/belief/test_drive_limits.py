"""What the soil holds by a fit to a drive: limits, their widths, the flag, and the scatter of the soil."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from estimators.belief import drive_limits as drive_limits_module
from estimators.belief import drive_scatter
from estimators.belief.drive_errors import GROUPS
from estimators.belief.drive_fit import LEAST_SCATTER, DriveFit, fit_drive
from estimators.belief.drive_limits import FittedLimitSettings, drive_limits, fitted_limits, limit_slopes
from estimators.belief.drive_numbers import (
    DRIVE_NUMBERS,
    bounds_of_drive,
    numbers_of,
    plant_of_drive,
    prior_of_drive,
    steps_of_drive,
)
from estimators.belief.drive_posterior import PosteriorSettings, _Target, sample_drive
from estimators.belief.drive_problem import DriveProblem, Surroundings
from estimators.belief.drive_samples import COMPARED, DriveSamples, simulated_drive
from estimators.belief.drive_scatter import scatter_covariance
from estimators.experiments.adaptation import nominal_plant, samples_until, true_plant
from estimators.experiments.soil_bound import limit_bounds
from estimators.experiments.unknown_soils import draw_run
from estimators.filters.soil_belief_holds import LIMITS, least_sd
from estimators.filters.soil_belief_points import LOG_C, LOG_K, LOG_MASS, LOG_PRESSURE, PHI, N
from estimators.numerics.importance_sampling import WeightedSamples
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import SoilField
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.soil_holds import SoilHolds
from offroad_env.world.natural_soil import SoilSpread, natural_soil

NOMINAL = nominal_plant("population")
#: In which a drive's end is enough to tell soils apart [s].
_END = 1.8


class Fitted(NamedTuple):
    """A fit to the first seconds of a drive, and samples around it."""

    samples: DriveSamples
    fit: DriveFit
    posterior: WeightedSamples


SURROUNDINGS = Surroundings(scatter=SoilSpread())


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    """Of a drive over a whole soil."""
    run = draw_run("level", 0, split="tuning", duration=_END)
    samples = samples_until(run, _END)
    fit = fit_drive(NOMINAL, samples, None, SURROUNDINGS)
    return Fitted(samples, fit, sample_drive(NOMINAL, samples, fit, SURROUNDINGS))


def _over_bound(tempered: float) -> float:
    """Standard deviations of three limits over their bounds with errors of the model of the usual size."""
    found = []
    for seed in range(2):
        run = draw_run("matched", seed, split="tuning", duration=_END)
        samples = replace(samples_until(run, _END), unit=ImuConfig())
        fit = fit_drive(NOMINAL, samples, None, SURROUNDINGS)
        posterior = sample_drive(NOMINAL, samples, fit, SURROUNDINGS, PosteriorSettings(tempered=tempered))
        sd, bound = fitted_limits(NOMINAL, fit, posterior).sd, limit_bounds(run, _END)[1]
        names = [name for name in SoilHolds._fields if name != "pull_slip"]
        for name in ("lateral", "pull", "resistance"):
            found.append(sd[SoilHolds._fields.index(name)] / bound[names.index(name)])
    return float(np.mean(found))


@pytest.mark.check
def test_widths_on_clay_are_near_the_bound_and_not_with_half_or_twice_the_errors_of_the_sensors() -> None:
    stated = PosteriorSettings().tempered
    found = [_over_bound(factor * stated) for factor in (0.5, 1.0, 2.0)]
    assert found[0] < 0.45 < found[1] < 0.8 < found[2], found


@pytest.mark.parametrize(("grade", "times"), [(0.0, 1.0), (0.03, 2.0)])
def test_errors_of_the_sensors_count_more_only_where_the_slope_of_the_ground_is_unknown(
    fitted, grade: float, times: float
) -> None:
    """Without errors of the model."""
    surroundings = replace(SURROUNDINGS, grade=grade)
    fit = fit_drive(NOMINAL, fitted.samples, None, surroundings)
    problem = DriveProblem(NOMINAL, fitted.samples, surroundings)
    errors, exact = problem.model_errors(fit.numbers), replace(fit, scales=np.zeros_like(fit.scales))
    once, twice = (_Target(problem, exact, errors, k).factor for k in (1.5, 3.0))
    np.testing.assert_allclose(twice, times * once, rtol=1e-9)


def test_a_belief_that_counts_on_larger_errors_is_no_wider_than_before_the_drive(fitted) -> None:
    samples, fit, posterior = fitted
    wide = sample_drive(NOMINAL, samples, fit, SURROUNDINGS, PosteriorSettings(tempered=6.0))
    prior = np.diag(prior_of_drive()[1])[: len(wide.mean())]
    shares, wider = np.diag(posterior.covariance()) / prior, np.diag(wide.covariance()) / prior
    told = [LOG_PRESSURE, N, LOG_K, LOG_MASS]  # cohesion and friction lie on a ridge that has two ends
    assert shares[told].sum() < 0.7 * wider[told].sum()
    assert (wider < 1.4).all()


def test_where_a_limit_does_not_move_its_width_is_not_zero(fitted) -> None:
    fit, posterior = fitted.fit, fitted.posterior
    one = WeightedSamples(values=posterior.values[:1], weights=np.ones(1), effective=1.0)
    found = fitted_limits(NOMINAL, fit, one)
    np.testing.assert_allclose(found.sd, [least_sd(k, found.centre[k]) for k in range(LIMITS)])


def test_soils_that_do_not_carry_the_vehicle_hold_nothing(fitted) -> None:
    fit, posterior = fitted.fit, fitted.posterior
    soft = posterior.values[:3].copy()
    soft[:, LOG_PRESSURE] = 0.0
    found = fitted_limits(
        NOMINAL, fit, WeightedSamples(values=soft, weights=np.full(3, 1 / 3), effective=3.0)
    )
    assert not found.valid
    assert np.isnan(found.centre).all()


def test_errors_are_adequate_up_to_three_times_the_usual_ones_and_sideways_up_to_less(fitted) -> None:
    fit, posterior = fitted.fit, fitted.posterior
    for group, name in enumerate((*GROUPS, "scatter")):
        scales = np.full(len(GROUPS) + 1, 0.5)
        scales[group] = 1.6 if name == "sideways" else 2.5
        assert fitted_limits(NOMINAL, replace(fit, scales=scales), posterior).valid
        scales[group] = 1.8 if name == "sideways" else 3.5
        assert not fitted_limits(NOMINAL, replace(fit, scales=scales), posterior).valid


def test_a_fit_counts_with_most_of_the_usual_scatter_where_there_is_none() -> None:
    run = draw_run("matched", 0, split="tuning", duration=_END)
    fit = fit_drive(NOMINAL, replace(samples_until(run, _END), unit=ImuConfig()), None, SURROUNDINGS)
    assert fit.scales[-1] == LEAST_SCATTER == 0.8


def test_the_ends_of_the_ridge_are_sampled(fitted: Fitted) -> None:
    """The first draws come from three starts: the fit, little cohesion, much cohesion."""
    cohesion = fitted.posterior.values[: 200 // 3 * 3, LOG_C]
    first, low, high = np.split(cohesion, 3)
    assert np.median(low) < np.median(first) < np.median(high)
    assert np.median(high) - np.median(low) > 2.0


def test_settings_are_positive() -> None:
    with pytest.raises(InvalidParameter, match="adequate must be > 0"):
        FittedLimitSettings(adequate=0.0)
    with pytest.raises(InvalidParameter, match="adequate_sideways must be > 0"):
        FittedLimitSettings(adequate_sideways=-1.0)
    with pytest.raises(InvalidParameter, match="tempered must be > 0"):
        PosteriorSettings(tempered=0.0)
    with pytest.raises(InvalidParameter, match=r"grade must be in \[0, 1\)"):
        Surroundings(grade=-0.1)


def _quotients(numbers: np.ndarray) -> np.ndarray:
    """(6, 10) difference quotients of the limits at one point."""
    columns = []
    for step in 0.002 * np.eye(len(numbers)):
        ends = [drive_limits(NOMINAL, numbers + sign * step) for sign in (-1.0, 1.0)]
        columns.append((ends[1] - ends[0]) / 0.004)
    return np.array(columns).T


def test_slopes_over_a_small_covariance_are_those_at_its_centre() -> None:
    numbers, covariance = prior_of_drive()[0], 1e-6 * prior_of_drive()[1]
    at_one_point, found = _quotients(numbers), limit_slopes(NOMINAL, numbers, covariance)
    kept = [i for i, name in enumerate(SoilHolds._fields) if name != "pull_slip"]
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found[kept] * scale, at_one_point[kept] * scale, atol=1e-5)
    np.testing.assert_allclose(found[-1], np.eye(len(numbers))[N], atol=1e-9)
    assert at_one_point[SoilHolds._fields.index("lateral"), PHI] > 0.0


def test_slopes_are_averaged_where_a_limit_bends() -> None:
    """Clay with three quarters of the shear modulus: the best slip angle begins to lie within its range."""
    run = draw_run("K_low", 0, split="tuning", duration=0.5)
    numbers = numbers_of(run.record.plant, NOMINAL)
    covariance = 0.05 * prior_of_drive()[1]
    ratios = [
        np.sqrt(np.diag(slopes @ covariance @ slopes.T))[
            [SoilHolds._fields.index(name) for name in ("lateral", "resistance")]
        ]
        for slopes in (limit_slopes(NOMINAL, numbers, covariance), _quotients(numbers))
    ]
    lateral, resistance = ratios[0] / ratios[1]
    assert lateral > 1.3
    assert resistance == pytest.approx(1.0, abs=0.1)


def test_an_unknown_slope_of_the_ground_adds_two_numbers() -> None:
    mean, cov = prior_of_drive(0.03)
    own = len(DRIVE_NUMBERS)
    assert len(mean) == len(bounds_of_drive(own + 2)[0]) == len(steps_of_drive(own + 2)) == own + 2
    np.testing.assert_allclose(np.sqrt(np.diag(cov))[own:], 0.03)
    np.testing.assert_array_equal(cov[:own, :own], prior_of_drive()[1])
    plant = plant_of_drive(NOMINAL, np.append(mean[:own], [0.02, -0.01]))
    assert (plant.ground.S_x, plant.ground.S_y) == (0.02, -0.01)


def test_a_slope_that_is_unknown_is_found_up_to_the_mounting_of_the_sensors() -> None:
    run = draw_run("nuisances", 0, split="tuning", duration=4.0)
    fit = fit_drive(NOMINAL, samples_until(run, 4.0), None, Surroundings(grade=0.03))
    sd = np.sqrt(np.diag(fit.covariance))[len(DRIVE_NUMBERS) :]
    assert (sd < 0.03).all()
    assert (np.abs(fit.numbers[len(DRIVE_NUMBERS) :] - run.slopes) < 4.0 * sd).all()


def test_soil_that_does_not_scatter_leaves_no_error(fitted: Fitted) -> None:
    even = SoilSpread(pressure=0.0, n=0.0, c=0.0, tan_phi=0.0)
    found = scatter_covariance(fitted.fit.plant, fitted.samples, even)
    np.testing.assert_array_equal(found, 0.0)


def test_soil_that_scatters_over_great_lengths_is_another_soil(
    fitted: Fitted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every number moves all channels as a whole."""
    monkeypatch.setattr(drive_scatter, "CORRELATION_LENGTH", 1e5)
    plant, numbers = NOMINAL, prior_of_drive()[0]
    moved = [
        simulated_drive(plant_of_drive(plant, numbers + step * np.eye(10)[N]), fitted.samples)
        for step in (0.0, 0.01)
    ]
    slope = (moved[1] - moved[0]).T.reshape(-1) / 0.01
    spread = SoilSpread(pressure=0.0, n=0.02, c=0.0, tan_phi=0.0)
    found = scatter_covariance(plant_of_drive(plant, numbers), fitted.samples, spread)
    stated = 0.02**2 * np.outer(slope, slope)
    assert np.abs(found - stated).max() < 0.15 * np.abs(stated).max()


def test_scatter_does_to_a_drive_what_its_covariance_says() -> None:
    run = draw_run("level", 0, split="tuning", duration=4.0)
    samples, plant = samples_until(run, 4.0), true_plant(run)
    even = simulated_drive(plant, samples)
    stated = scatter_covariance(plant, samples, SoilSpread())
    off = []
    for seed in range(8):
        field: SoilField = natural_soil(plant.soil, seed, spread=SoilSpread(), waves=32)
        off.append((simulated_drive(plant._replace(soil_field=field), samples) - even).T.reshape(-1))
    actual = np.sqrt(np.mean(np.square(off), axis=0)).reshape(len(COMPARED), -1)[:, 3:]
    sds = np.sqrt(np.diag(stated)).reshape(len(COMPARED), -1)[:, 3:]
    for name in ("a_x", "wheel_f", "speed"):
        i = COMPARED.index(name)
        assert 0.6 < actual[i].mean() / sds[i].mean() < 1.5, name


def test_slopes_need_limits_on_half_of_the_soils_at_least(monkeypatch) -> None:
    numbers = prior_of_drive()[0]
    monkeypatch.setattr(drive_limits_module, "_limits_and_n", lambda plant, row: np.full(LIMITS + 1, np.nan))
    with pytest.raises(SolverFailure, match="do not exist for half"):
        limit_slopes(NOMINAL, numbers, 1e-4 * prior_of_drive()[1])
