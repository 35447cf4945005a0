"""The search for frequencies of rough ground: what is left of it beside the arc cosines.

NumPy's arc cosine is not the C library's, in a tenth of all values by a rounding error, so the same ground
needs NumPy's. Everything between two of its calls is one pass here instead of ten array operations.
"""

from __future__ import annotations

import math

from offroad_env.physics._jit import exact_kernel
from offroad_env.physics.records import FloatArray

__all__ = ["ANGLE", "HIGH", "LOW", "TRIED", "WANTED", "search_step"]

#: Rows of the search: frequency tried [cycles/m]; arccos of its ratio to the top of the band, in whose place
#: stands the ratio of the next one; the variance beyond that is wanted; the interval.
TRIED, ANGLE, WANTED, LOW, HIGH = range(5)


@exact_kernel
def search_step(rows: FloatArray, top: float, halving: bool) -> int:
    """The next frequencies and their ratios to ``top``, by Newton's method or by ``halving`` the intervals.

    ``rows`` (5, M), in place; for the variance arccos(k / top) / k beyond k. Returns how many intervals could
    still be halved.
    """
    open_ones = 0
    for i in range(rows.shape[1]):
        k, low, high = rows[TRIED, i], rows[LOW, i], rows[HIGH, i]
        variance = rows[ANGLE, i] / k
        if halving:
            low, high = (k, high) if variance > rows[WANTED, i] else (low, k)
            rows[LOW, i], rows[HIGH, i] = low, high
            k = 0.5 * (low + high)
            open_ones += int(low != k != high)
        else:
            falling = variance / k + 1.0 / (k * math.sqrt(max(top * top - k * k, 1e-300)))
            k = min(max(k + (variance - rows[WANTED, i]) / falling, low), high)
        rows[TRIED, i], rows[ANGLE, i] = k, k / top
    return open_ones
