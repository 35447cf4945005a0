"""Null simulations on unknown roads: what roughness does to the residuals of a log.

A bump shakes all channels at once, a long wave pushes for seconds, and roughness changes the mean forces of
a wheel; no whitening of single channels accounts for this. So the fitted model is driven over roads of the
stated roughness, with the log's own inputs. What its sensors then read beyond the readings on level ground,
with white noise added, is a sample of the residuals of an unmodified vehicle.
"""

from __future__ import annotations

import numpy as np

from estimators.discrepancy.model.autoregressive_noise import white_deviation
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.null_simulations import NullSample
from offroad_env.errors import OffroadError
from offroad_env.world.terrain import rough_terrain

__all__ = ["null_simulations"]

#: Roads that are drawn: standard deviations come out within a tenth.
_DRAWS = 48
#: Roughness of the draws before they are scaled to the stated height [m^3]: ISO 8608 class A.
_ROUGHNESS = 16e-6
#: How far from the stated height the residuals may move the draws, as a share of their energy.
_LEAST, _MOST = 0.1, 10.0


def null_simulations(fit: FitResult) -> NullSample | None:
    """Residuals of an unmodified vehicle at the point of a fit; None on known ground."""
    if not any(run.log.config.terrain.kind == "unknown" for run in fit.runs):
        return None
    rng = np.random.default_rng(8608)
    road = np.stack([drawn for _ in range(_DRAWS) if (drawn := _over_road(fit, rng)) is not None], axis=1)
    noise = rng.standard_normal(road.shape) * _white_level(fit)[:, None]
    energy = [_energy(fit, part) for part in (fit.residual[:, None], noise, road)]
    share = float(np.clip((energy[0] - energy[1]) / energy[2], _LEAST, _MOST))
    residuals = noise + np.sqrt(share) * road
    return NullSample(residuals=residuals, white=fit.without_states(fit.noise.whiten(residuals)))


def _over_road(fit: FitResult, rng: np.random.Generator) -> np.ndarray | None:
    """Change of the predictions (M,) by a road; None where the vehicle cannot drive over it."""
    setups = []
    for run, setup in zip(fit.runs, fit.linearisation.setups, strict=True):
        ground = rough_terrain(None, rng, roughness=_ROUGHNESS)
        stated = run.log.config.terrain.rms
        height = float(np.sqrt(0.5 * np.sum(ground.waves[:, 0] ** 2)))
        waves = ground.waves.copy()
        waves[:, 0] *= stated / height if stated else 1.0
        setups.append(setup.with_ground(ground._replace(waves=waves)))
    try:
        return fit.linearisation.change(setups, 1.0)
    except OffroadError:
        return None


def _white_level(fit: FitResult) -> np.ndarray:
    """Standard deviation of the sensors' own noise for every row, from second differences."""
    level = np.empty(len(fit.residual))
    for pieces in fit.noise.pieces.values():
        deviation = white_deviation([fit.residual[piece] for piece in pieces])
        for piece in pieces:
            level[piece] = deviation
    return level


def _energy(fit: FitResult, table: np.ndarray) -> float:
    """Mean over the columns of the whitened sum of squares that starts of windows cannot take away."""
    return float(np.sum(fit.without_states(fit.noise.whiten(table)) ** 2) / table.shape[1])
