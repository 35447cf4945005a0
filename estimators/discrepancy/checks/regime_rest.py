"""What the causes leave in the whitened residuals, by channel and driving regime.

With a right model the innovations of every channel have mean zero in every regime. A significant mean is a
law that is not right there, and takes the certainty from every cause whose own trace resembles it: a better
law of the same cause, or another cause, may stand behind both.

The noise that a fit learns takes much of what its model lacks for noise of long memory. So residuals are
tested against the white noise of the sensors, with null simulations for roads and soil. The learned noise
serves only where the numbers are not exact and no null simulation tells how residuals scatter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.checks.misfit import driving_regimes, driving_states, rows_of_channel
from estimators.discrepancy.model.autoregressive_noise import white_deviation
from estimators.discrepancy.model.fit import autoregressive
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.normal_equations import projected
from estimators.discrepancy.model.null_simulations import variance_inflation
from estimators.discrepancy.model.run_model import drives

__all__ = ["RegimeRest", "regime_rests"]

#: Least samples of a channel in a regime.
_LEAST = 50
#: The regime of all samples, whose mean is a bias and not the trace of a law.
_ALL = "all"


@dataclass(frozen=True, kw_only=True)
class RegimeRest:
    """Mean innovation of one channel in one regime."""

    channel: str
    regime: str
    z: float  #: in standard deviations
    p_value: float  #: of so large a mean among all channels and regimes (Bonferroni)
    alike: tuple[float, ...]  #: of every effect in the model, |cosine| between its trace and this one's


def regime_rests(fit: FitResult) -> tuple[RegimeRest, ...]:
    """Tests of all channels and regimes at the minimum of a fit, largest first."""
    labels, columns = _indicators(fit)
    if not labels:
        return ()
    if fit.null is not None or all(run.log.config.exact for run in fit.runs):
        fit = _in_white_noise(fit)
    shared = fit.completed().white_shared()
    table = np.column_stack([shared, columns])
    equations = fit.reduced(fit.noise.whiten(fit.residual), table)
    nuisances, inside = len(fit.nuisances), shared.shape[1]
    joint, _ = projected(equations.normal, equations.score, nuisances)
    information, score = projected(equations.normal, equations.score, inside)
    own = np.maximum(np.diag(information), 1e-12)
    wide = np.ones(len(own))
    if fit.null is not None:
        cleared = fit.without_states(table)
        wide = variance_inflation(cleared, fit.null.white, inside, fit.problem.nuisance_information)
    z = score / np.sqrt(own * wide)
    cosines = _cosines(joint, len(fit.sizes))
    p_values = np.minimum(fit.tail(z) * len(z), 1.0)
    found = (
        RegimeRest(
            channel=labels[i][0],
            regime=labels[i][1],
            z=float(z[i]),
            p_value=float(p_values[i]),
            alike=tuple(cosines[:, i].tolist()),
        )
        for i in np.argsort(-np.abs(z))
    )
    return tuple(found)


def _in_white_noise(fit: FitResult) -> FitResult:
    """The fit with the sensors' own white noise, from the second differences of its residuals."""
    levels = {
        name: white_deviation([fit.residual[piece] for piece in pieces])
        for name, pieces in fit.noise.pieces.items()
    }
    white = replace(fit, noise=autoregressive(fit).with_white(levels))
    return white.with_null(fit.null)


def _cosines(joint: np.ndarray, count: int) -> np.ndarray:
    """(E, T) absolute cosines between the traces of the effects and of the means."""
    length = np.sqrt(np.maximum(np.diag(joint), 1e-300))
    return np.asarray(np.abs(joint / np.outer(length, length))[:count, count:])


def _turning_the_wheel(states: list[dict[str, np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Regimes in which what is late shows: the steering moves to one side."""
    rates = [np.gradient(table["steering [rad]"]) for table in states]
    usual = float(np.median(np.abs(np.concatenate(rates))))
    return {
        "steering to the left": [rate > usual for rate in rates],
        "steering to the right": [rate < -usual for rate in rates],
    }


def _indicators(fit: FitResult) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Channel and regime of every test, and unit vectors over the rows that it takes (M, T)."""
    states = [
        driving_states(run, records) for run, records in zip(drives(fit.runs), fit.records, strict=True)
    ]
    labels, columns = [], []
    for regime, inside in (driving_regimes(states) | _turning_the_wheel(states)).items():
        for name in fit.noise.pieces:
            parts = rows_of_channel(fit, name)
            rows = np.concatenate([part.rows[inside[part.run][part.channel.record]] for part in parts])
            if regime == _ALL or len(rows) < _LEAST:
                continue
            column = np.zeros(fit.problem.rows)
            column[rows] = 1.0 / np.sqrt(len(rows))
            labels.append((name, " ".join(regime.split())))
            columns.append(column)
    return labels, np.stack(columns, axis=1) if columns else np.empty((fit.problem.rows, 0))
