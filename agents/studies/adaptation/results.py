"""Errors of prediction by method, and how they compare."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.experiments.motion_sequences import AT

__all__ = ["BARS", "FITTED", "ONLINE", "Comparison", "MethodLine", "comparisons", "method_lines"]

#: Names of the two beliefs over whole soils.
ONLINE, FITTED = "online belief", "fitted belief"
#: Requirements on ratios of mean errors.
BARS = {"belief / nominal": 0.7, "belief / learned": 1.0, "belief / oracle": 1.5, "learned / nominal": 0.7}
_DRAWS, _SEED = 2000, 3
_QUANTITIES = ("position", "speed")


class MethodLine(NamedTuple):
    """A method at one time, over all test drives."""

    method: str
    at: float  #: time of adaptation [s]
    position: float  #: mean error after 3 s [m]
    position_low: float  #: 95 % bootstrap interval over drives
    position_high: float
    position_median: float
    speed: float  #: mean error [m/s]
    speed_low: float
    speed_high: float
    speed_median: float


class Comparison(NamedTuple):
    """Ratio of the mean errors of two methods on the same drives."""

    name: str  #: a requirement of `BARS`
    methods: tuple[str, str]
    quantity: str
    at: float  #: [s]
    ratio: float
    low: float  #: 95 % bootstrap interval over drives
    high: float
    bar: float

    @property
    def met(self) -> bool:
        """Whether the ratio is what was required."""
        return self.ratio <= self.bar


def _resampled(drives: int) -> np.ndarray:
    """(draws, drives) indices, the same for all methods."""
    return np.random.default_rng(_SEED).integers(drives, size=(_DRAWS, drives))


def method_lines(errors: Mapping[str, np.ndarray]) -> list[MethodLine]:
    """Lines for every method and time, from errors (drives, times, 2) by method."""
    lines = []
    for method, found in errors.items():
        draws = found[_resampled(len(found))].mean(axis=1)
        low, high = np.quantile(draws, (0.025, 0.975), axis=0)
        mean, median = found.mean(axis=0), np.median(found, axis=0)
        for i, at in enumerate(AT):
            columns = np.stack([mean[i], low[i], high[i], median[i]]).T.reshape(-1)
            lines.append(MethodLine(method, at, *columns.tolist()))
    return lines


def _ratio(
    name: str, errors: Mapping[str, np.ndarray], methods: tuple[str, str], at: float
) -> list[Comparison]:
    row, found = AT.index(at), []
    one, other = (errors[method][:, row] for method in methods)
    index = _resampled(len(one))
    draws = one[index].mean(axis=1) / other[index].mean(axis=1)
    low, high = np.quantile(draws, (0.025, 0.975), axis=0)
    ratio = one.mean(axis=0) / other.mean(axis=0)
    for i, quantity in enumerate(_QUANTITIES):
        values = float(ratio[i]), float(low[i]), float(high[i])
        found.append(Comparison(name, methods, quantity, at, *values, BARS[name]))
    return found


def comparisons(errors: Mapping[str, np.ndarray], learned: Mapping[int, tuple[str, ...]]) -> list[Comparison]:
    """The required comparisons that these methods allow.

    Parameters
    ----------
    errors
        (drives, times, 2) by method.
    learned
        Names of the learned methods by the number of soils that they were trained on.
    """
    found: list[Comparison] = []
    for belief in (FITTED, ONLINE):
        if belief not in errors:
            continue
        if "nominal" in errors:
            found += _ratio("belief / nominal", errors, (belief, "nominal"), 5.0)
        if 100 in learned:
            better = min(learned[100], key=lambda name: float(errors[name][:, 1, 0].mean()))
            found += _ratio("belief / learned", errors, (belief, better), 5.0)
        found += _ratio("belief / oracle", errors, (belief, "oracle"), 5.0)
    for name in learned.get(300, ()):
        found += _ratio("learned / nominal", errors, (name, "nominal"), 10.0)
    return found


def plain_errors(errors: np.ndarray) -> Any:
    """Errors for a file, to a tenth of a millimetre."""
    return np.round(errors, 4).tolist()
