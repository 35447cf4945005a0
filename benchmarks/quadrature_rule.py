"""Makes the eight-node rule of the contact patch, ``offroad_env.physics.quadrature.WHOLE``.

A generalised Gaussian rule: nodes and weights, sixteen numbers, that integrate the family
u^(n+k) exp(-g u) and u^(n+k) exp(-g (1-u)) on [0, 1] with the least error (n: exponent of the soil,
k: curvature of the patch, g: growth of the shear). Weighted least squares by Levenberg-Marquardt
from Gauss-Legendre nodes; the weights follow the largest errors. Prints the rule and its errors.
"""

from __future__ import annotations

import numpy as np

from offroad_env.physics.quadrature import WHOLE

EXPONENTS = np.concatenate([[0.0, 0.06, 0.12, 0.2], np.linspace(0.3, 2.5, 10)])
GROWTHS = (-1.0, 0.0, 1.0, 2.0, 3.0, 4.0)
CURVATURES = (0, 1, 3)
ROUNDS, STEPS = 30, 200


def gauss(nodes: int, p: float) -> np.ndarray:
    """Gauss-Legendre nodes and weights in t, placed at u = t^p; shape (2, nodes)."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    t = 0.5 * (x + 1.0)
    return np.stack([t**p, 0.5 * w * p * t ** (p - 1.0)])


def family(growths: tuple[float, ...], exponents: np.ndarray) -> np.ndarray:
    """Members (M, 4): power, growth, direction (1 from u = 0, -1 from u = 1), scale."""
    return np.array(
        [
            (n + k, g, direction, n + 1.0)
            for n in exponents
            for g in growths
            for k in CURVATURES
            for direction in (1.0, -1.0)
            if g != 0.0 or direction > 0.0
        ]
    )


def values(members: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The members at ``u`` and their slopes, (M, nodes) each."""
    power, growth, direction, scale = members.T[:, :, None]
    fall = np.exp(np.where(direction > 0.0, -growth * u, -growth * (1.0 - u)))
    value = scale * u**power * fall
    return value, value * (power / u - growth * direction)


def errors(rule: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Error of the rule at every member."""
    fine = gauss(150, 6.0)
    return values(members, rule[0])[0] @ rule[1] - values(members, fine[0])[0] @ fine[1]


def as_rule(z: np.ndarray) -> np.ndarray:
    """Unconstrained numbers as nodes in (0, 1) and positive weights."""
    half = len(z) // 2
    return np.stack([1.0 / (1.0 + np.exp(-z[:half])), np.exp(z[half:])])


def improve(z: np.ndarray, members: np.ndarray, importance: np.ndarray) -> np.ndarray:
    """Levenberg-Marquardt for the weighted sum of squared errors."""

    def system(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, w = as_rule(z)
        value, slope = values(members, u)
        return errors(as_rule(z), members) * importance, np.hstack(
            [slope * (w * u * (1.0 - u)), value * w]
        ) * importance[:, None]

    damping = 1e-3
    residual, jacobian = system(z)
    for _ in range(STEPS):
        left, sigma, right = np.linalg.svd(jacobian, full_matrices=False)
        step = -right.T @ (sigma / (sigma**2 + (damping * sigma[0]) ** 2) * (left.T @ residual))
        step *= min(1.0, 0.5 / np.abs(step).max())
        tried = system(z + step)
        if np.sum(tried[0] ** 2) < np.sum(residual**2):
            z, (residual, jacobian), damping = z + step, tried, max(0.3 * damping, 1e-16)
            if np.abs(step).max() < 1e-10:
                break
        else:
            damping *= 5.0
            if damping > 1e3:
                break
    return z


def make(nodes: int = 8) -> np.ndarray:
    """The rule with the least largest error, (2, nodes)."""
    members = family(GROWTHS, EXPONENTS)
    u, w = gauss(nodes, 2.5)
    z = np.concatenate([np.log(u / (1.0 - u)), np.log(w)])
    importance = np.ones(len(members))
    best, least = as_rule(z), np.inf
    for _ in range(ROUNDS):
        z = improve(z, members, importance)
        error = np.abs(errors(as_rule(z), members))
        if error.max() < least:
            best, least = as_rule(z), error.max()
        importance *= (error / error.max() + 0.05) ** 0.3
        importance /= importance.max()
    return best


def main() -> None:
    """Print the rule, and the errors of the rules in use."""
    rule = make()
    print(np.array2string(rule, separator=", ", floatmode="unique"))
    between = np.linspace(0.05, 2.5, 30)
    print(f"{'largest error at growth':28}" + "".join(f"{g:9g}" for g in (-1, 0, 1, 2, 3, 4, 6)))
    for name, one in (
        ("made now", rule),
        ("in the kernels", WHOLE),
        ("Gauss-Legendre, 8, t^3", gauss(8, 3.0)),
        ("Gauss-Legendre, 16, t^4", gauss(16, 4.0)),
    ):
        row = [np.abs(errors(one, family((g,), between))).max() for g in (-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0)]
        print(f"{name:28}" + "".join(f"{error:9.1e}" for error in row))


if __name__ == "__main__":
    main()
