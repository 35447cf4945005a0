"""Quadrature rules of the contact patch, as tables.

The pressure (theta_f - theta)^n has an infinite slope at the ends of the patch for n < 1, where
plain Gauss-Legendre loses its order. The nodes are therefore placed at u = t^p, which turns the
end into a high power of t. Where the patch is cut into pieces, they are pieces of t, so that a
piece that begins close to the end is smooth as well.
"""

from __future__ import annotations

import numpy as np

__all__ = ["COARSE", "FINE", "Rule"]


class Rule:
    """Gauss-Legendre nodes in t on [0, 1] for both segments of the patch at once; u = t^p, p = 3 or 4.

    Rows of ``table``: t, weight, 1 for the front and 0 for the rear segment. Both segments stand
    in one row so that a loop over it fills whole vector registers. ``quartic`` is 1.0 for p = 4.
    """

    def __init__(self, nodes: int, p: int) -> None:
        x, w = np.polynomial.legendre.leggauss(nodes)
        front = np.repeat([1.0, 0.0], nodes)
        self.table = np.stack([np.tile(0.5 * (x + 1.0), 2), np.tile(0.5 * w, 2), front])
        self.quartic = float(p - 3)


#: Gentle shear: 8 nodes a segment.
COARSE = Rule(8, 3)
#: Steep shear, and reference accuracy for the public function.
FINE = Rule(16, 4)
