"""Channels against the physics of the vehicle: positions, leaning, noise, turns without steering."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.logs.agreement import MOTIONS, median_of, routes_of, witnesses_of
from estimators.logs.late_steering import STEEPEST
from estimators.logs.log import Log
from estimators.logs.mounting_leaks import antenna_limit, leaks_into_lean, without_leaks
from estimators.logs.raw import SIDES
from estimators.logs.signals import Likeness, Windows, likeness, noise_sd, unwrapped
from offroad_env.physics.numerics import GRAVITY

__all__ = ["Violation", "moved_in", "turns_without_steering", "violations_of"]

_ACCELEROMETERS, _GYROS = ("a_x", "a_y", "a_z"), ("roll_rate", "pitch_rate", "yaw_rate")
#: Noise of an inertial channel over that of its sister, both in stated standard deviations: rough ground
#: gives the vertical axis a few times the noise of the others.
_LOUDER = 10.0
#: Share of a channel's standard deviation that is white, from which it is mostly noise.
_WHITE = 0.5
#: Least white noise that is a fault where no noise is stated: speed [m/s], angle [rad], acceleration that a
#: torque would give [m/s^2], and multiples of a stated noise.
_LOUD_SPEED, _LOUD_ANGLE, _LOUD_PUSH, _LOUD_STATED = 0.5, 0.06, 0.5, 10.0
#: Lean against the change of an acceleration: least correlation, factor and excitation [m/s^2].
_LEAN, _LEAN_FACTOR, _LEAN_PUSH = 0.5, 2.6, 0.5
#: Position against the path by heading and speed: factor, share explained, and the least way [m].
_WAY_FACTOR, _WAY_SHARE, _WAY = 1.8, 0.7, 5.0
#: Velocity along a coordinate from which it is judged [m/s].
_EXCITED = 0.3
#: Windows without a known turn over which a heading is carried.
_BRIDGED = 3
#: Gravity in an accelerometer, in m/s^2 over 9.81.
_GRAVITY_FACTOR = 1.4
#: No vehicle slides this far sideways for this share of its way [-].
_SIDEWAYS, _SIDEWAYS_SHARE = 1.0, 0.1
#: No wheel is steered beyond `STEEPEST` for this share of the samples [-].
_STEEP_SHARE = 0.02
#: Steering that is none, and a turn that is one [rad, rad/s].
_NO_STEER, _TURN = 0.02, 0.1
#: A turn that the body itself shows and nothing confirms, and what shows it [rad/s].
_TURN_ALONE, _OWN_TURN = 0.2, (("yaw_rate",), ("yaw",))
#: Change of a command from one short window to the next must show in the motion [s, -].
_SHORT, _SHORT_SHOWS = 0.2, 0.28


@dataclass(frozen=True, kw_only=True)
class Violation:
    """A channel that contradicts the vehicle's physics."""

    channels: tuple[str, ...]
    kind: str  #: "scale", "sign", "loud", "contradiction"
    severity: str  #: "problem" or "warning"
    sentence: str
    numbers: dict[str, float]


def violations_of(log: Log, untrusted: frozenset[str] = frozenset()) -> tuple[list[Violation], set[str]]:
    """Channels that contradict the vehicle's physics; and the channels that could be judged.

    Parameters
    ----------
    untrusted
        Channels that are known to be wrong: nothing is compared with them.
    """
    windows = Windows(log)
    speed = _witnessed(windows, "speed", None, untrusted)
    turn = None if speed is None else _witnessed(windows, "turn", speed, untrusted)
    found, judged = _positions(windows, speed, turn, untrusted)
    for more, seen in (
        _lean(log, untrusted),
        _vertical(log),
        _sideways(windows, speed),
        _steep(log),
    ):
        found += more
        judged |= seen
    found += _noise(log, windows) + _sisters(log)
    return found, judged


def moved_in(log: Log) -> set[str]:
    """The names of the `MOTIONS` that most routes show to be excited, whether they agree or not."""
    windows = Windows(log)
    speed = _witnessed(windows, "speed", None, frozenset())
    found = set()
    for name, motion in MOTIONS.items():
        sizes = [np.nanstd(route.values) for route in routes_of(windows, name, speed)]
        if len(sizes) > 1 and np.median(sizes) > motion.floor:
            found.add(name)
    return found


def _witnessed(
    windows: Windows, motion: str, speed: np.ndarray | None, untrusted: frozenset[str]
) -> np.ndarray | None:
    """A motion by the routes that confirm each other, or by the only one; without the positions."""
    routes = [r for r in routes_of(windows, motion, speed) if not set(r.channels) & (untrusted | {"x", "y"})]
    if not routes:
        return None
    return median_of(witnesses_of(routes, MOTIONS[motion]) or routes)


def _violation(kind: str, channels: tuple[str, ...], sentence: str, **numbers: float) -> Violation:
    return Violation(channels=channels, kind=kind, severity="problem", sentence=sentence, numbers=numbers)


# ------------------------------------------------------------------ positions


class _Way(NamedTuple):
    """Velocity of one coordinate as a share of speed along a heading."""

    along: float  #: coefficient of v cos(heading)
    across: float  #: of v sin(heading)
    explained: float  #: share of the mean square

    @property
    def factor(self) -> float:
        return math.hypot(self.along, self.across)


def _positions(
    windows: Windows, speed: np.ndarray | None, turn: np.ndarray | None, untrusted: frozenset[str]
) -> tuple[list[Violation], set[str]]:
    velocity = windows.displacement()
    if velocity is None or speed is None or turn is None or not np.isfinite(turn).any():
        return [], set()
    heading, stated = _heading(windows, speed, turn, untrusted)
    known = np.isfinite(heading) & np.isfinite(speed) & np.isfinite(velocity[0]) & np.isfinite(velocity[1])
    known &= stated | _uninterrupted(turn)
    columns = np.column_stack([speed * np.cos(heading), speed * np.sin(heading)])[known]
    if len(columns) < 10 or windows.length * 0.5 * np.abs(speed[known]).sum() < _WAY:
        return [], set()
    moved = {name: v[known] for name, v in zip(("x", "y"), velocity, strict=True)}
    if stated:
        # A heading that is stated leaves nothing to be turned: each coordinate has its own reference.
        tables = {name: columns * (np.arange(2) == i) for i, name in enumerate(moved)}
        seen = {name for i, name in enumerate(moved) if np.sqrt(np.mean(columns[:, i] ** 2)) > _EXCITED}
    else:
        # Straight on, one column is a multiple of the other: a scale looks like a turned heading.
        singular = np.linalg.svd(columns, compute_uv=False)
        if singular[1] < 0.15 * singular[0]:
            return [], set()
        tables, seen = dict.fromkeys(moved, columns), {"x", "y"}
    found = _position_violations({name: _way(tables[name], moved[name]) for name in seen})
    # A heading that is stated is known where no turn is: where the vehicle stands, or a channel has gaps.
    turned = np.isfinite(turn[known])
    if found and turned.any():
        tables = {name: table[turned] for name, table in tables.items()}
        moved = {name: v[turned] for name, v in moved.items()}
        aside = turn[known] * np.stack([-np.sin(heading[known]), np.cos(heading[known])])
        rest = _without_antenna(tables, moved, dict(zip(("x", "y"), aside[:, turned], strict=True)), windows)
        if not _position_violations({name: _way(tables[name], rest[name]) for name in seen}):
            found = []
    return found, seen


def _without_antenna(
    tables: Mapping[str, np.ndarray],
    moved: Mapping[str, np.ndarray],
    aside: Mapping[str, np.ndarray],
    windows: Windows,
) -> dict[str, np.ndarray]:
    """Velocities of both coordinates without what an antenna ahead of the centre of gravity adds.

    Parameters
    ----------
    tables, moved, aside
        By coordinate: what it may be a multiple of (W, 2), its velocity (W,), and that per metre [1/s].
    """
    nothing = {name: np.zeros_like(table) for name, table in tables.items()}
    rows = [
        np.column_stack([*(tables[one] if one == name else nothing[one] for one in moved), aside[name]])
        for name in moved
    ]
    shares = np.linalg.lstsq(np.concatenate(rows), np.concatenate([*moved.values()]), rcond=None)[0]
    ahead = float(np.clip(shares[-1], -antenna_limit(windows), antenna_limit(windows)))
    return {name: values - ahead * aside[name] for name, values in moved.items()}


def _heading(
    windows: Windows, speed: np.ndarray, turn: np.ndarray, untrusted: frozenset[str]
) -> tuple[np.ndarray, bool]:
    """Heading at the middle of each window [rad], and whether a channel states it.

    A course is the opposite of it where the ``speed`` [m/s] is backwards. Without a channel it is the
    integral of the turn, whose start is unknown.
    """
    middle = windows.starts + 0.5 * windows.length
    for name in ("course", "yaw"):
        if name in windows.log.channels and name not in untrusted:
            t, values = windows.log.samples(name)
            if len(t) > 10:
                slope = windows.slope(name, angle=True)
                seen = None if slope is None else likeness(slope, turn)
                if seen is not None and seen.correlation > _WAY_SHARE:
                    stated = np.interp(middle, t, unwrapped(values))
                    return stated + math.pi * ((name == "course") & (speed < 0.0)), True
    step = 0.5 * windows.length
    filled = np.interp(middle, middle[np.isfinite(turn)], turn[np.isfinite(turn)])
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (filled[1:] + filled[:-1]))]), False


def _uninterrupted(turn: np.ndarray) -> np.ndarray:
    """Windows (W,) of the longest stretch in which the turn is known: over a gap its integral drifts."""
    own = np.flatnonzero(np.isfinite(turn))
    parts = np.split(own, np.flatnonzero(np.diff(own) > _BRIDGED + 1) + 1)
    longest = max(parts, key=len)
    inside = np.zeros(len(turn), dtype=bool)
    inside[longest[0] : longest[-1] + 1] = True
    return inside


def _way(columns: np.ndarray, values: np.ndarray) -> _Way:
    solution, *_ = np.linalg.lstsq(columns, values, rcond=None)
    left = values - columns @ solution
    power = float(values @ values)
    explained = 1.0 - float(left @ left) / power if power > 0.0 else 0.0
    return _Way(float(solution[0]), float(solution[1]), explained)


def _position_violations(ways: dict[str, _Way]) -> list[Violation]:
    found = []
    for name, way in ways.items():
        other = ways.get("y" if name == "x" else "x")
        sound = other is None or other.explained > _WAY_SHARE
        text = f"{name} moves {way.factor:.3g} times as far as speed and heading have it"
        if way.explained > _WAY_SHARE and abs(math.log(max(way.factor, 1e-9))) > math.log(_WAY_FACTOR):
            found.append(_violation("scale", (name,), f"{text}: another unit, or scale", factor=way.factor))
        elif way.explained < _WAY_SHARE and sound:
            sentence = (
                f"{name} does not follow speed and heading, which explain "
                f"{100.0 * max(way.explained, 0.0):.0f} % of its motion: stuck, or noise"
            )
            found.append(_violation("contradiction", (name,), sentence, explained=way.explained))
    return found or _mirrored(ways)


def _mirrored(ways: dict[str, _Way]) -> list[Violation]:
    """A path that turns the other way than the vehicle."""
    own = {"x": "along", "y": "across"}
    against = [name for name, way in ways.items() if getattr(way, own[name]) < 0.0]
    clear = all(way.explained > _WAY_SHARE for way in ways.values())
    if len(ways) < 2:
        mirrored = bool(against)
    else:
        x, y = ways["x"], ways["y"]
        mirrored = x.along * y.across - x.across * y.along < 0.0
    if not clear or not mirrored:
        return []
    names = tuple(against) if len(against) == 1 else tuple(ways)
    sentence = (
        f"the path x, y turns the other way than the vehicle: the sign of {' or '.join(names)} is reversed"
    )
    return [_violation("sign", names, sentence)]


# ------------------------------------------------------------------ leaning


def _lean(log: Log, untrusted: frozenset[str]) -> tuple[list[Violation], set[str]]:
    """A body that pitches with the change of speed and rolls in bends, by its springs.

    Quasi-static: pitch = m h a_x / (k_f l_f^2 + k_r l_r^2), nose up; what rolls leans outwards.
    """
    vehicle = log.vehicle
    stiffness = vehicle.k_f * vehicle.l_f**2 + vehicle.k_r * vehicle.l_r**2
    found, judged = list[Violation](), set[str]()
    for gyro, push, lean in (
        ("pitch_rate", "a_x", vehicle.m * vehicle.h_cg / stiffness),
        ("roll_rate", "a_y", 0.0),
    ):
        if gyro not in log.channels or push not in log.channels or {gyro, push} & untrusted:
            continue
        seen = _leaning(Windows(log), gyro, push, lean or 1.0 / GRAVITY)
        if seen is None or abs(seen.correlation) < _LEAN:
            continue
        judged.add(gyro)
        numbers = {"factor": seen.factor, "correlation": seen.correlation}
        if seen.factor < 0.0:
            sentence = (
                f"{gyro} against the change of {push}: the body leans the other way: the sign of {gyro} is "
                "reversed"
            )
            found.append(_violation("sign", (gyro,), sentence, **numbers))
        elif lean and log.imu.kinematic and seen.factor > _LEAN_FACTOR:
            sentence = (
                f"{gyro} is {seen.factor:.3g} times what the springs let {push} cause "
                f"(correlation {seen.correlation:.2f}): another unit, or scale"
            )
            found.append(_violation("scale", (gyro,), sentence, **numbers))
    return found, judged


def _leaning(windows: Windows, gyro: str, push: str, lean: float) -> Likeness | None:
    """A gyro against ``lean`` [rad s^2/m] times the change of an acceleration."""
    rate, acceleration = windows.mean(gyro), windows.mean(push)
    if rate is None or acceleration is None or not np.isfinite(acceleration).any():
        return None
    if not np.nanstd(acceleration) > _LEAN_PUSH:
        return None
    change = np.full(len(acceleration), math.nan)
    change[1:-1] = lean * (acceleration[2:] - acceleration[:-2]) / windows.length
    smooth = Windows.as_course_rate(rate)
    seen = likeness(smooth, change, centred=True)
    if seen is None or 0.0 < seen.factor <= _LEAN_FACTOR:
        return seen
    # A gyro that is turned reads a share of what its sisters should.
    rest = without_leaks(smooth, change, leaks_into_lean(windows, gyro), centred=True)
    return seen if rest is None else likeness(rest, change, centred=True)


def _vertical(log: Log) -> tuple[list[Violation], set[str]]:
    """Gravity in a_z where the IMU feels it."""
    if "a_z" not in log.channels or log.imu.kinematic:
        return [], set()
    mean = float(np.median(log.samples("a_z")[1]))
    numbers = {"mean": mean}
    if abs(mean) < GRAVITY / _GRAVITY_FACTOR or abs(mean) > GRAVITY * _GRAVITY_FACTOR:
        sentence = (
            f"a_z averages {mean:.3g} m/s^2, where a specific force averages 9.81: another unit, or scale"
        )
        return [_violation("scale", ("a_z",), sentence, **numbers)], {"a_z"}
    return [], {"a_z"}


def _sideways(windows: Windows, speed: np.ndarray | None) -> tuple[list[Violation], set[str]]:
    side = windows.mean("v_y")
    if side is None or speed is None:
        return [], set()
    known = np.isfinite(side) & (np.abs(speed) > 1.0)
    if known.sum() < 10:
        return [], set()
    share = float(np.mean(np.abs(side[known]) > _SIDEWAYS * np.abs(speed[known])))
    if share <= _SIDEWAYS_SHARE:
        return [], set()
    sentence = f"v_y exceeds the forward speed in {100.0 * share:.0f} % of the time: another unit, or scale"
    return [_violation("scale", ("v_y",), sentence, share=share)], {"v_y"}


def _steep(log: Log) -> tuple[list[Violation], set[str]]:
    """A steering no wheel can have; a smaller one is left to what turns the vehicle."""
    if "steer" not in log.channels:
        return [], set()
    share = float(np.mean(np.abs(log.samples("steer")[1]) > STEEPEST))
    if share <= _STEEP_SHARE:
        return [], set()
    sentence = (
        f"steer exceeds {STEEPEST:.2g} rad in {100.0 * share:.0f} % of its samples: degrees, another scale, "
        "or the angle of the steering wheel"
    )
    return [_violation("scale", ("steer",), sentence, share=share)], {"steer"}


# ------------------------------------------------------------------ noise


def _noise(log: Log, windows: Windows) -> list[Violation]:
    """Channels that are mostly white noise, far beyond what is stated or what a vehicle can do."""
    found = []
    for name in log.channels:
        allowed = _allowed_noise(log, name)
        if allowed is None:
            continue
        values = log.samples(name)[1]
        noise = noise_sd(unwrapped(values) if name in ("course", "yaw") else values)
        if not noise > allowed or not noise > _WHITE * float(np.std(values)):
            continue
        if name in ("steer", "torque_f", "torque_r", "drive_force") and _shows(log, name):
            continue
        spread = float(np.std(values))
        sentence = f"{name} is mostly white noise ({noise:.3g}, of {spread:.3g} in all), as no vehicle moves"
        found.append(_violation("loud", (name,), sentence, noise=noise))
    return found


def _allowed_noise(log: Log, name: str) -> float | None:
    """Noise from which a channel is suspect; None where `_sisters` judges it."""
    gnss, vehicle = log.config.gnss, log.vehicle
    if name in ("x", "y"):
        return max(_LOUD_STATED * ((gnss.sd_position if gnss else None) or 0.1), 1.0)
    if name in ("speed", "v_x", "v_y"):
        return max(_LOUD_STATED * ((gnss.sd_speed if gnss else None) or 0.0), _LOUD_SPEED)
    if name in ("omega_f", "omega_r"):
        return _LOUD_SPEED / vehicle.r
    if name in ("course", "yaw"):
        return None if _slow(log) else 0.3
    if name == "steer":
        return _LOUD_ANGLE
    if name in ("torque_f", "torque_r"):
        return _LOUD_PUSH * vehicle.m * vehicle.r
    return _LOUD_PUSH * vehicle.m if name == "drive_force" else None


def _slow(log: Log) -> bool:
    """Whether the vehicle is often too slow for the course of a receiver."""
    speed = next((name for name in ("v_x", "speed") if name in log.channels), None)
    return speed is not None and float(np.quantile(np.abs(log.samples(speed)[1]), 0.2)) < 1.0


def _shows(log: Log, name: str) -> bool:
    """Whether the vehicle answers what a command does from one short window to the next.

    A random policy steers at random, too, and the vehicle turns as it does.
    """
    windows = Windows(log, _SHORT)
    answer = windows.mean("yaw_rate" if name == "steer" else "a_x")
    command = windows.mean(name)
    if answer is None or command is None:
        return True
    best = 0.0
    for late in range(4):
        seen = likeness(np.diff(command)[: len(command) - 1 - late], np.diff(answer)[late:], centred=True)
        best = max(best, 0.0 if seen is None else seen.correlation)
    return best > _SHORT_SHOWS


def _sisters(log: Log) -> list[Violation]:
    """Inertial channels of one sensor have noise of one order."""
    found = []
    for axes, stated in ((_ACCELEROMETERS, log.imu.sd_a), (_GYROS, log.imu.sd_rate)):
        ratios = {name: noise_sd(log.samples(name)[1]) / stated for name in axes if name in log.channels}
        ratios = {name: ratio for name, ratio in ratios.items() if ratio > 0.0}
        for name, ratio in ratios.items():
            usual = max(min((r for other, r in ratios.items() if other != name), default=3.0), 1.0)
            if ratio < 3.0 * usual:
                continue
            text = f"{name} has {ratio:.3g} times its stated noise, its sisters {usual:.2g} times"
            severe = ratio > _LOUDER * usual
            found.append(
                Violation(
                    channels=(name,),
                    kind="loud",
                    severity="problem" if severe else "warning",
                    sentence=f"{text}: noise, or another unit"
                    if severe
                    else f"{text}: rough ground, noise or scale",
                    numbers={"noise": ratio, "usual": usual},
                )
            )
    return found


# ------------------------------------------------------------------ the class of the model


def turns_without_steering(log: Log) -> str | None:
    """Why no model that turns by its steering can be right; None where it steers, or goes straight.

    It does not steer where the steering stays at zero, or is computed from the speeds of both sides.
    """
    windows = Windows(log)
    steer = windows.mean("steer")
    if steer is None or not np.isfinite(steer).any():
        return None
    steered = float(np.nanmax(np.abs(steer)))
    if SIDES in log.config.notes:
        text = "no wheel is steered: its steering is computed from the speeds of left and right wheels"
    elif steered < _NO_STEER:
        text = (
            f"steer stays within {steered:.2g} rad: it turns without steering: skid steer, or a steer column "
            "that was not recorded?"
        )
    else:
        return None
    speed = _witnessed(windows, "speed", None, frozenset())
    routes = [route for route in routes_of(windows, "turn", speed) if "steer" not in route.channels]
    # A vehicle that slides in its turns may follow no course and no lateral acceleration of a rolling one.
    own = [route for route in routes if route.channels in _OWN_TURN]
    confirmed = witnesses_of(routes, MOTIONS["turn"])
    for seen, least, how in ((confirmed, _TURN, "agree"), (own, _TURN_ALONE, "alone")):
        turn = median_of(seen) if seen else np.zeros(1)
        fastest = float(np.nanmax(np.abs(turn)))
        if fastest > least or (seen is confirmed and np.nanstd(turn) > MOTIONS["turn"].still):
            names = ", ".join(dict.fromkeys(name for route in seen for name in route.channels))
            return f"the vehicle turns at up to {fastest:.2g} rad/s ({names} {how}) while {text}"
    return None
