"""Samples by adaptive importance sampling have the moments of what they are of."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.numerics.importance_sampling import importance_samples

SIZE = 8


def bent(values: np.ndarray, bend: float) -> float:
    """Normal in (x_0, 2 (x_1 - bend x_0^2), x_2 ...): x_1 has the mean bend, the variance 1/4 + 2 bend^2."""
    straight = values.copy()
    straight[1] = 2.0 * (values[1] - bend * values[0] ** 2)
    return -0.5 * float(straight @ straight)


@pytest.mark.parametrize(("bend", "share"), [(0.25, 0.9), (0.5, 0.7)])
def test_moments_of_a_bent_ridge_are_found_up_to_its_far_ends(bend: float, share: float) -> None:
    """The linearisation at the most probable point says that the mean is zero and the deviation a half."""
    near = np.diag([1.0, 0.25, *np.ones(SIZE - 2)])
    found = importance_samples(lambda x: bent(x, bend), [(np.zeros(SIZE), near)])
    assert found.effective > 100.0
    assert found.weights.sum() == pytest.approx(1.0)
    assert 0.5 * bend < found.mean()[1] < 1.2 * bend
    sds = np.sqrt(np.diag(found.covariance()))
    truth = np.sqrt([1.0, 0.25 + 2.0 * bend**2])
    assert (share * truth < sds[:2]).all()
    np.testing.assert_allclose(sds[2:], 1.0, rtol=0.2)


def test_a_first_proposal_that_is_off_and_too_narrow_is_left() -> None:
    found = importance_samples(lambda x: -0.5 * float(x @ x), [(np.full(SIZE, 0.8), 0.3 * np.eye(SIZE))])
    assert found.effective > 100.0
    np.testing.assert_allclose(found.mean(), 0.0, atol=0.35)
    np.testing.assert_allclose(np.diag(found.covariance()), 1.0, rtol=0.5)


def test_where_the_density_is_zero_no_sample_counts_and_the_same_call_gives_the_same() -> None:
    def half(values: np.ndarray) -> float:
        return -0.5 * float(values @ values) if values[0] > 0.0 else -np.inf

    found, again = (importance_samples(half, [(np.full(SIZE, 0.5), np.eye(SIZE))]) for _ in range(2))
    assert (found.weights[found.values[:, 0] <= 0.0] == 0.0).all()
    assert found.mean()[0] == pytest.approx(np.sqrt(2.0 / np.pi), abs=0.15)
    np.testing.assert_array_equal(found.values, again.values)
    np.testing.assert_array_equal(found.weights, again.weights)


def test_parts_that_lie_apart_are_found_where_a_start_lies_in_each() -> None:
    """Half of the weight lies eight deviations away."""
    places = [np.zeros(SIZE), 8.0 * np.eye(SIZE)[0]]

    def two(values: np.ndarray) -> float:
        return float(
            np.logaddexp.reduce([-0.5 * float((values - place) @ (values - place)) for place in places])
        )

    both = importance_samples(two, [(place, np.eye(SIZE)) for place in places])
    assert both.mean()[0] == pytest.approx(4.0, abs=0.8)
    assert importance_samples(two, [(places[0], np.eye(SIZE))]).mean()[0] < 1.0
