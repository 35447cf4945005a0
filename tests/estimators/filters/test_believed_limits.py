"""When the reference of the believed limits is renewed."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.filters.believed_limits import BelievedLimits, RefreshRule
from estimators.filters.online_soil_belief import SoilBeliefSettings
from estimators.filters.soil_belief_holds import (
    LIMITS,
    least_sd,
    limits_of_belief,
    moved_since,
    new_surrogate,
    transform_limits,
    whole_surrogate,
)
from estimators.filters.soil_belief_points import LOG_MASS, POINTS, SAMPLED, SIZE, N
from estimators.filters.soil_belief_prior import base_soil, population_of
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.packing import pack
from offroad_env.simulation.simulator import make_plant
from offroad_env.simulation.soil_holds import SoilHolds
from offroad_env.world.terrain import flat, soil_map
from offroad_env.world.vehicles import VEHICLES

DT = 0.02
VEHICLE = VEHICLES["paper"]


def _belief() -> tuple[np.ndarray, np.ndarray]:
    mean, cov = np.zeros(SIZE), 1e-4 * np.eye(SIZE)
    mean[:LOG_MASS], cov[:LOG_MASS, :LOG_MASS] = population_of(0.9, 0.1)
    return mean, cov


def _limits(mean: np.ndarray, cov: np.ndarray) -> BelievedLimits:
    s = SoilBeliefSettings()
    packed = pack(make_plant(VEHICLE, base_soil(), flat()))
    rule = RefreshRule(s.refresh_time, s.refresh_latest, s.refresh_move, s.refresh_far)
    found = BelievedLimits(packed, VEHICLE.m * GRAVITY, s.information, rule)
    found.start(mean, cov)
    return found


def _references(found: BelievedLimits, mean: np.ndarray, cov: np.ndarray, seconds: float) -> int:
    before = found.references
    for _ in range(round(seconds / DT)):
        found.follow(mean, cov, DT)
    return found.references - before


def _moved(mean: np.ndarray, cov: np.ndarray, by: float) -> np.ndarray:
    factor = np.linalg.cholesky(cov[:SAMPLED, :SAMPLED])
    moved = mean.copy()
    moved[:SAMPLED] += by * factor[:, N]
    return moved


def test_a_belief_that_rests_keeps_its_reference_until_the_latest_time() -> None:
    mean, cov = _belief()
    found = _limits(mean, cov)
    assert _references(found, mean, cov, 6.0) == 0
    assert _references(found, mean, cov, 4.0) == 1


def test_a_belief_that_moves_gets_a_new_reference() -> None:
    mean, cov = _belief()
    assert _references(_limits(mean, cov), _moved(mean, cov, 0.45), cov, 4.0) == 0
    assert _references(_limits(mean, cov), _moved(mean, cov, 0.9), cov, 4.0) == 1


def test_a_belief_that_narrows_gets_a_new_reference() -> None:
    mean, cov = _belief()
    assert _references(_limits(mean, cov), mean, cov * 0.55**2, 4.0) == 0
    assert _references(_limits(mean, cov), mean, cov * 0.1**2, 4.0) == 1


def test_no_reference_is_renewed_before_the_earliest_time() -> None:
    mean, cov = _belief()
    found, far = _limits(mean, cov), _moved(mean, cov, 1.5)
    assert _references(found, far, cov, 1.6) == 0
    assert _references(found, far, cov, 1.6) == 1


def test_a_belief_that_has_moved_far_gets_a_new_reference_at_once() -> None:
    """Beyond, parabolas have made 14 m/s^2 of a soil that holds 1.8, with the flag up."""
    mean, cov = _belief()
    found, far = _limits(mean, cov), _moved(mean, cov, 2.4)
    assert _references(found, far, cov, 0.1) == 1
    np.testing.assert_allclose(found.centre, _limits(far, cov).centre, rtol=1e-9)


def test_a_belief_that_is_widened_gets_a_new_reference_at_once_and_is_no_wider_than_the_first() -> None:
    mean, cov = _belief()
    found = _limits(mean, cov)
    first = found.sd.copy()
    assert _references(found, mean, cov * 2.4**2, 0.1) == 0
    assert (found.sd <= first).all()
    assert _references(found, mean, cov * 3.0**2, 0.1) == 1
    assert (found.sd <= first).all()


def test_a_new_reference_takes_one_update_for_each_of_its_points_and_moves_the_limits() -> None:
    mean, cov = _belief()
    found, far = _limits(mean, cov), _moved(mean, cov, 1.5)
    steps = 0
    while not found.references:
        found.follow(far, cov, DT)
        steps += 1
    assert steps == round(SoilBeliefSettings().refresh_time / DT) + POINTS - 1
    fresh = _limits(far, cov)
    np.testing.assert_allclose(found.centre, fresh.centre, rtol=1e-9)


def test_the_move_is_counted_in_the_columns_of_the_factor() -> None:
    rng = np.random.default_rng(3)
    surrogate = new_surrogate()
    A, B = rng.normal(size=(2, SAMPLED, SAMPLED))
    surrogate.factor[:] = np.linalg.cholesky(A @ A.T + np.eye(SAMPLED))
    surrogate.mean[:] = rng.normal(size=SAMPLED)
    for share in (0.01, 3.0):
        mean, cov = np.zeros(SIZE), np.eye(SIZE)
        mean[:SAMPLED] = surrogate.mean + share * rng.normal(size=SAMPLED)
        cov[:SAMPLED, :SAMPLED] = B @ B.T
        inverse = np.linalg.inv(surrogate.factor)
        spread = np.sqrt(np.diag(inverse @ cov[:SAMPLED, :SAMPLED] @ inverse.T))
        away = np.abs(inverse @ (mean[:SAMPLED] - surrogate.mean))
        expected = max(away.max(), np.abs(spread - 1.0).max())
        assert moved_since(surrogate, mean, cov) == pytest.approx(expected, rel=1e-9)


def test_no_limit_is_known_better_than_it_is_worth_where_it_does_not_depend_on_the_soil() -> None:
    """Where every soil of a belief gives no grip at all, another model of it gives a little."""
    surrogate, (mean, cov) = new_surrogate(), _belief()
    held = SoilHolds(0.0, -1e9, 0.0, 0.0, 0.0, 0.0)
    transform_limits(held, VEHICLE.m * GRAVITY, surrogate.value)
    centre, sd, slope = np.empty(LIMITS), np.empty(LIMITS), np.empty((LIMITS, 2))
    limits_of_belief(surrogate, mean, cov, centre, sd, slope)
    weak = np.array([0.07, 0.0, 0.0, 3.0, 5e-4, 0.15])  # lateral, resistance, sinkage, stopping
    for k in (0, 3, 4, 5):
        assert abs(np.log(weak[k]) - centre[k]) < 1.96 * sd[k]
    # Usual limits are not touched, and half or twice the resolution is another one.
    usual = {0: (4.0, 0.0085), 3: (200.0, 0.006), 4: (0.02, 0.011), 5: (3.0, 0.018)}
    for k, (value, expected) in usual.items():
        assert least_sd(k, np.log(value)) == pytest.approx(expected, rel=0.1)


def test_limits_have_the_names_and_units_of_what_the_soil_holds() -> None:
    mean, cov = _belief()
    found = _limits(mean, cov)
    by_name = found.by_name()
    assert tuple(by_name) == SoilHolds._fields
    assert len(by_name) == LIMITS
    for limit in by_name.values():
        assert limit.low < limit.mean < limit.high


def test_limits_do_not_depend_on_what_was_asked_before() -> None:
    """Plants that differ in nothing but patches of n share no reference."""
    belief = _belief()
    surrogate = new_surrogate()
    found = []
    for patches in ([], [(0.0, 0.0, 50.0, 1.2)], []):
        plant = make_plant(VEHICLE, base_soil(), flat(), soil_map=soil_map(patches) if patches else None)
        whole_surrogate(surrogate, pack(plant), *belief)
        found.append(surrogate.value.copy())
    assert (found[0] == found[2]).all()
    assert (found[0] != found[1]).any()
