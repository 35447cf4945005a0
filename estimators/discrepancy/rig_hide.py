"""Trials of a wheel rig with something hidden in them, for tests of the finder.

A second wheel in soil, written from the literature with nothing of the compiled one: all trials at once, by
the midpoint rule, with bisection for the sinkage. What is hidden is written here again, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.logs.config import LogConfig
from estimators.logs.log import Log
from estimators.logs.writing import content_hash
from offroad_env.soils import SOILS, make_soil
from offroad_env.vehicles import make_wheel

__all__ = ["RIG_HIDERS", "RIG_STRANGERS", "RigCase", "RigHidden", "draw_rig_case", "hidden_trials"]

#: Points of the midpoint rule, and halvings of the sinkage.
_POINTS, _HALVINGS = 400, 45
_SLIPS = (-0.6, -0.4, -0.2, 0.0, 0.15, 0.3, 0.5, 0.7, 0.85)
_SOILS = ("dry_sand", "sandy_loam", "lete_sand", "rubicon_sandy_loam", "upland_sandy_loam")
_REPEATS = 3
#: Scatter of the prepared soil's moduli, from condition to condition and from repeat to repeat [-].
_BED, _FILL = 0.02, 0.03
#: Noise of the gauges: share of the load, share of the radius.
_FORCE_NOISE, _DEPTH_NOISE = 0.01, 0.003

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class RigCase:
    """Everything of a rig's trials but what is hidden in them."""

    seed: int
    soil: str
    n: float  #: true sinkage exponent; the log states the catalogue's [-]
    r: float  #: [m]
    b: float  #: [m]
    load: float  #: mean wheel load [N]
    angles: tuple[float, ...]  #: slip angles [rad]


@dataclass(frozen=True, kw_only=True)
class RigHidden:
    """What is wrong, by what it does; every part may be left out.

    ``soil`` changes the arrays of soil parameters of all trials, from (parameters, trials); ``forces``
    adds to what the soil does, from (answer, trials, case); ``gauges`` adds to what is written down.
    """

    soil: Callable[[Arrays, Arrays], None] = field(default=lambda soil, trials: None)
    pressure: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None  #: (pressure, depth) -> pressure
    forces: Callable[[Arrays, Arrays, RigCase], None] = field(default=lambda answer, trials, case: None)
    gauges: Callable[[Arrays, RigCase], None] = field(default=lambda answer, case: None)
    load: float = 1.0  #: true load over the written one


def draw_rig_case(seed: int, **fixed) -> RigCase:
    """Trials drawn from their seed; ``fixed`` sets fields."""
    rng = np.random.default_rng([seed, 11])
    soil = str(rng.choice(_SOILS))
    r = float(rng.uniform(0.1, 0.35))
    b = r * float(rng.uniform(0.5, 0.8))
    # A load that sinks the rolling wheel by about a tenth of its radius.
    record = SOILS[soil]
    pressure = (record.k_c / b + record.k_phi) * (0.1 * r) ** record.n
    values = {
        "soil": soil,
        "n": float(record.n + rng.uniform(-0.08, 0.08)),
        "r": r,
        "b": b,
        "load": float(0.3 * pressure * r * b * rng.uniform(0.7, 1.3)),
        "angles": (0.0, 0.15, 0.35, 0.6),
    }
    return RigCase(seed=seed, **(values | fixed))


def hidden_trials(case: RigCase, hidden: RigHidden | None = None) -> Log:
    """The log that the finder gets."""
    hidden = RigHidden() if hidden is None else hidden
    rng = np.random.default_rng([case.seed, 12])
    angle, slip = (grid.ravel() for grid in np.meshgrid(case.angles, _SLIPS, indexing="ij"))
    condition = np.repeat(np.arange(len(slip)), _REPEATS)
    count = len(condition)
    load = case.load * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, len(slip)))[condition]
    trials = {
        "slip": slip[condition] + 0.005 * rng.standard_normal(count),
        "slip_angle": angle[condition],
        "load": load * (1.0 + 0.02 * rng.standard_normal(count)),
    }
    true = make_soil(case.soil, n=case.n)
    bed = 1.0 + _BED * rng.standard_normal(len(slip))[condition] + _FILL * rng.standard_normal(count)
    soil = {name: np.full(count, value) for name, value in true._asdict().items()}
    soil["k_c"], soil["k_phi"] = soil["k_c"] * bed, soil["k_phi"] * bed
    hidden.soil(soil, trials)
    answer = _wheel(soil, trials, case, hidden)
    hidden.forces(answer, trials, case)
    for name, scale in (
        ("drawbar", _FORCE_NOISE * case.load),
        ("side_force", _FORCE_NOISE * case.load),
        ("torque", _FORCE_NOISE * case.load * case.r),
        ("sinkage", _DEPTH_NOISE * case.r),
    ):
        answer[name] = answer[name] + scale * rng.standard_normal(count)
    hidden.gauges(answer, case)
    config = LogConfig(soil=SOILS[case.soil], wheel=make_wheel(r=case.r, b=case.b))
    channels = {**trials, **answer, "condition": condition.astype(float)}
    log = Log(name="trials", t=None, channels=channels, references={}, config=config, hash="")
    return replace(log, hash=content_hash(log))


# ------------------------------------------------------------------ the second wheel


def _wheel(soil: Arrays, trials: Arrays, case: RigCase, hidden: RigHidden) -> Arrays:
    """Sinkage by bisection of the vertical balance, then the forces (Wong & Reece 1967)."""
    load = hidden.load * trials["load"]
    low, high = np.zeros(len(load)), np.full(len(load), 0.95 * case.r)
    for _ in range(_HALVINGS):
        h = 0.5 * (low + high)
        light = _stressed(soil, trials, case, h, hidden)[2] < load
        low, high = np.where(light, h, low), np.where(light, high, h)
    h = 0.5 * (low + high)
    F_x, F_y, _, T = _stressed(soil, trials, case, h, hidden)
    return {"sinkage": h, "drawbar": F_x, "side_force": F_y, "torque": T}


def _stressed(soil: Arrays, trials: Arrays, case: RigCase, h: np.ndarray, hidden: RigHidden):
    """(F_x, F_y, F_z, T) at the sinkage ``h`` (M,): integrals over the patch, front and rear apart."""
    s, beta = trials["slip"], trials["slip_angle"]
    theta_f = np.arccos(1.0 - h / case.r)
    theta_m = theta_f * (soil["a_0"] + soil["a_1"] * s)
    theta_r = theta_f * (soil["b_0"] + soil["b_1"] * s)
    u = (np.arange(_POINTS) + 0.5)[:, None] / _POINTS
    # Travel over rim speed, along the wheel and across it.
    along = np.where(s >= 0.0, 1.0 - s, 1.0 / (1.0 + s))
    across = along * np.tan(beta)
    totals = np.zeros((4, len(h)))
    for start, stop, ahead in ((theta_m, theta_f, True), (theta_r, theta_m, False)):
        theta = start + u * (stop - start)
        # The rear of the patch bears what the front bears at the same share of the way to the peak.
        alike = theta if ahead else theta_f - (theta - theta_r) / (theta_m - theta_r) * (theta_f - theta_m)
        depth = np.maximum(case.r * (np.cos(alike) - np.cos(theta_f)), 0.0)
        sigma = (soil["k_c"] / case.b + soil["k_phi"]) * depth ** soil["n"]
        if hidden.pressure is not None:
            sigma = hidden.pressure(sigma, depth / case.r)
        j_x = case.r * (theta_f - theta - along * (np.sin(theta_f) - np.sin(theta))) / soil["k_x"]
        j_y = case.r * across * (theta_f - theta) / soil["k_y"]
        j = np.hypot(j_x, j_y) + 1e-12
        tau = (soil["c"] + sigma * np.tan(soil["phi"])) * -np.expm1(-j)
        t_x, t_y, weight = tau * j_x / j, tau * j_y / j, (stop - start) / _POINTS
        cos, sin = np.cos(theta), np.sin(theta)
        for i, part in enumerate((t_x * cos - sigma * sin, -t_y, t_x * sin + sigma * cos, t_x)):
            totals[i] += weight * part.sum(axis=0)
    return case.r * case.b * totals * np.array([1.0, 1.0, 1.0, case.r])[:, None]


# ------------------------------------------------------------------ what is hidden


def _slide(trials: Arrays) -> np.ndarray:
    """Slip along and across the wheel together."""
    s, beta = trials["slip"], trials["slip_angle"]
    rim, along = np.where(s >= 0.0, 1.0, 1.0 + s), np.where(s >= 0.0, 1.0 - s, 1.0)
    travel = along / np.cos(beta)
    return np.minimum(np.hypot(s, along * np.tan(beta) / np.maximum(rim, travel)), 1.0)


def _times(name: str, factor: Callable[[Arrays], np.ndarray]) -> RigHidden:
    def change(soil: Arrays, trials: Arrays) -> None:
        for each in name.split():
            soil[each] = soil[each] * factor(trials)

    return RigHidden(soil=change)


def _plus(name: str, amount: float) -> RigHidden:
    def change(soil: Arrays, trials: Arrays) -> None:
        soil[name] = np.maximum(soil[name] + amount, 0.0) if name == "c" else soil[name] + amount

    return RigHidden(soil=change)


def _deeper(power: float) -> RigHidden:
    """Lyasko 2010, with n as each trial has it."""

    def change(soil: Arrays, trials: Arrays) -> None:
        s = _slide(trials)
        factor = ((1.0 + s) / (1.0 - 0.5 * s)) ** (-power * soil["n"])
        soil["k_c"], soil["k_phi"] = soil["k_c"] * factor, soil["k_phi"] * factor

    return RigHidden(soil=change)


def _growing(slope: float) -> RigHidden:
    def change(soil: Arrays, trials: Arrays) -> None:
        soil["n"] = soil["n"] + slope * np.abs(trials["slip"])

    return RigHidden(soil=change)


def _side_push(stress: float) -> RigHidden:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        face = 2.0 * case.r * answer["sinkage"]
        answer["side_force"] = answer["side_force"] - stress * face * np.sin(trials["slip_angle"])

    return RigHidden(forces=push)


def _front_push(gradient: float) -> RigHidden:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        s = trials["slip"]
        share = np.where(s >= 0.0, (1.0 - s) / np.hypot(1.0, 1.0 - s), 1.0 / np.hypot(1.0, 1.0 + s))
        force = 0.5 * gradient * case.b * answer["sinkage"] ** 2
        answer["drawbar"] = answer["drawbar"] - force * share

    return RigHidden(forces=push)


def _tread(share: float) -> RigHidden:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        thrust = share * trials["load"] * np.tanh(10.0 * trials["slip"])
        answer["drawbar"] = answer["drawbar"] + thrust
        answer["torque"] = answer["torque"] + case.r * thrust

    return RigHidden(forces=push)


def _reads(name: str, amount: float) -> RigHidden:
    def shift(answer: Arrays, case: RigCase) -> None:
        answer[name] = answer[name] + amount

    return RigHidden(gauges=shift)


#: Effect of the library -> what does the same, from its size.
RIG_HIDERS: dict[str, Callable[[float], RigHidden]] = {
    "slip_digging": _deeper,
    "soil_loosening": lambda rate: _times("k_c k_phi", lambda trials: np.exp(-rate * _slide(trials))),
    "slip_sinkage": _growing,
    "bulldozing": _side_push,
    "front_bulldozing": _front_push,
    "grouser_thrust": _tread,
    "friction_angle": lambda angle: _plus("phi", angle),
    "cohesion": lambda stress: _plus("c", stress),
    "exit_angle": lambda share: _plus("b_0", share),
    "peak_angle": lambda share: _plus("a_0", share),
    "shear_modulus": lambda share: _times("k_x k_y", lambda trials: 1.0 + share),
    "drawbar_offset": lambda force: _reads("drawbar", force),
    "side_force_offset": lambda force: _reads("side_force", force),
    "sinkage_offset": lambda depth: _reads("sinkage", depth),
    "load_scale": lambda share: RigHidden(load=1.0 + share),
}


def _hard_pan(share: float) -> RigHidden:
    """Firm ground below a tenth of the radius."""
    return RigHidden(
        pressure=lambda sigma, depth: sigma * (1.0 + 10.0 * share * np.maximum(depth - 0.1, 0.0))
    )


def _sticking(share: float) -> RigHidden:
    """Soil that sticks to one face of the wheel turns sinkage into side force, whatever the slip angle."""

    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        wave = np.sin(7.0 * trials["slip"]) * answer["sinkage"] / (0.1 * case.r)
        answer["side_force"] = answer["side_force"] + share * case.load * wave

    return RigHidden(forces=push)


def _chatter(share: float) -> RigHidden:
    """A drive that stutters at some slips."""

    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        answer["drawbar"] = answer["drawbar"] - share * case.load * np.sin(12.0 * trials["slip"]) ** 2

    return RigHidden(forces=push)


#: What no effect of the library does, from its share of the load.
RIG_STRANGERS: dict[str, Callable[[float], RigHidden]] = {
    "hard_pan": _hard_pan,
    "sticking_soil": _sticking,
    "stuttering_drive": _chatter,
}
