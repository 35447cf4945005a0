"""Null simulations in a natural world: what roads and scattering soil do to the residuals of a log.

A bump shakes all channels at once, a long wave pushes for seconds, and soil whose strength varies over metres
changes resistance and grip together; no whitening of single channels accounts for this. So the fitted model
is driven over roads of the stated roughness, where the road is unknown, and over random fields of soil, with
the log's own inputs. What its sensors then read beyond the readings on level, even ground, with white noise
added, is a sample of the residuals of an unmodified vehicle. How rough the road and how uneven the soil is
follows from the energy of the residuals, channel by channel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from estimators.discrepancy.model.autoregressive_noise import white_deviation
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.null_simulations import NullSample
from estimators.discrepancy.model.protocol import ForwardModel
from offroad_env.effects import Setup
from offroad_env.errors import OffroadError
from offroad_env.world.natural_soil import natural_soil, spread_within
from offroad_env.world.terrain import rough_terrain

__all__ = ["null_simulations"]

#: Roads and soils that are drawn: standard deviations come out within a tenth.
_DRAWS = 48
#: Roughness of the draws before they are scaled to the stated height [m^3]: ISO 8608 class A.
_ROUGHNESS = 16e-6
#: How far from the stated height the residuals may move the roads, as a share of their energy.
_LEAST, _MOST = 0.1, 10.0
#: The same for the soil, whose usual scatter is that of `SoilSpread`. Roads have most of the energy, so that
#: little of it tells how even the soil is; none is taken for more even than usual.
_EVEN, _UNEVEN = 1.0, 2.0
#: Correlation lengths of soils [m], and waves of each field: enough for a route of some hundred metres.
_LENGTHS, _WAVES = (2.0, 15.0), 24

_Draw = Callable[[ForwardModel, Setup, np.random.Generator], Setup]


def null_simulations(fit: FitResult) -> NullSample | None:
    """Residuals of an unmodified vehicle at the point of a fit; None where the ground is known."""
    exact = all(run.log.config.exact for run in fit.runs)
    uneven = fit.runs[0].setup.model == "full" and not fit.problem.hard and not exact
    unknown = any(run.log.config.terrain.kind == "unknown" for run in fit.runs)
    rng = np.random.default_rng(8608)
    parts, limits = [], []
    if unknown:
        parts.append(_changes(fit, _over_road, rng))
        limits.append((_LEAST, _MOST))
    if uneven:
        parts.append(_changes(fit, _over_soil, rng))
        limits.append((_EVEN, _UNEVEN))
    kept = [(part, ends) for part, ends in zip(parts, limits, strict=True) if part.shape[1] > 1]
    if not kept:
        return None
    count = min(part.shape[1] for part, _ in kept)
    changes = [part[:, :count] for part, _ in kept]
    noise = rng.standard_normal(changes[0].shape) * _white_level(fit)[:, None]
    shares = _shares(fit, noise, changes, [ends for _, ends in kept])
    residuals = noise + sum(np.sqrt(share) * part for share, part in zip(shares, changes, strict=True))
    return NullSample(residuals=residuals, white=fit.without_states(fit.noise.whiten(residuals)))


def _changes(fit: FitResult, draw: _Draw, rng: np.random.Generator) -> np.ndarray:
    """Changes of the predictions (M, K) by drawn ground; fewer columns where the vehicle cannot drive."""
    found = []
    for _ in range(_DRAWS):
        pairs = zip(fit.runs, fit.linearisation.setups, strict=True)
        setups = [draw(run, setup, rng) for run, setup in pairs]
        try:
            found.append(fit.linearisation.change(setups, 1.0))
        except OffroadError:
            continue
    return np.stack(found, axis=1) if found else np.empty((len(fit.residual), 0))


def _over_road(run: ForwardModel, setup: Setup, rng: np.random.Generator) -> Setup:
    ground = rough_terrain(None, rng, roughness=_ROUGHNESS)
    stated = run.log.config.terrain.rms
    height = float(np.sqrt(0.5 * np.sum(ground.waves[:, 0] ** 2)))
    waves = ground.waves.copy()
    waves[:, 0] *= stated / height if stated else 1.0
    return setup.with_ground(ground._replace(waves=waves))


def _over_soil(run: ForwardModel, setup: Setup, rng: np.random.Generator) -> Setup:
    length = float(rng.uniform(*_LENGTHS))
    soil = setup.plant.soil
    # A fit may end where no more n is possible.
    field = natural_soil(soil, rng, correlation_length=length, spread=spread_within(soil.n), waves=_WAVES)
    return replace(setup, plant=setup.plant._replace(soil_field=field))


def _white_level(fit: FitResult) -> np.ndarray:
    """Standard deviation of the sensors' own noise for every row, from second differences."""
    level = np.empty(len(fit.residual))
    for pieces in fit.noise.pieces.values():
        deviation = white_deviation([fit.residual[piece] for piece in pieces])
        for piece in pieces:
            level[piece] = deviation
    return level


def _shares(
    fit: FitResult, noise: np.ndarray, parts: list[np.ndarray], limits: list[tuple[float, float]]
) -> np.ndarray:
    """Shares of the energy of each part that, with the noise, make up that of the residuals by channel."""
    energies = [_energy(fit, table) for table in (fit.residual[:, None], noise, *parts)]
    weight = 1.0 / np.maximum(energies[1], 1e-9)
    low, high = np.array(limits).T
    matrix = np.stack(energies[2:], axis=1) * weight[:, None]
    found: np.ndarray = lsq_linear(matrix, (energies[0] - energies[1]) * weight, bounds=(low, high)).x
    return found


def _energy(fit: FitResult, table: np.ndarray) -> np.ndarray:
    """Mean over the columns of the whitened squares by channel that starts of windows cannot take away."""
    squares = np.mean(fit.without_states(fit.noise.whiten(table)) ** 2, axis=1)
    return np.array(
        [sum(float(squares[piece].sum()) for piece in pieces) for pieces in fit.noise.pieces.values()]
    )
