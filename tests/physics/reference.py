"""An independent evaluation of the wheel-soil model, straight from the paper's equations.

Nothing here calls a kernel: stresses are written as Buzhardt & Tallapragada (ACC 2021, section
II-B) print them, integrated by adaptive quadrature (QUADPACK) and inverted for the sinkage by
Brent's method. The tests and ``benchmarks/accuracy_wheel.py`` share it, and the random inputs.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from offroad_env.physics.records import Soil, Wheel
from offroad_env.simulation.wheel import wheel_forces

__all__ = [
    "CHANNELS",
    "Case",
    "Forces",
    "ask_kernel",
    "ask_reference",
    "draw_case",
    "draw_soil",
    "errors",
    "forces_at",
]

#: What is compared, in the order of `errors`.
CHANNELS = ("F_x", "F_y", "F_z", "torque", "sinkage")

#: Absolute accuracy of the integrals, as a share of the largest stress times the patch.
_TOLERANCE = 1e-10


class Forces(NamedTuple):
    """What the ground does to a wheel."""

    F_x: float  #: [N]
    F_y: float  #: [N]
    F_z: float  #: [N]
    torque: float  #: [N m]
    sinkage: float  #: [m]


class Case(NamedTuple):
    """One question to the model."""

    soil: Soil
    wheel: Wheel
    slip: float  #: public slip, -1 ... 1 [-]
    slip_angle: float  #: [rad]
    shear: str  #: "independent" or "resultant"
    load: float  #: [N]


def _held(x: float, low: float, high: float, width: float) -> float:
    """``x`` itself between ``low + width`` and ``high - width``; beyond, tanh towards the limits."""
    middle = min(max(x, low + width), high - width)
    return middle + width * math.tanh((x - middle) / width)


def ordered_shares(soil: Soil, slip: float) -> tuple[float, float]:
    """(theta_m, theta_r) over theta_f: the paper's straight lines, bent only where they would cross."""
    share_m = _held(soil.a_0 + soil.a_1 * slip, -0.01, 0.98, 0.01)
    share_r = _held(soil.b_0 + soil.b_1 * slip, -0.98, share_m - 0.01, 0.005)
    return share_m, share_r


class Patch:
    """The contact patch at one sinkage: stresses as functions of the angle theta."""

    def __init__(self, case: Case, h: float) -> None:
        soil, wheel = case.soil, case.wheel
        self.soil, self.wheel, self.slip = soil, wheel, case.slip
        self.resultant = case.shear == "resultant"
        self.tan_beta, self.tan_phi = math.tan(case.slip_angle), math.tan(soil.phi)
        self.theta_f = math.acos(1.0 - h / wheel.r)
        self.cos_f, self.sin_f = math.cos(self.theta_f), math.sin(self.theta_f)
        share_m, share_r = ordered_shares(soil, case.slip)
        self.theta_m, self.theta_r = share_m * self.theta_f, share_r * self.theta_f
        self.pressure = soil.k_c / wheel.b + soil.k_phi
        self.locked = case.slip <= -1.0
        # The paper's 1 - s is v/(r omega); the braked wheel's slip refers to v: r omega/v = 1 + s.
        if case.slip >= 0.0:
            self.ratio = 1.0 - case.slip
        else:
            self.ratio = math.inf if self.locked else 1.0 / (1.0 + case.slip)

    def sinkage(self, theta: float) -> float:
        """h(theta) [m], in its two pieces."""
        if theta < self.theta_m:
            share = (theta - self.theta_r) / (self.theta_m - self.theta_r)
            theta = self.theta_f - share * (self.theta_f - self.theta_m)
        return max(self.wheel.r * (math.cos(theta) - self.cos_f), 0.0)

    def displacements(self, theta: float) -> tuple[float, float]:
        """(j_x/k_x, j_y/k_y); for a locked wheel (infinite) their directions."""
        r, soil = self.wheel.r, self.soil
        turned, passed = self.theta_f - theta, self.sin_f - math.sin(theta)
        if self.locked:
            return -r * passed / soil.k_x, r * turned * self.tan_beta / soil.k_y
        j_x = r * (turned - self.ratio * passed)
        j_y = r * self.ratio * turned * self.tan_beta
        return j_x / soil.k_x, j_y / soil.k_y

    def mobilised(self, theta: float) -> tuple[float, float]:
        """Shares of the strength along and across the wheel: 1 - exp(-j/k), odd in j."""
        j_x, j_y = self.displacements(theta)
        if self.resultant:
            j = math.hypot(j_x, j_y)
            if j == 0.0:
                return 0.0, 0.0
            share = 1.0 if self.locked else -math.expm1(-j)
            return share * j_x / j, share * j_y / j
        if self.locked:
            return float(np.sign(j_x)), float(np.sign(j_y))
        return math.copysign(math.expm1(-abs(j_x)), j_x), math.copysign(math.expm1(-abs(j_y)), j_y)

    def stresses(self, theta: float) -> tuple[float, float, float]:
        """(sigma, tau_x, tau_y) [Pa]."""
        sigma = self.pressure * self.sinkage(theta) ** self.soil.n
        strength = self.soil.c + sigma * self.tan_phi
        along, across = self.mobilised(theta)
        return sigma, strength * along, strength * across

    def edges(self) -> list[float]:
        """The patch cut where an integrand has a corner, changes its sign or has a steep layer."""
        span = self.theta_f - self.theta_r
        points = {self.theta_m}
        if not self.locked:
            # Near the entry the shear grows from nothing to its full value within 1/rate.
            rate = max(abs(self.ratio * self.cos_f - 1.0), abs(self.ratio - 1.0)) / self.soil.k_x
            rate = max(rate, abs(self.ratio * self.tan_beta) / self.soil.k_y) * self.wheel.r * span
            # A layer thinner than 1e-11 of the patch adds less than that: no cut needed, and none possible.
            layers = min(math.ceil(math.log10(max(rate, 1.0))) + 1, 12)
            points |= {self.theta_f - span * 10.0**-i for i in range(1, layers)}
        if -1.0 < self.slip < 0.0:
            theta = self.theta_f - span * np.linspace(1e-6, 1.0, 200)
            j = self.ratio * (np.sin(theta) - self.sin_f) + self.theta_f - theta
            for i in np.flatnonzero(np.sign(j[:-1]) != np.sign(j[1:])):
                points.add(brentq(lambda t: self.displacements(t)[0], theta[i], theta[i + 1], xtol=1e-15))
        inside = sorted(p for p in points if self.theta_r < p < self.theta_f)
        return [self.theta_r, *inside, self.theta_f]

    def integral(self, integrand, tolerance: float = _TOLERANCE) -> float:
        """Integral of ``integrand(theta)`` [Pa] over the patch."""
        edges = self.edges()
        largest = self.pressure * self.sinkage(self.theta_m) ** self.soil.n + self.soil.c
        small = tolerance * largest * (self.theta_f - self.theta_r)
        pieces = (quad(integrand, a, b, epsabs=small, epsrel=1e-12, limit=200)[0] for a, b in pairwise(edges))
        return math.fsum(pieces)

    def along(self, theta: float) -> float:
        """Integrand of F_x."""
        sigma, tau_x, _ = self.stresses(theta)
        return tau_x * math.cos(theta) - sigma * math.sin(theta)

    def upward(self, theta: float) -> float:
        """Integrand of F_z."""
        sigma, tau_x, _ = self.stresses(theta)
        return tau_x * math.sin(theta) + sigma * math.cos(theta)


def vertical_force(case: Case, h: float) -> float:
    """F_z [N] at sinkage ``h`` [m]."""
    patch = Patch(case, h)
    return case.wheel.r * case.wheel.b * patch.integral(patch.upward)


def forces_at(case: Case, h: float, tolerance: float = _TOLERANCE) -> Forces:
    """All forces at sinkage ``h`` [m]."""
    patch = Patch(case, h)
    area = case.wheel.r * case.wheel.b
    return Forces(
        area * patch.integral(patch.along, tolerance),
        -area * patch.integral(lambda theta: patch.stresses(theta)[2], tolerance),
        area * patch.integral(patch.upward, tolerance),
        area * case.wheel.r * patch.integral(lambda theta: patch.stresses(theta)[1], tolerance),
        h,
    )


def ask_reference(case: Case) -> Forces:
    """The sinkage at which the soil carries the load, and the forces there.

    Brent's method on ln F_z - ln load over ln h, nearly a straight line, between 1e-5 r and 0.95 r.
    Deep in strong soil the friction of a braked wheel pulls it down, and F_z falls again: then up to
    the first depth at which the load is exceeded, for a wheel comes from above.
    """

    def excess(log_h: float) -> float:
        carried = vertical_force(case, math.exp(log_h))
        return math.log(carried / case.load) if carried > 0.0 else -700.0

    low, high = math.log(1e-5 * case.wheel.r), math.log(0.95 * case.wheel.r)
    if excess(high) <= 0.0:
        high = next(x for x in np.linspace(low, high, 400) if excess(x) > 0.0)
    return forces_at(case, math.exp(brentq(excess, low, high, xtol=1e-11, rtol=1e-14)))


def _drawn_slip(rng: np.random.Generator) -> float:
    """Slip over -1 ... 1, with the hard places given their share: locked, spinning, free, near each."""
    kind = rng.random()
    if kind < 0.10:
        return float(rng.choice([-1.0, 0.0, 1.0]))
    if kind < 0.20:
        return -1.0 + 10.0 ** rng.uniform(-8.0, -1.0)
    if kind < 0.30:
        return float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(-8.0, -1.0)
    return rng.uniform(-1.0, 1.0)


def draw_soil(rng: np.random.Generator) -> Soil:
    """Any soil between snow and heavy clay, any contact angles that the factory would accept."""
    while True:
        a_0, b_0 = rng.uniform(0.15, 0.6), rng.uniform(-0.4, 0.0)
        a_1, b_1 = rng.uniform(0.0, 0.35), rng.uniform(-0.1, 0.1)
        if all(-1.0 < b_0 + b_1 * s < a_0 + a_1 * s < 1.0 for s in (-0.5, 0.0, 1.0)):
            break
    return Soil(
        k_c=10.0 ** rng.uniform(2.0, 5.0),
        k_phi=10.0 ** rng.uniform(4.5, 7.0),
        n=rng.uniform(0.1, 1.6),
        c=10.0 ** rng.uniform(2.0, math.log10(20e3)),
        phi=math.radians(rng.uniform(0.0, 40.0)),
        k_x=rng.uniform(5e-3, 40e-3),
        k_y=rng.uniform(5e-3, 40e-3),
        a_0=a_0,
        a_1=a_1,
        b_0=b_0,
        b_1=b_1,
        rigid=0.0,
        mu=0.8,
        C_alpha=10.0,
        C_kappa=10.0,
    )


def draw_case(rng: np.random.Generator) -> Case:
    """A random valid input.

    The load is what the soil carries, by the reference, at a sinkage drawn between 0.003 and 0.6 of
    the radius; so every draw has an answer, and no kernel decides which inputs are kept. Refused
    are soils whose cohesion exceeds a third of the Bekker pressure at that depth: there the
    adhesion of a braked wheel, and no longer the sinkage, would carry it or pull it down.
    """
    while True:
        soil = draw_soil(rng)
        r = 10.0 ** rng.uniform(math.log10(0.05), math.log10(0.6))
        wheel = Wheel(r=r, b=r * rng.uniform(0.3, 1.5))
        share = rng.uniform(-0.5, 0.5) if rng.random() < 0.9 else rng.choice([-0.5, 0.0, 0.5])
        shear = str(rng.choice(["independent", "resultant"]))
        case = Case(soil, wheel, _drawn_slip(rng), float(share * math.pi), shear, 0.0)
        h = r * 10.0 ** rng.uniform(math.log10(0.003), math.log10(0.6))
        if soil.c > (soil.k_c / wheel.b + soil.k_phi) * h**soil.n / 3.0:
            continue
        load = vertical_force(case, h)
        if load > 0.0:
            # Rounded, so that the drawn sinkage is not handed back by the question.
            return case._replace(load=float(f"{load:.6g}"))


def ask_kernel(case: Case) -> Forces:
    """The answer of the public function."""
    answer = wheel_forces(
        case.soil, case.wheel, load=case.load, slip=case.slip, slip_angle=case.slip_angle, shear=case.shear
    )
    return Forces(*(float(getattr(answer, name)) for name in CHANNELS))


def errors(case: Case, answer: Forces, truth: Forces) -> np.ndarray:
    """Differences (5,): forces over the load, torque over load times radius, sinkage relative."""
    scale = np.array([case.load, case.load, case.load, case.load * case.wheel.r, truth.sinkage])
    return np.abs(np.subtract(answer, truth)) / scale
