"""The loops of the smoothers are the matrix equations of their textbooks."""

from __future__ import annotations

import numpy as np
import pytest

import estimators.replay.channel_smoother as channel
import estimators.replay.planar_smoother as planar


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def covariances(rng, count, size):
    """Random covariances (count, size, size), states of very different scales."""
    scale = 10.0 ** rng.uniform(-3.0, 1.0, size)
    factors = rng.normal(size=(count, size, size))
    return (factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(size)) * scale * scale[:, None]


def smoothed(means, covs, ahead, ahead_covs, slopes):
    """Rauch, Tung & Striebel, as they write it; ``ahead`` and ``slopes`` of step k belong to k - 1 -> k."""
    means, covs = means.copy(), covs.copy()
    for k in range(len(means) - 2, -1, -1):
        gain = covs[k] @ slopes[k + 1].T @ np.linalg.inv(ahead_covs[k + 1])
        means[k] += gain @ (means[k + 1] - ahead[k + 1])
        covs[k] += gain @ (covs[k + 1] - ahead_covs[k + 1]) @ gain.T
    return means, covs


def test_an_update_by_one_number_is_joseph_s_form(rng):
    (P,), H, mean = covariances(rng, 1, 10), rng.normal(size=10), rng.normal(size=10)
    variance, innovation = 0.3, 0.7
    gain = P @ H / (H @ P @ H + variance)
    J = np.eye(10) - np.outer(gain, H)
    expected = J @ P @ J.T + variance * np.outer(gain, gain)
    there = mean + gain * innovation
    planar._update(mean, P, H, innovation, variance)
    np.testing.assert_allclose(mean, there, rtol=1e-12)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(P / size, expected / size, rtol=0.0, atol=1e-9)


def test_the_backward_pass_of_the_motion_is_rauch_tung_striebel_s(rng):
    count, size = 6, 10
    slopes = np.eye(size) + 0.05 * rng.normal(size=(count, size, size))
    covs, means = covariances(rng, count, size), rng.normal(size=(count, size))
    noise = covariances(rng, count, size)
    ahead, ahead_covs = np.zeros_like(means), np.zeros_like(covs)
    for k in range(1, count):
        ahead[k] = slopes[k] @ means[k - 1]
        ahead_covs[k] = slopes[k] @ covs[k - 1] @ slopes[k].T + noise[k]
    expected_means, expected_covs = smoothed(means, covs, ahead, ahead_covs, slopes)
    planar._backward(planar.Pass(means, covs, ahead, ahead_covs, slopes))
    np.testing.assert_allclose(means, expected_means, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(covs, expected_covs, rtol=1e-7, atol=1e-10 * np.abs(expected_covs).max())


def test_the_backward_pass_of_a_channel_is_rauch_tung_striebel_s(rng):
    step, q, count = 0.02, 3.0, 50
    values = np.cumsum(rng.normal(size=count))
    means, covs = np.empty((count, 2)), np.empty((count, 2, 2))
    channel._forward(values, step, q, 0.04, means, covs)
    F = np.array([[1.0, step], [0.0, 1.0]])
    Q = q * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
    ahead = np.vstack([np.zeros(2), means[:-1] @ F.T])
    ahead_covs = np.concatenate([np.zeros((1, 2, 2)), F @ covs[:-1] @ F.T + Q])
    slopes = np.broadcast_to(F, (count, 2, 2))
    expected_means, expected_covs = smoothed(means, covs, ahead, ahead_covs, slopes)
    channel._backward(means, covs, step, q)
    np.testing.assert_allclose(means, expected_means, rtol=1e-9, atol=1e-9)
    # At the first sample next to nothing is known of the slope: there the digits cancel, here and in NumPy.
    np.testing.assert_allclose(covs[1:], expected_covs[1:], rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(covs[0], expected_covs[0], rtol=1e-4)


def test_a_covariance_without_digits_is_refused(monkeypatch):
    def lost(values, step, q, variance, means, covs):
        means[:], covs[:] = 0.0, 1.0  # speed and slope are known together only: singular
        return 0.0

    monkeypatch.setattr(channel, "_forward", lost)
    backward = channel._backward
    monkeypatch.setattr(channel, "_backward", lambda means, covs, step, q: backward(means, covs, step, 0.0))
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        channel.smooth_channel(np.array([0.0, 1.0, 3.0]), 1.0, 0.1)
