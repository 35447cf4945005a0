"""What an unknown road does to the residuals of a log: drawn, since no whitening of single channels knows it.

A bump shakes all channels at once, a long wave pushes for seconds, and roughness changes the mean forces of
a wheel. So the fitted model is driven over roads of the stated roughness, with the log's own inputs, and what
its sensors then read beyond those on level ground, with white noise added, is what a healthy run looks like.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from offroad_env.errors import OffroadError
from offroad_env.terrain import rough_terrain

if TYPE_CHECKING:
    from estimators.discrepancy.fit import Fit

__all__ = ["chance_of_gain", "healthy_residuals", "widening"]

#: Roads that are drawn: standard deviations come out within a tenth.
_DRAWS = 48
#: Roughness of the draws before they are scaled to the stated height [m^3]: ISO 8608 class A.
_ROUGHNESS = 16e-6
#: How far from the stated height the residuals may move the draws, as a share of their energy.
_LEAST, _MOST = 0.1, 10.0


def healthy_residuals(fit: Fit) -> np.ndarray | None:
    """Residuals of runs with nothing wrong at the present point of a fit, (M, K); None on known ground."""
    if not any(run.log.config.terrain.kind == "unknown" for run in fit.runs):
        return None
    rng = np.random.default_rng(8608)
    residual = fit.residual()
    road = np.stack([drawn for _ in range(_DRAWS) if (drawn := _over_road(fit, rng)) is not None], axis=1)
    noise = rng.standard_normal(road.shape) * _white_level(fit, residual)[:, None]
    energy = [_energy(fit, part) for part in (residual[:, None], noise, road)]
    share = float(np.clip((energy[0] - energy[1]) / energy[2], _LEAST, _MOST))
    return noise + np.sqrt(share) * road


def _over_road(fit: Fit, rng: np.random.Generator) -> np.ndarray | None:
    """What a road adds to the data, (M,); None where the vehicle cannot drive over it."""
    setups = []
    for run, setup in zip(fit.runs, fit._setups(), strict=True):
        ground = rough_terrain(None, rng, roughness=_ROUGHNESS)
        stated = run.log.config.terrain.rms
        height = float(np.sqrt(0.5 * np.sum(ground.waves[:, 0] ** 2)))
        waves = ground.waves.copy()
        waves[:, 0] *= stated / height if stated else 1.0
        setups.append(setup.with_ground(ground._replace(waves=waves)))
    try:
        return fit._derivative(setups, fit.starts, 1.0)
    except OffroadError:
        return None


def _white_level(fit: Fit, residual: np.ndarray) -> np.ndarray:
    """Standard deviation of the sensors' own noise for every row, from second differences."""
    level = np.empty(len(residual))
    for pieces in fit.whitener.pieces.values():
        bends = [np.diff(residual[piece], 2) for piece in pieces if piece.stop - piece.start > 2]
        bent = np.concatenate(bends) if bends else np.zeros(1)
        for piece in pieces:
            level[piece] = 1.4826 * np.median(np.abs(bent)) / np.sqrt(6.0)
    return level


def _energy(fit: Fit, table: np.ndarray) -> float:
    """Mean over the columns of the whitened sum of squares that starts of windows cannot take away."""
    return float(np.sum(fit.without_states(fit.whitener(table)) ** 2) / table.shape[1])


def widening(fit: Fit, columns: np.ndarray, held: int, prior: np.ndarray) -> np.ndarray:
    """By how much healthy runs scatter scores of whitened ``columns`` beyond their information, at least 1.

    Parameters
    ----------
    held
        So many columns at the beginning are fitted along, and get no answer; 0: each with all others.
    prior
        Information about the first columns that is known beforehand.
    """
    table = fit.without_states(columns)
    gram, scores = table.T @ table, table.T @ fit.healthy
    gram[np.arange(len(prior)), np.arange(len(prior))] += prior
    if held == 0:
        inverse = np.linalg.pinv(gram, hermitian=True)
        information, scores = np.diag(inverse), inverse @ scores
    else:
        solved = np.linalg.solve(gram[:held, :held], np.column_stack([gram[:held, held:], scores[:held]]))
        count = columns.shape[1] - held
        information = np.diag(gram)[held:] - np.sum(gram[held:, :held] * solved[:, :count].T, axis=1)
        scores = scores[held:] - gram[held:, :held] @ solved[:, count:]
    return np.maximum(np.mean(scores**2, axis=1) / np.maximum(information, 1e-300), 1.0)


def chance_of_gain(gain: float, freedom: int, healthy: np.ndarray | None) -> float:
    """Share of healthy runs in which ``freedom`` parameters gain as much, in twice the log-likelihood.

    ``healthy`` (K,) are gains in such runs: their mean and variance set the scale and freedom of the
    chi-square law (Satterthwaite, Biometrics Bulletin 2, 1946), which never become smaller than the plain
    one's.
    """
    if healthy is None:
        return float(chi2.sf(gain, freedom))
    mean, variance = float(np.mean(healthy)), float(np.var(healthy, ddof=1))
    scale = max(variance / (2.0 * mean), 1.0)
    return float(chi2.sf(gain / scale, max(mean, freedom) / scale))
