"""Quadrature rules of the contact patch, as tables.

The pressure (theta_f - theta)^n has an infinite slope at the ends of the patch for n < 1, where
plain Gauss-Legendre loses its order; the nodes are therefore placed at u = t^p. Where the shear
displacement grows fast against the shear modulus, or changes its sign, the patch is cut.
"""

from __future__ import annotations

import numpy as np

__all__ = ["COARSE", "FINE", "MEDIUM", "Rule"]


class Rule:
    """Nodes and weights on [0, 1]: clustered at 0 (``u = t^p``) and plain Gauss-Legendre."""

    def __init__(self, nodes: int, p: int) -> None:
        x, w = np.polynomial.legendre.leggauss(nodes)
        t, w = 0.5 * (x + 1.0), 0.5 * w
        self.clustered = np.stack([t**p, w * p * t ** (p - 1)])
        self.plain = np.stack([t, w])


#: One piece, gentle shear: 8 nodes.
COARSE = Rule(8, 3)
#: Pieces of a patch that was cut.
MEDIUM = Rule(10, 3)
#: Reference accuracy for the public function.
FINE = Rule(16, 4)
