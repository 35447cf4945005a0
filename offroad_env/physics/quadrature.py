"""Quadrature rules of the contact patch, as tables.

The pressure (theta_f - theta)^n has an infinite slope at the ends of the patch for n < 1, where
plain Gauss-Legendre loses its order. Two remedies: nodes placed at u = t^p, which turns the end into
a high power of t and serves any piece of the patch (where the patch is cut, pieces are pieces of t,
so that a piece that begins close to the end is smooth as well); and for the patch as a whole a rule
made for just such integrands.
"""

from __future__ import annotations

import numpy as np

from offroad_env.physics.records import FloatArray

__all__ = ["COARSE", "ENTRY", "EXIT", "FINE", "HALVES", "RUNNING", "SMOOTH", "WHOLE", "Rule", "running_rule"]


class Rule:
    """Gauss-Legendre nodes in t on [0, 1]; u = t^p, p = 3 or 4.

    ``table`` (2, nodes): t and weight. ``quartic`` is 1.0 for p = 4.
    """

    def __init__(self, nodes: int, p: int) -> None:
        x, w = np.polynomial.legendre.leggauss(nodes)
        self.table: FloatArray = np.stack([0.5 * (x + 1.0), 0.5 * w])
        self.quartic = float(p - 3)


#: 8 nodes a segment, for pieces of gentle shear.
COARSE = Rule(8, 3)
#: 16 nodes a segment: pieces of steep shear, and reference accuracy for the public function.
FINE = Rule(16, 4)

#: Generalised Gaussian rule (Ma, Rokhlin & Wandzura, SIAM J. Numer. Anal. 33, 1996): shares u and
#: weights of the eight nodes that err least, 2e-7 at most, over u^(n+k) exp(-g u) and u^(n+k)
#: exp(-g (1-u)), 0 <= n <= 2.5, k = 0, 1, 3, -1 <= g <= 4. Gauss-Legendre at u = t^3 errs by 5e-4
#: there. Made by ``benchmarks/quadrature_rule.py``.
WHOLE: FloatArray = np.array(
    [
        [
            5.133367674845469e-05, 0.004198248371068389, 0.03905892840469938, 0.1479050341078895,
            0.34344776828563073, 0.5884261551657133, 0.8158214473585715, 0.9633287908522989,
        ],
        [
            0.00036015978002702033, 0.012339064627828345, 0.06568851508005007, 0.15441235930230027,
            0.23006999252160626, 0.24806054700410082, 0.19597063736797368, 0.093098724947679,
        ],
    ]
)  # fmt: skip


def running_rule(u: FloatArray, weights: FloatArray) -> FloatArray:
    """A rule that also integrates up to each of its nodes.

    Returns (2 + N, N): shares u on [0, 1], weights, and in row 2 + k what the integrand at node k
    contributes to the integral from 0 to each node, by the polynomial through all nodes.
    """
    count = len(u)
    powers = np.arange(count)
    values = np.polynomial.legendre.legvander(2.0 * u - 1.0, count - 1)
    # Integrals of the Legendre polynomials from 0 to u: (P_{k+1} - P_{k-1}) / (2 (2 k + 1)).
    wide = np.polynomial.legendre.legvander(2.0 * u - 1.0, count)
    before = np.concatenate([-np.ones((count, 1)), wide[:, : count - 1]], axis=1)
    integrals = (wide[:, 1:] - before) / (2.0 * (2.0 * powers + 1.0))
    running = integrals @ np.linalg.inv(values)
    return np.ascontiguousarray(np.vstack([u, weights, running.T]))


def _two_halves() -> FloatArray:
    """Two running Gauss rules of four nodes each, side by side."""
    x, w = np.polynomial.legendre.leggauss(4)
    half = running_rule(0.5 * (x + 1.0), 0.5 * w)
    rule = np.zeros((10, 8))
    rule[:2] = np.tile(half[:2], 2)
    rule[2:6, :4] = rule[6:, 4:] = half[2:]
    return rule


#: Running rules of eight nodes, (4, 10, 8): for a piece that begins where the pressure does, one that ends
#: there, one between, and two pieces of four nodes each. In one array, whose strides a compiler knows.
RUNNING: FloatArray = np.stack(
    [
        running_rule(WHOLE[0], WHOLE[1]),
        running_rule(1.0 - WHOLE[0, ::-1], WHOLE[1, ::-1]),
        running_rule(COARSE.table[0], COARSE.table[1]),
        _two_halves(),
    ]
)
ENTRY, EXIT, SMOOTH, HALVES = range(4)
