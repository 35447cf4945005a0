"""How far scores and gains scatter in simulations of an unmodified vehicle, and the p-values that follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

__all__ = ["NullSample", "inflation_along", "p_value_of_gain", "variance_inflation"]


@dataclass(frozen=True, kw_only=True)
class NullSample:
    """Residuals of K simulations in which nothing is wrong."""

    residuals: np.ndarray  #: (M, K)
    white: np.ndarray  #: (M, K) whitened, less what the starts of the windows can take away


def variance_inflation(
    columns: np.ndarray, null: np.ndarray, held: int, information: np.ndarray
) -> np.ndarray:
    """Variance of scores in null simulations over their Fisher information, at least 1.

    Parameters
    ----------
    columns
        (M, g) whitened derivatives, less what the starts of the windows can take away.
    null
        (M, K) residuals of null simulations, treated alike.
    held
        So many columns at the beginning are fitted along, and get no answer; 0: each with all others.
    information
        Prior information about the first columns.
    """
    gram, scores = columns.T @ columns, columns.T @ null
    gram[np.arange(len(information)), np.arange(len(information))] += information
    if held == 0:
        inverse = np.linalg.pinv(gram, hermitian=True)
        own, scores = np.diag(inverse), inverse @ scores
    else:
        # What the data do not show, such as an effect that its range holds at nothing, takes nothing away.
        inner = gram[:held, :held] + np.diag(np.where(np.diag(gram)[:held] > 0.0, 0.0, 1.0))
        solved = np.linalg.solve(inner, np.column_stack([gram[:held, held:], scores[:held]]))
        count = columns.shape[1] - held
        own = np.diag(gram)[held:] - np.sum(gram[held:, :held] * solved[:, :count].T, axis=1)
        scores = scores[held:] - gram[held:, :held] @ solved[:, count:]
    inflation: np.ndarray = np.maximum(np.mean(scores**2, axis=1) / np.maximum(own, 1e-300), 1.0)
    return inflation


def inflation_along(direction: np.ndarray, null: np.ndarray) -> float:
    """Variance of whitened null residuals (M, K) along a direction (M,), over white noise's; at least 1."""
    square = float(direction @ direction)
    return max(float(np.mean((direction @ null) ** 2)) / max(square, 1e-300), 1.0)


def p_value_of_gain(gain: float, freedom: int, null: np.ndarray | None) -> float:
    """Probability that ``freedom`` parameters gain as much, in twice the log-likelihood, under the null.

    ``null`` (K,) are gains in null simulations: their mean and variance set the scale and freedom of the
    chi-square law (Satterthwaite, Biometrics Bulletin 2, 1946), which never become smaller than the plain
    one's.
    """
    if null is None:
        return float(chi2.sf(gain, freedom))
    mean, variance = float(np.mean(null)), float(np.var(null, ddof=1))
    scale = max(variance / (2.0 * mean), 1.0)
    return float(chi2.sf(gain / scale, max(mean, freedom) / scale))
