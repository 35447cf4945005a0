"""Trials of a wheel rig with faults, for tests of the diagnosis.

A second wheel on soil, written from the literature independently of the compiled one: all trials at once, by
the midpoint rule, with bisection for the sinkage. The faults are written independently of the effects, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from estimators.logs.config import LogConfig
from estimators.logs.log import Log
from estimators.logs.writing import content_hash
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.vehicles import make_wheel

__all__ = ["RIG_FAULTS", "UNMODELLED_RIG_FAULTS", "RigCase", "RigFault", "draw_rig_case", "simulated_trials"]

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
    """Trials of a rig without their fault."""

    seed: int
    soil: str
    n: float  #: true sinkage exponent; the log states the catalogue's [-]
    r: float  #: [m]
    b: float  #: [m]
    load: float  #: mean wheel load [N]
    angles: tuple[float, ...]  #: slip angles [rad]


@dataclass(frozen=True, kw_only=True)
class RigFault:
    """A fault by the parts of the trials that it changes; every part may be left out.

    ``soil`` changes the soil parameters of all trials, from (parameters, trials); ``forces`` adds to the
    response of the soil, from (response, trials, case); ``gauges`` adds to the measured values.
    """

    soil: Callable[[Arrays, Arrays], None] = field(default=lambda soil, trials: None)
    pressure: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None  #: (pressure, depth) -> pressure
    forces: Callable[[Arrays, Arrays, RigCase], None] = field(default=lambda answer, trials, case: None)
    gauges: Callable[[Arrays, RigCase], None] = field(default=lambda answer, case: None)
    load: float = 1.0  #: true load over the logged one


def draw_rig_case(seed: int) -> RigCase:
    """Trials drawn from their seed."""
    rng = np.random.default_rng([seed, 11])
    soil = str(rng.choice(_SOILS))
    r = float(rng.uniform(0.1, 0.35))
    b = r * float(rng.uniform(0.5, 0.8))
    # A load that sinks the rolling wheel by about a tenth of its radius.
    record = SOILS[soil]
    pressure = (record.k_c / b + record.k_phi) * (0.1 * r) ** record.n
    return RigCase(
        seed=seed,
        soil=soil,
        n=float(record.n + rng.uniform(-0.08, 0.08)),
        r=r,
        b=b,
        load=float(0.3 * pressure * r * b * rng.uniform(0.7, 1.3)),
        angles=(0.0, 0.15, 0.35, 0.6),
    )


def simulated_trials(case: RigCase, fault: RigFault | None = None) -> Log:
    """The log of a case with a fault, as a diagnosis gets it."""
    fault = RigFault() if fault is None else fault
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
    fault.soil(soil, trials)
    answer = _equilibrium(soil, trials, case, fault)
    fault.forces(answer, trials, case)
    for name, scale in (
        ("drawbar", _FORCE_NOISE * case.load),
        ("side_force", _FORCE_NOISE * case.load),
        ("torque", _FORCE_NOISE * case.load * case.r),
        ("sinkage", _DEPTH_NOISE * case.r),
    ):
        answer[name] = answer[name] + scale * rng.standard_normal(count)
    fault.gauges(answer, case)
    config = LogConfig(soil=SOILS[case.soil], wheel=make_wheel(r=case.r, b=case.b))
    channels = {**trials, **answer, "condition": condition.astype(float)}
    log = Log(name="trials", t=None, channels=channels, references={}, config=config, hash="")
    return replace(log, hash=content_hash(log))


# ------------------------------------------------------------------ the second wheel


def _equilibrium(soil: Arrays, trials: Arrays, case: RigCase, fault: RigFault) -> Arrays:
    """Sinkage by bisection of the vertical balance, then the forces (Wong & Reece 1967)."""
    load = fault.load * trials["load"]
    low, high = np.zeros(len(load)), np.full(len(load), 0.95 * case.r)
    for _ in range(_HALVINGS):
        h = 0.5 * (low + high)
        light = _forces_at(soil, trials, case, h, fault).F_z < load
        low, high = np.where(light, h, low), np.where(light, high, h)
    h = 0.5 * (low + high)
    forces = _forces_at(soil, trials, case, h, fault)
    return {"sinkage": h, "drawbar": forces.F_x, "side_force": forces.F_y, "torque": forces.torque}


class _Forces(NamedTuple):
    """Resultants of all trials, (M,) each."""

    F_x: np.ndarray  #: forward [N]
    F_y: np.ndarray  #: left [N]
    F_z: np.ndarray  #: up [N]
    torque: np.ndarray  #: [N m]


def _forces_at(soil: Arrays, trials: Arrays, case: RigCase, h: np.ndarray, fault: RigFault) -> _Forces:
    """Resultants at the sinkage ``h`` (M,): integrals over the patch, front and rear apart."""
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
        # The pressure at the rear equals that at the front at the same share of the way to the peak.
        alike = theta if ahead else theta_f - (theta - theta_r) / (theta_m - theta_r) * (theta_f - theta_m)
        depth = np.maximum(case.r * (np.cos(alike) - np.cos(theta_f)), 0.0)
        sigma = (soil["k_c"] / case.b + soil["k_phi"]) * depth ** soil["n"]
        if fault.pressure is not None:
            sigma = fault.pressure(sigma, depth / case.r)
        j_x = case.r * (theta_f - theta - along * (np.sin(theta_f) - np.sin(theta))) / soil["k_x"]
        j_y = case.r * across * (theta_f - theta) / soil["k_y"]
        j = np.hypot(j_x, j_y) + 1e-12
        tau = (soil["c"] + sigma * np.tan(soil["phi"])) * -np.expm1(-j)
        t_x, t_y, weight = tau * j_x / j, tau * j_y / j, (stop - start) / _POINTS
        cos, sin = np.cos(theta), np.sin(theta)
        for i, part in enumerate((t_x * cos - sigma * sin, -t_y, t_x * sin + sigma * cos, t_x)):
            totals[i] += weight * part.sum(axis=0)
    return _Forces(*(case.r * case.b * totals * np.array([1.0, 1.0, 1.0, case.r])[:, None]))


# ------------------------------------------------------------------ faults


def _total_slip(trials: Arrays) -> np.ndarray:
    """Slip along and across the wheel together."""
    s, beta = trials["slip"], trials["slip_angle"]
    rim, along = np.where(s >= 0.0, 1.0, 1.0 + s), np.where(s >= 0.0, 1.0 - s, 1.0)
    travel = along / np.cos(beta)
    return np.minimum(np.hypot(s, along * np.tan(beta) / np.maximum(rim, travel)), 1.0)


def _scaled_parameters(name: str, factor: Callable[[Arrays], np.ndarray | float]) -> RigFault:
    def change(soil: Arrays, trials: Arrays) -> None:
        for each in name.split():
            soil[each] = soil[each] * factor(trials)

    return RigFault(soil=change)


def _shifted_parameter(name: str, amount: float) -> RigFault:
    def change(soil: Arrays, trials: Arrays) -> None:
        soil[name] = np.maximum(soil[name] + amount, 0.0) if name == "c" else soil[name] + amount

    return RigFault(soil=change)


def _slip_sinkage(power: float) -> RigFault:
    """Lyasko 2010, with n as each trial has it."""

    def change(soil: Arrays, trials: Arrays) -> None:
        s = _total_slip(trials)
        factor = ((1.0 + s) / (1.0 - 0.5 * s)) ** (-power * soil["n"])
        soil["k_c"], soil["k_phi"] = soil["k_c"] * factor, soil["k_phi"] * factor

    return RigFault(soil=change)


def _slip_dependent_n(slope: float) -> RigFault:
    def change(soil: Arrays, trials: Arrays) -> None:
        soil["n"] = soil["n"] + slope * np.abs(trials["slip"])

    return RigFault(soil=change)


def _bulldozing(stress: float) -> RigFault:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        face = 2.0 * case.r * answer["sinkage"]
        answer["side_force"] = answer["side_force"] - stress * face * np.sin(trials["slip_angle"])

    return RigFault(forces=push)


def _front_bulldozing(gradient: float) -> RigFault:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        s = trials["slip"]
        share = np.where(s >= 0.0, (1.0 - s) / np.hypot(1.0, 1.0 - s), 1.0 / np.hypot(1.0, 1.0 + s))
        force = 0.5 * gradient * case.b * answer["sinkage"] ** 2
        answer["drawbar"] = answer["drawbar"] - force * share

    return RigFault(forces=push)


def _grouser_thrust(share: float) -> RigFault:
    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        thrust = share * trials["load"] * np.tanh(10.0 * trials["slip"])
        answer["drawbar"] = answer["drawbar"] + thrust
        answer["torque"] = answer["torque"] + case.r * thrust

    return RigFault(forces=push)


def _offset_gauge(name: str, amount: float) -> RigFault:
    def shift(answer: Arrays, case: RigCase) -> None:
        answer[name] = answer[name] + amount

    return RigFault(gauges=shift)


#: Effect of the library -> the fault that does the same, from its size.
RIG_FAULTS: dict[str, Callable[[float], RigFault]] = {
    "slip_sinkage": _slip_sinkage,
    "soil_loosening": lambda rate: _scaled_parameters(
        "k_c k_phi", lambda trials: np.exp(-rate * _total_slip(trials))
    ),
    "slip_exponent": _slip_dependent_n,
    "bulldozing": _bulldozing,
    "front_bulldozing": _front_bulldozing,
    "grouser_thrust": _grouser_thrust,
    "friction_angle": lambda angle: _shifted_parameter("phi", angle),
    "cohesion": lambda stress: _shifted_parameter("c", stress),
    "exit_angle": lambda share: _shifted_parameter("b_0", share),
    "peak_angle": lambda share: _shifted_parameter("a_0", share),
    "shear_modulus": lambda share: _scaled_parameters("k_x k_y", lambda trials: 1.0 + share),
    "drawbar_offset": lambda force: _offset_gauge("drawbar", force),
    "side_force_offset": lambda force: _offset_gauge("side_force", force),
    "sinkage_offset": lambda depth: _offset_gauge("sinkage", depth),
    "load_scale": lambda share: RigFault(load=1.0 + share),
}


def _hard_pan(share: float) -> RigFault:
    """Firm ground below a tenth of the radius."""
    return RigFault(pressure=lambda sigma, depth: sigma * (1.0 + 10.0 * share * np.maximum(depth - 0.1, 0.0)))


def _sticking_soil(share: float) -> RigFault:
    """Soil that sticks to one face of the wheel: sinkage causes side force at any slip angle."""

    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        wave = np.sin(7.0 * trials["slip"]) * answer["sinkage"] / (0.1 * case.r)
        answer["side_force"] = answer["side_force"] + share * case.load * wave

    return RigFault(forces=push)


def _stuttering_drive(share: float) -> RigFault:
    """A drive whose pull drops at some slips."""

    def push(answer: Arrays, trials: Arrays, case: RigCase) -> None:
        answer["drawbar"] = answer["drawbar"] - share * case.load * np.sin(12.0 * trials["slip"]) ** 2

    return RigFault(forces=push)


#: Faults that no effect of the library describes, by their size as a share of the load.
UNMODELLED_RIG_FAULTS: dict[str, Callable[[float], RigFault]] = {
    "hard_pan": _hard_pan,
    "sticking_soil": _sticking_soil,
    "stuttering_drive": _stuttering_drive,
}
