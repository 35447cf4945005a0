"""The population of soils, learnt from the catalogue with its gaps, covers soils that it has not seen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.world.natural_soil import REFERENCE_WIDTH, reference_pressure
from offroad_env.world.soil_prior import (
    MEASURED_SOILS,
    PRIOR_NAMES,
    SoilPrior,
    leave_one_out,
    soil_numbers,
)
from offroad_env.world.soils import SOILS, make_soil

LEVELS = (0.5, 0.8, 0.95)


@pytest.fixture(scope="module")
def prior():
    return SoilPrior.fitted()


@pytest.fixture(scope="module")
def sampled(prior):
    rng = np.random.default_rng(1)
    return [prior.sample(rng) for _ in range(1500)]


def bounds(level, count):
    """Two binomial standard deviations about the nominal coverage, and half a soil."""
    spread = 2.0 * math.sqrt(level * (1.0 - level) / count) + 0.5 / count
    return level - spread, level + spread


@pytest.mark.parametrize("sites", [False, True], ids=["soil", "site"])
def test_the_prior_covers_a_soil_that_it_has_not_seen(sites):
    left_out = leave_one_out(sites=sites)
    counts = [*np.isfinite(left_out.probability).sum(axis=0), len(MEASURED_SOILS)]
    assert counts == [20, 20, 19, 19, 20]
    for level in LEVELS:
        for name, share, count in zip(
            (*PRIOR_NAMES[:4], "all four"), left_out.coverage(level), counts, strict=True
        ):
            low, high = bounds(level, count)
            assert low <= share <= high, f"{name}: {share:.0%} of the soils in the {level:.0%} region"


def test_a_prior_that_is_half_as_wide_would_not_cover_them(prior):
    """The bounds above can tell: with half the sd they break."""
    rows = np.array([soil_numbers(name)[[0, 1]] for name in MEASURED_SOILS])
    narrow = np.abs(rows - prior.mean[:2]) < 0.5 * 1.328 * np.sqrt(np.diag(prior.scale)[:2])
    assert (narrow.mean(axis=0) < bounds(0.8, 20)[0]).all()


def test_what_was_not_measured_is_no_datum():
    gaps = {name: np.isnan(soil_numbers(name)).nonzero()[0].tolist() for name in MEASURED_SOILS}
    assert gaps["clay"] == [4], "K is a class value there"
    assert gaps["lete_sand"] == []
    assert gaps["cmu_sand"] == [2, 3, 4], "its strength was tuned to wheel tests"
    assert SoilPrior.fitted().missing == 2
    assert not any(name.startswith("snow") or SOILS[name].rigid for name in MEASURED_SOILS)


def test_correlations_are_shrunk_but_not_away(prior):
    rows = np.array([soil_numbers(name)[:4] for name in MEASURED_SOILS if name != "cmu_sand"])
    sample, shrunk = np.corrcoef(rows.T), prior.correlation
    assert 0.1 < prior.shrinkage < 0.6
    assert abs(shrunk[1, 2]) < abs(sample[1, 2])
    assert shrunk[1, 2] < -0.3, "cohesive soils stiffen less with depth"
    assert (shrunk[4, :4] == 0.0).all(), "three values of K correlate with nothing"
    assert np.linalg.eigvalsh(prior.scale).min() > 0.0


def test_a_sampled_soil_is_a_whole_soil_like_the_measured_ones(prior, sampled):
    for soil in sampled[:200]:
        assert make_soil(soil) == soil
        assert all(type(value) is float for value in soil)
    drawn = np.array([(math.log(reference_pressure(s)), s.n, math.log(s.c), s.phi) for s in sampled])
    # Draws beyond what a soil can be, mostly n < 0.05, are taken again: a ninth of them.
    own = np.sqrt(np.diag(prior.scale)[:4])
    assert (np.abs(drawn.mean(axis=0) - prior.mean[:4]) < 0.15 * own).all()
    sd = drawn.std(axis=0) / own
    assert ((sd > 0.8) & (sd < 1.2)).all()
    assert np.corrcoef(drawn.T)[1, 2] == pytest.approx(prior.correlation[1, 2], abs=0.1)
    K = np.array([soil.k_x for soil in sampled])
    assert 0.012 < np.median(K) < 0.022
    assert np.quantile(K, 0.01) > 1e-3
    assert np.quantile(K, 0.99) < 0.12
    shares = [s.k_c / (s.k_c + REFERENCE_WIDTH * s.k_phi) for s in sampled]
    assert 0.0 <= min(shares) < max(shares) <= max(prior.shares) + 1e-12


def test_a_seed_is_a_soil(prior):
    one, same, other = (prior.sample(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one == same
    assert one != other


def test_a_soil_with_gaps_counts_for_what_it_has():
    complete = SoilPrior.fitted([name for name in MEASURED_SOILS if name != "cmu_sand"])
    with_gaps = SoilPrior.fitted()
    moved = np.abs(with_gaps.mean - complete.mean) / np.sqrt(np.diag(complete.scale))
    assert (moved[2:4] < 0.1).all(), "one soil without strength tells a little of it through its n"
    assert moved[2] > 0.0
    assert moved[1] > 0.05, "and its n counts"


def test_too_few_soils_are_no_population():
    with pytest.raises(InvalidParameter, match="6 or more"):
        SoilPrior.fitted(["clay", "dry_sand"])
    with pytest.raises(InvalidParameter, match="hard_ground"):
        SoilPrior.fitted([*MEASURED_SOILS, "hard_ground"])


def test_a_prior_without_possible_soils_says_so(prior):
    nowhere = replace(prior, mean=prior.mean + np.array([0.0, 50.0, 0.0, 0.0, 0.0]))
    with pytest.raises(SolverFailure, match="no soil"):
        nowhere.sample(np.random.default_rng(0))
