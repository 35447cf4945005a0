"""Wrong units, axes and signs, found where two channels disagree about the same motion.

A yaw rate integrates to the change of heading, an accelerometer at rest measures 9.81 m/s^2, and in
a bend the lateral acceleration is speed times yaw rate. Where the factor between the two sides is that
of another unit, the channel is probably in that unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.logs.immobile import has_rolled, only_spins
from estimators.logs.log import Log
from estimators.logs.signals import Likeness, Windows, likeness, noise_sd
from offroad_env.physics.numerics import GRAVITY

__all__ = ["Check", "Finding", "suspicions"]

_DEGREES = math.degrees(1.0)
#: Units of an acceleration by the factor that they give.
_ACCELERATIONS = {"g": 1.0 / GRAVITY, "mg": 1000.0 / GRAVITY}
#: Noise within this factor of what is stated is the stated noise.
_ALIKE = 2.5
_CLEAR = 0.8  # correlation from which two signals count as the same motion


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something in a log that a reader should know."""

    kind: str  #: unit, axes, sign, frame, gap, time jump, stuck, saturation, clock, noise, excitation
    channel: str
    severity: str  #: "problem" (the data are wrong), "warning", "note"
    sentence: str
    suspected_unit: str | None = None
    numbers: dict[str, float] = field(default_factory=dict)


class Check(NamedTuple):
    """A comparison of the two sides of a law."""

    name: str
    factor: float  #: measured over expected
    correlation: float
    windows: int
    verdict: str  #: "agrees", "undecided", or what is suspected


class _Candidate(NamedTuple):
    """If the factor is this, that channel is in that unit."""

    factor: float
    channel: str
    unit: str


class _Law(NamedTuple):
    name: str  #: "yaw_rate against the change of yaw"
    channel: str  #: the channel whose sign the law decides
    seen: Likeness | None
    candidates: tuple[_Candidate, ...]
    tolerance: float = math.log(2.0)  #: of the logarithm of the factor


def suspicions(log: Log) -> tuple[list[Finding], list[Check]]:
    """All laws on a vehicle log: what is suspected, and how each comparison came out."""
    windows = Windows(log)
    judge = _Judge()
    speed = _speed(windows)
    yaw_unit = _heading_laws(windows, speed, judge)
    _attitude_laws(windows, judge)
    _gyro_range(log, judge, yaw_unit)
    _speed_laws(windows, judge)
    gravity_unit = _gravity(log, judge)
    turn = windows.mean("yaw_rate")
    if speed is not None and turn is not None:
        turn = turn / (_DEGREES if yaw_unit == "deg/s" else 1.0)
        _acceleration_laws(windows, (speed * turn, _speed_change(windows)), judge, gravity_unit)
    _course_law(windows, judge)
    return judge.findings, judge.checks


class _Judge:
    """Collects verdicts, one finding a channel and kind."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self.checks: list[Check] = []

    def add(self, finding: Finding) -> None:
        """Keep a finding unless the channel has one of this kind already."""
        if not any((f.kind, f.channel) == (finding.kind, finding.channel) for f in self.findings):
            self.findings.append(finding)

    def suspects(self, channel: str) -> bool:
        """Whether a unit of this channel is suspected already."""
        return any(f.kind == "unit" and f.channel == channel for f in self.findings)

    def weigh(self, law: _Law) -> _Candidate | None:
        """Judge a law; returns the candidate that it names."""
        if law.seen is None:
            return None
        seen, found, verdict = law.seen, None, "undecided"
        if abs(seen.correlation) >= _CLEAR:
            named = _nearest((_Candidate(1.0, "", ""), *law.candidates), abs(seen.factor), law.tolerance)
            if named is not None:
                found = named if named.channel else None
                verdict = f"{named.channel} in {named.unit}" if found else "agrees"
            if seen.factor < 0.0 and named is not None:
                verdict += ", sign reversed"
                self.add(_reversed(law, seen))
        self.checks.append(Check(law.name, seen.factor, seen.correlation, seen.windows, verdict))
        if found is not None:
            self.add(_unit_finding(law, seen, found))
        return found


def _nearest(candidates: tuple[_Candidate, ...], factor: float, tolerance: float) -> _Candidate | None:
    distance = [abs(math.log(factor / candidate.factor)) for candidate in candidates]
    best = int(np.argmin(distance))
    return candidates[best] if distance[best] <= tolerance else None


def _numbers(seen: Likeness) -> dict[str, float]:
    return {"factor": seen.factor, "correlation": seen.correlation, "windows": float(seen.windows)}


def _reversed(law: _Law, seen: Likeness) -> Finding:
    sentence = f"{law.name}: factor {seen.factor:.3g}: the sign of {law.channel} is reversed"
    return Finding(
        kind="sign",
        channel=law.channel,
        severity="problem",
        sentence=sentence,
        numbers=_numbers(seen),
    )


def _unit_finding(law: _Law, seen: Likeness, candidate: _Candidate) -> Finding:
    sentence = (
        f"{law.name}: factor {seen.factor:.3g} where 1 is expected and {candidate.factor:.3g} would mean "
        f"{candidate.unit} (correlation {seen.correlation:.2f}, {seen.windows} windows): "
        f"{candidate.channel} is in {candidate.unit}"
    )
    return Finding(
        kind="unit",
        channel=candidate.channel,
        severity="problem",
        sentence=sentence,
        suspected_unit=candidate.unit,
        numbers=_numbers(seen) | {"expected_for_unit": candidate.factor},
    )


def _compare(
    first: np.ndarray | None, second: np.ndarray | None, *, centred: bool = False
) -> Likeness | None:
    return None if first is None or second is None else likeness(first, second, centred=centred)


# ------------------------------------------------------------------ laws


def _speed(windows: Windows) -> np.ndarray | None:
    """Forward speed by the first channel that has it, a wheel's at its nominal radius [m/s]."""
    for name, factor in (("v_x", 1.0), ("speed", 1.0), ("omega_r", 0.0), ("omega_f", 0.0)):
        mean = windows.mean(name)
        if mean is not None:
            return mean * (factor or windows.log.vehicle.r)
    return windows.travel()


def _speed_change(windows: Windows) -> np.ndarray | None:
    """dv/dt by the same channels [m/s^2]."""
    for name, factor in (("v_x", 1.0), ("speed", 1.0), ("omega_r", 0.0), ("omega_f", 0.0)):
        slope = windows.slope(name)
        if slope is not None:
            return slope * (factor or windows.log.vehicle.r)
    return None


def _heading_laws(windows: Windows, speed: np.ndarray | None, judge: _Judge) -> str | None:
    """Yaw rate against heading, course and steering; returns its suspected unit."""
    rate, steer = windows.mean("yaw_rate"), windows.mean("steer")
    fast = _Candidate(_DEGREES, "yaw_rate", "deg/s")
    laws = [
        _Law(
            "yaw_rate against the change of yaw",
            "yaw_rate",
            _compare(rate, windows.slope("yaw", angle=True)),
            (fast, _Candidate(1.0 / _DEGREES, "yaw", "deg")),
        ),
        _Law(
            "yaw_rate against the turn of the path x, y",
            "yaw_rate",
            _compare(None if rate is None else windows.as_course_rate(rate), windows.course_rate()),
            (fast,),
        ),
    ]
    if speed is not None and steer is not None:
        vehicle = windows.log.vehicle
        steered = speed * steer / (vehicle.l_f + vehicle.l_r)
        small = (fast, _Candidate(1.0 / _DEGREES, "steer", "deg"))
        laws.append(
            _Law("yaw_rate against speed x steer / wheelbase", "steer", _compare(rate, steered), small)
        )
    named = [judge.weigh(law) for law in laws]
    return next((c.unit for c in named if c is not None and c.channel == "yaw_rate"), None)


def _course_law(windows: Windows, judge: _Judge) -> None:
    """Yaw rate against the course over ground."""
    seen = _compare(windows.mean("yaw_rate"), windows.slope("course", angle=True))
    degrees = _Candidate(1.0 / _DEGREES, "course", "deg")
    judge.weigh(_Law("yaw_rate against the change of course", "course", seen, (degrees,)))


def _attitude_laws(windows: Windows, judge: _Judge) -> None:
    for angle in ("pitch", "roll"):
        rate = f"{angle}_rate"
        seen = _compare(windows.mean(rate), windows.slope(angle))
        candidates = (_Candidate(_DEGREES, rate, "deg/s"), _Candidate(1.0 / _DEGREES, angle, "deg"))
        judge.weigh(_Law(f"{rate} against the change of {angle}", rate, seen, candidates))


def _gyro_range(log: Log, judge: _Judge, yaw_unit: str | None) -> None:
    """A vehicle that stays on its wheels does not pitch or roll through half a turn."""
    for name in ("roll_rate", "pitch_rate"):
        if name not in log.channels or judge.suspects(name):
            continue
        swing = _largest_swing(*log.samples(name))
        verdict = "agrees" if swing <= math.pi else "impossible"
        judge.checks.append(Check(f"angle that {name} adds up to in 20 s [rad]", swing, math.nan, 0, verdict))
        if swing > math.pi:
            judge.add(
                Finding(
                    kind="unit",
                    channel=name,
                    severity="problem",
                    sentence=(
                        f"{name} adds up to a swing of {swing:.1f} rad within 20 s, and no vehicle on its "
                        f"wheels turns over: {name} is in {yaw_unit or 'deg/s'}"
                    ),
                    suspected_unit=yaw_unit or "deg/s",
                    numbers={"swing": swing},
                )
            )


def _largest_swing(t: np.ndarray, rate: np.ndarray, length: float = 20.0) -> float:
    """Largest range of the integrated rate, less its mean, in pieces of ``length`` [s]."""
    swing = 0.0
    for begin in np.arange(t[0], max(t[-1] - 0.5 * length, t[0] + 1e-9), length):
        inside = (t >= begin) & (t < begin + length)
        if inside.sum() < 10:
            continue
        own, values = t[inside], rate[inside] - np.median(rate[inside])
        step = np.minimum(np.diff(own), 0.2)  # nothing is known within a gap
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * step)])
        angle -= np.linspace(0.0, angle[-1], len(angle))  # what a bias adds
        swing = max(swing, float(np.ptp(angle)))
    return swing


def _speed_laws(windows: Windows, judge: _Judge) -> None:
    """Speeds against the path, wheels against speeds."""
    velocity = windows.displacement()
    path_speed = None if velocity is None else np.hypot(*velocity)
    for name in ("v_x", "speed"):
        mean = windows.mean(name)
        candidates: list[_Candidate] = [
            _Candidate(3.6, name, "km/h"),
            _Candidate(2.237, name, "mph"),
            _Candidate(1000.0, name, "mm/s"),
            _Candidate(1e-3, "x", "mm"),
            _Candidate(1e-2, "x", "cm"),
        ]
        seen = None if mean is None else _compare(np.abs(mean), path_speed)
        judge.weigh(_Law(f"{name} against the path x, y", name, seen, tuple(candidates), math.log(1.25)))
    forward = next((m for m in map(windows.mean, ("v_x", "speed")) if m is not None), path_speed)
    r = windows.log.vehicle.r
    for name in ("omega_f", "omega_r"):
        mean = windows.mean(name)
        if mean is None or judge.suspects("v_x") or judge.suspects("speed") or judge.suspects("x"):
            continue
        if forward is not None and only_spins(mean * r, forward):
            continue
        # Slip moves this factor as well, so only close to a unit's own number is it suspected.
        candidates = [_Candidate(_DEGREES, name, "deg/s"), _Candidate(30.0 / math.pi, name, "rpm")]
        if abs(math.log(r)) > math.log(1.6):
            candidates.append(_Candidate(r, name, "m/s (a rim speed)"))
        units = () if has_rolled(windows.log, name) else tuple(candidates)
        seen = _compare(np.abs(mean) * r, None if forward is None else np.abs(forward))
        judge.weigh(_Law(f"{name} x r against the speed", name, seen, units, math.log(1.25)))


def _gravity(log: Log, judge: _Judge) -> str | None:
    """Mean of a_z against what an accelerometer must feel; returns the unit that it points to."""
    if "a_z" not in log.channels:
        return None
    _, values = log.samples("a_z")
    mean = float(np.median(values))
    kinematic = log.imu.kinematic
    expected = 0.0 if kinematic else GRAVITY
    units = {"g": 1.0, "mg": 1000.0, "cm/s^2": 100.0 * GRAVITY, "ft/s^2": GRAVITY / 0.3048}
    unit = next((name for name, one in units.items() if abs(mean - one) < 0.15 * one), None)
    if kinematic and unit is not None:
        # A bias of the size of a unit of gravity is no unit: its noise is still that of the sensor.
        noise, scale = noise_sd(values), units[unit] / GRAVITY
        unit = unit if abs(math.log(max(noise, 1e-12) / (log.imu.sd_a * scale))) < math.log(_ALIKE) else None
    rest = "imu.kinematic is true, so it must average 0" if kinematic else "a specific force averages 9.81"
    verdict, kind = "agrees", None
    if unit is not None and not (kinematic and log.duration < 5.0):
        verdict, kind = f"a_z in {unit}", "unit"
        sentence = f"a_z averages {mean:.3g}, where {rest}: a_z is in {unit}"
        sentence += " and holds gravity: kinematic is false" if kinematic else ""
    elif kinematic and abs(mean - GRAVITY) < 0.15 * GRAVITY:
        verdict, kind = "specific force", "frame"
        sentence = f"a_z averages {mean:.3g} m/s^2, where {rest}: a_z holds gravity, kinematic is false"
    elif not kinematic and abs(mean) < 0.3 * GRAVITY:
        verdict, kind = "kinematic", "frame"
        sentence = f"a_z averages {mean:.3g} m/s^2, where {rest}: gravity is taken out, kinematic is true"
    elif not kinematic and abs(mean + GRAVITY) < 0.15 * GRAVITY:
        verdict, kind = "reversed", "sign"
        sentence = f"a_z averages {mean:.3g} m/s^2, where {rest}: the z axis points down"
    judge.checks.append(
        Check("mean of a_z less expected [m/s^2]", mean - expected, math.nan, len(values), verdict)
    )
    if kind is None:
        return None
    named = unit if kind == "unit" else None
    judge.add(
        Finding(
            kind=kind,
            channel="a_z",
            severity="problem",
            sentence=sentence,
            suspected_unit=named,
            numbers={"mean": mean},
        )
    )
    return named


def _acceleration_laws(
    windows: Windows,
    motion: tuple[np.ndarray | None, np.ndarray | None],
    judge: _Judge,
    gravity_unit: str | None,
) -> None:
    """a_y against speed x yaw rate, a_x against dv/dt, and whether the two are exchanged."""
    lateral, longitudinal = motion
    a_x, a_y = windows.mean("a_x"), windows.mean("a_y")
    own, other = _compare(a_y, lateral, centred=True), _compare(a_x, lateral, centred=True)
    turned = (
        own is not None
        and other is not None
        and abs(other.correlation) >= _CLEAR > 1.6 * abs(own.correlation)
    )
    names = {"lateral": "a_x" if turned else "a_y", "longitudinal": "a_y" if turned else "a_x"}
    if own is not None and other is not None and turned:
        judge.add(_turned(own, other))
    for side, signal, title in (
        ("lateral", lateral, "speed x yaw_rate"),
        ("longitudinal", longitudinal, "the change of speed"),
    ):
        name = names[side]
        seen = _compare(a_x if name == "a_x" else a_y, signal, centred=True)
        if turned and seen is not None:
            seen = seen._replace(factor=abs(seen.factor), correlation=abs(seen.correlation))
        units = [_Candidate(factor, name, unit) for unit, factor in _ACCELERATIONS.items()]
        judge.weigh(_Law(f"{name} against {title}", name, seen, tuple(units)))
    for name in ("a_x", "a_y"):
        if gravity_unit is not None and name in windows.log.channels and not judge.suspects(name):
            judge.add(
                Finding(
                    kind="unit",
                    channel=name,
                    severity="problem",
                    sentence=f"{name} comes from the accelerometer whose a_z is in {gravity_unit}",
                    suspected_unit=gravity_unit,
                )
            )


def _turned(own: Likeness, other: Likeness) -> Finding:
    side = "left" if other.factor > 0.0 else "right"
    return Finding(
        kind="axes",
        channel="a_x",
        severity="problem",
        sentence=(
            f"a_x follows speed x yaw_rate (correlation {other.correlation:.2f}) and a_y does not "
            f"({own.correlation:.2f}): the IMU is turned by 90 degrees, its x axis points {side}"
        ),
        numbers={"a_x": other.correlation, "a_y": own.correlation},
    )
