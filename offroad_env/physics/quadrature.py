"""Quadrature rules of the contact patch, as tables.

The pressure (theta_f - theta)^n has an infinite slope at the ends of the patch for n < 1, where
plain Gauss-Legendre loses its order; the nodes are therefore placed at u = t^p. Where the shear
displacement grows fast against the shear modulus, or changes its sign, the patch is cut.
"""

from __future__ import annotations

import numpy as np

__all__ = ["COARSE", "FINE", "Rule"]


class Rule:
    """Nodes and weights for both segments of the patch at once, on the share u in [0, 1].

    ``clustered`` has u = t^p, for the piece that touches the ends of the patch; ``plain`` has
    u = t. Rows: u, weight, 1 for the front and 0 for the rear segment. Both segments stand in one
    row so that a loop over it fills whole vector registers.
    """

    def __init__(self, nodes: int, p: int) -> None:
        x, w = np.polynomial.legendre.leggauss(nodes)
        t, w = 0.5 * (x + 1.0), 0.5 * w
        front = np.repeat([1.0, 0.0], nodes)
        self.clustered = np.stack([np.tile(t**p, 2), np.tile(w * p * t ** (p - 1), 2), front])
        self.plain = np.stack([np.tile(t, 2), np.tile(w, 2), front])


#: Gentle shear: 8 nodes a segment.
COARSE = Rule(8, 3)
#: Steep shear, and reference accuracy for the public function.
FINE = Rule(16, 4)
