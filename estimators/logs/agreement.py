"""Every channel against all others that physics ties to it: a vote over motions that several channels show.

A speed shows in wheels, receiver and path; a rate of turn in gyro, heading, course, steering and lateral
acceleration; a change of speed in accelerometer, wheels, receiver and torques. Each channel that shows a
motion is a route to it. A route that most others contradict, where those confirm each other, is wrong. The
bounds are far wider than slip, understeer or any effect of the library: an error of a model is none of data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from estimators.logs.axle_speeds import always_off, one_spins, spins_less
from estimators.logs.immobile import only_spins
from estimators.logs.late_steering import steered_turn, steers_late
from estimators.logs.log import Log
from estimators.logs.mounting_leaks import Leak, leaks_into_push, leaks_into_turn, without_leaks
from estimators.logs.signals import Windows, likeness, longest_run

__all__ = [
    "MOTIONS",
    "Motion",
    "Route",
    "Suspect",
    "median_of",
    "routes_of",
    "suspects_of",
    "witnesses_of",
]

_WHEELS = ("omega_f", "omega_r")
_TORQUES = ("torque_f", "torque_r", "drive_force")
#: On soft soil the thrust may vary by as many times what the speed does, since resistance grows with it.
_RESISTED = 40.0
#: Speeds below which a course, or a rate of turn from an acceleration, means nothing [m/s].
_SLOW = 1.0
#: Slip angle of front wheels on soft soil over the lateral acceleration [rad s^2/m]; slip up to which a wheel
#: rolls; angle from which a vehicle is steered [rad]; share of the windows that counts as most.
_SLIDE, _ROLLS, _STEERED, _MOSTLY = 0.12, 0.25, 0.02, 0.75
#: Where its front wheels spin, a vehicle may turn so many times less, or more, than it is steered.
_TURNED = 6.0
#: Share of a torque below which an axle is not driven, or not braked.
_SHARE = 0.1
#: From the first two correlations routes confirm each other; below the last a route does not follow.
_CONFIRMS, _FOLLOWS, _UNRELATED = 0.7, 0.5, 0.35
#: Windows in which two routes must have values.
_ENOUGH = 10
#: A run of equal samples this long is looked at by itself, in seconds and in samples.
_HELD, _HELD_SAMPLES = 2.5, 5
#: What moves in it must move by this share of what moves elsewhere.
_AS_LIVELY = 0.4


class Motion(NamedTuple):
    """A motion that several channels show."""

    name: str
    unit: str
    centred: bool  #: whether only what varies counts: accelerometers have a bias
    floor: float  #: root mean square from which it is excited
    still: float  #: standard deviation from which a constant channel cannot be right
    spread: float  #: factor between two routes that no vehicle exceeds


#: By name. Wheels slip, tyres are steered more than they turn, and resistance varies with speed.
MOTIONS: Mapping[str, Motion] = MappingProxyType(
    {
        "speed": Motion("speed", "m/s", False, 0.5, 0.3, 1.9),
        "turn": Motion("rate of turn", "rad/s", False, 0.03, 0.04, 2.4),
        "push": Motion("change of speed", "m/s^2", True, 0.2, 0.4, 2.4),
    }
)


class Route(NamedTuple):
    """One way to a motion, by window."""

    channels: tuple[str, ...]  #: what is judged: two for a path
    values: np.ndarray  #: (W,) NaN where it shows nothing


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """A channel that contradicts others which agree."""

    channels: tuple[str, ...]
    motion: Motion
    kind: str  #: "scale", "sign", "stuck", "contradiction"
    factor: float  #: the channel over the others, with sign
    correlation: float
    witnesses: tuple[str, ...]  #: channels that confirm each other
    span: tuple[float, float] | None = None  #: where a channel is stuck [s]


def suspects_of(log: Log, untrusted: frozenset[str] = frozenset()) -> tuple[list[Suspect], set[str]]:
    """Channels that others contradict; and all channels that could be judged.

    Parameters
    ----------
    untrusted
        Channels that are no witnesses, because they are known to be wrong.
    """
    windows = Windows(log)
    found: list[Suspect] = []
    judged: set[str] = set()
    speeds = routes_of(windows, "speed", None)
    agreed = _agreed(windows, speeds, untrusted)
    for name in MOTIONS:
        routes = speeds if name == "speed" else routes_of(windows, name, agreed)
        for route in routes:
            others = [one for one in routes if not set(one.channels) & set(route.channels)]
            others = [one for one in others if not set(one.channels) & untrusted]
            suspect, decided = _judged(log, windows, route, others, MOTIONS[name])
            if decided and not (name == "push" and _of(route, _WHEELS)):
                judged |= set(route.channels)
            if suspect is None or _mounted(windows, suspect, route, others, agreed):
                continue
            late = suspect.channels == ("steer",) and steers_late(
                windows, agreed, suspect.kind, suspect.motion.spread
            )
            if not late and not _slides(windows, suspect, route, others, agreed):
                found.append(suspect)
    return found, judged


# ------------------------------------------------------------------ routes


def routes_of(windows: Windows, motion: str, speed: np.ndarray | None) -> list[Route]:
    """All routes to a motion of `MOTIONS`.

    Parameters
    ----------
    speed : (W,), optional
        By which a steering and a lateral acceleration become a rate of turn [m/s].
    """
    if motion == "speed":
        return _speed_routes(windows)
    return _push_routes(windows) if motion == "push" else _turn_routes(windows, speed)


def _present(pairs: Sequence[tuple[tuple[str, ...], np.ndarray | None]]) -> list[Route]:
    found = [Route(channels, values) for channels, values in pairs if values is not None]
    return [route for route in found if np.isfinite(route.values).sum() >= _ENOUGH]


def _speed_routes(windows: Windows) -> list[Route]:
    r = windows.log.vehicle.r
    wheels = [((name,), _scaled(windows.mean(name), r)) for name in _WHEELS]
    body = [((name,), windows.mean(name)) for name in ("v_x", "speed")]
    return _present([*body, (("x", "y"), windows.travel()), *wheels])


def _scaled(values: np.ndarray | None, factor: float) -> np.ndarray | None:
    return None if values is None else factor * values


def _turn_routes(windows: Windows, speed: np.ndarray | None) -> list[Route]:
    pairs: list[tuple[tuple[str, ...], np.ndarray | None]] = [
        (("yaw_rate",), windows.mean("yaw_rate")),
        (("yaw",), windows.slope("yaw", angle=True)),
        (("course",), windows.slope("course", angle=True)),
        (("x", "y"), windows.course_rate()),
    ]
    if speed is not None:
        fast = np.where(np.abs(speed) > _SLOW, speed, math.nan)
        steer, a_y = windows.mean("steer"), windows.mean("a_y")
        pairs[2] = (("course",), _where_fast(windows.slope("course", angle=True), fast))
        if steer is not None:
            pairs.append((("steer",), steered_turn(windows.log, fast, steer)))
        if a_y is not None:
            pairs.append((("a_y",), a_y / fast))
    return _present(pairs)


def _where_fast(values: np.ndarray | None, fast: np.ndarray) -> np.ndarray | None:
    return None if values is None else np.where(np.isfinite(fast), values, math.nan)


def _push_routes(windows: Windows) -> list[Route]:
    vehicle = windows.log.vehicle
    pairs: list[tuple[tuple[str, ...], np.ndarray | None]] = [
        (("a_x",), windows.mean("a_x")),
        (("v_x",), windows.slope("v_x")),
        (("speed",), windows.slope("speed")),
    ]
    pairs += [((name,), _scaled(windows.slope(name), vehicle.r)) for name in _WHEELS]
    shares = {
        "torque_f": (vehicle.drive_front, vehicle.brake_front),
        "torque_r": (1.0 - vehicle.drive_front, 1.0 - vehicle.brake_front),
    }
    both = "torque_f" in windows.log.channels and "torque_r" in windows.log.channels
    for name, (drive, brake) in shares.items():
        torque = windows.mean(name)
        # Of an axle that is only braked, or only driven, a window tells a part of what pushes the vehicle.
        if torque is not None and not (both and min(drive, brake) <= _SHARE):
            share = np.where(torque * windows.direction > 0.0, drive, brake) if both else np.ones(len(torque))
            pairs.append(((name,), torque / share / (vehicle.m * vehicle.r)))
    force = windows.mean("drive_force")
    pairs.append((("drive_force",), _scaled(force, 1.0 / vehicle.m)))
    return _present(pairs)


# ------------------------------------------------------------------ the vote


def _agreed(windows: Windows, routes: Sequence[Route], untrusted: frozenset[str]) -> np.ndarray | None:
    """Speed: median of the routes that confirm another, or of all where none does; None without a route.

    Of two axles that contradict each other the one that spins, or locks, less is nearer to the vehicle.
    """
    trusted = [route for route in routes if not set(route.channels) & untrusted]
    witnesses = witnesses_of(trusted, MOTIONS["speed"])
    if not witnesses and len(trusted) == 2 and all(_of(route, _WHEELS) for route in trusted):
        torques = [windows.mean(name) for name in _TORQUES]
        return spins_less(trusted[0].values, trusted[1].values, torques, windows.direction)
    cluster = witnesses or trusted
    return median_of(cluster) if cluster else None


def median_of(routes: Sequence[Route]) -> np.ndarray:
    """Median of the routes by window, (W,)."""
    stack = np.stack([route.values for route in routes])
    seen = np.isfinite(stack).any(axis=0)
    out = np.full(stack.shape[1], math.nan)
    out[seen] = np.nanmedian(stack[:, seen], axis=0)
    return out


def _confirms(one: Route, other: Route, motion: Motion) -> bool:
    seen = likeness(one.values, other.values, centred=motion.centred)
    if seen is None or seen.factor <= 0.0 or seen.correlation < _CONFIRMS:
        return False
    return abs(math.log(seen.factor)) < math.log(motion.spread) and _varies_alike(one, other, motion)


def _varies_alike(one: Route, other: Route, motion: Motion) -> bool:
    """Whether what varies is correlated too, where both vary: a stuck speed is as large as a true one."""
    both = np.isfinite(one.values) & np.isfinite(other.values)
    spreads = [float(np.std(route.values[both])) for route in (one, other)]
    if max(spreads) < motion.still:
        return True
    if min(spreads) <= 0.0:
        return False
    return float(np.corrcoef(one.values[both], other.values[both])[0, 1]) >= _FOLLOWS


def witnesses_of(routes: Sequence[Route], motion: Motion) -> list[Route]:
    """The routes that at least one other of another source confirms: all torques are one command."""

    def independent(one: Route, other: Route) -> bool:
        return one is not other and not (_of(one, _TORQUES) and _of(other, _TORQUES))

    return [
        one
        for one in routes
        if any(independent(one, other) and _confirms(one, other, motion) for other in routes)
    ]


def _of(route: Route, channels: Sequence[str]) -> bool:
    return bool(set(route.channels) & set(channels))


def _judged(
    log: Log, windows: Windows, route: Route, others: Sequence[Route], motion: Motion
) -> tuple[Suspect | None, bool]:
    """A suspect, or None; and whether the others could judge the route at all."""
    witnesses = witnesses_of(others, motion)
    if not witnesses:
        return _of_two(windows, route, others, motion)
    reference = median_of(witnesses)
    size = reference - np.nanmean(reference) if motion.centred else reference
    if not np.sqrt(np.nanmean(size**2)) > motion.floor:
        return None, False
    names = tuple(name for one in witnesses for name in one.channels)
    span = None if len(route.channels) > 1 else _held_span(log, route.channels[0])
    if span is not None and _stuck_in(windows, route, reference, span, motion):
        return (
            Suspect(
                channels=route.channels,
                motion=motion,
                kind="stuck",
                factor=0.0,
                correlation=math.nan,
                witnesses=names,
                span=span,
            ),
            True,
        )
    # One witness that is off itself, as a torque by the resistance, does not make a route right.
    votes = sum(_confirms(route, one, motion) for one in witnesses)
    if 2 * votes > len(witnesses) or _confirms(route, Route((), reference), motion):
        return None, True
    # Wheels that spin follow the torques while the vehicle stays: two of its own channels outweigh them.
    if _of_body(route, motion) and any(
        _of_body(one, motion) and _confirms(route, one, motion) for one in others
    ):
        return None, True
    found, decided = _contradiction(route, reference, names, motion)
    if found is not None and _excused(found, _unbraked(windows, route), (reference, others), motion):
        return None, True
    return found, decided


def _unbraked(windows: Windows, route: Route) -> Route:
    """The route without windows in which its axle is braked: a wheel that locks shows no speed."""
    if not _of(route, _WHEELS):
        return route
    torque = windows.mean(route.channels[0].replace("omega", "torque"))
    if torque is None:
        return route
    return Route(route.channels, np.where(torque * windows.direction < 0.0, math.nan, route.values))


def _of_body(route: Route, motion: Motion) -> bool:
    """Whether a route to the change of speed shows the vehicle itself, and not its wheels or torques."""
    return motion is MOTIONS["push"] and not _of(route, (*_WHEELS, *_TORQUES))


def _excused(found: Suspect, route: Route, rest: tuple[np.ndarray, Sequence[Route]], motion: Motion) -> bool:
    """Whether a vehicle may do what looks like a wrong channel.

    Wheels spin up or lock while the vehicle does neither, so they cannot show that an accelerometer reads
    too little, and a wheel is only wrong by a scale if it is at all times. Thrust varies more than the speed,
    since resistance grows with it, and less where wheels spin.
    """
    reference, others = rest
    if _of(route, _WHEELS):
        if motion.name != "speed" or (found.correlation != 0.0 and only_spins(route.values, reference)):
            return True
        if found.kind != "scale":
            return False
        fast = np.where(np.abs(reference) > _SLOW, reference, math.nan)
        return not always_off(np.abs(route.values / fast), motion.spread)
    if motion is not MOTIONS["push"]:
        return False
    if _of(route, _TORQUES):
        if found.kind != "scale":
            return found.kind == "contradiction" and found.correlation != 0.0
        together = all(_confirms(route, one, motion) for one in others if _of(one, _TORQUES))
        return together and 1.0 < found.factor < _RESISTED
    body = any(not _of(one, (*_WHEELS, *_TORQUES)) for one in witnesses_of(others, motion))
    return not body and (found.kind == "contradiction" or abs(found.factor) < 1.0)


def _mounted(
    windows: Windows, suspect: Suspect, route: Route, others: Sequence[Route], speed: np.ndarray | None
) -> bool:
    """Whether a channel shows the motion once what a mounting adds to it is taken away.

    Of two routes alone either may be the one that its mounting disturbs.
    """
    motion = suspect.motion
    witnesses = witnesses_of(others, motion)
    pairs = [(route, Route((), median_of(witnesses or others)))]
    if not witnesses:
        pairs += [(other, route) for other in others]
    return suspect.kind != "stuck" and any(
        _shows_without(windows, one, reference, motion, speed) for one, reference in pairs
    )


def _shows_without(
    windows: Windows, route: Route, reference: Route, motion: Motion, speed: np.ndarray | None
) -> bool:
    leaks = list[Leak]()
    if motion is MOTIONS["turn"]:
        fast = None if speed is None else np.where(np.abs(speed) > _SLOW, speed, math.nan)
        leaks = leaks_into_turn(windows, route.channels, reference.values, fast)
    elif motion is MOTIONS["push"]:
        leaks = leaks_into_push(windows, route.channels)
    rest = without_leaks(route.values, reference.values, leaks, centred=motion.centred)
    return rest is not None and _confirms(Route(route.channels, rest), reference, motion)


def _slides(
    windows: Windows, suspect: Suspect, route: Route, others: Sequence[Route], speed: np.ndarray | None
) -> bool:
    """Whether front wheels that spin, or slide, make a vehicle turn more or less than it is steered."""
    motion, steer = suspect.motion, windows.mean("steer")
    scale = suspect.kind == "scale" and route.channels == ("steer",)
    if not scale or motion is not MOTIONS["turn"] or speed is None or steer is None:
        return False
    vehicle, turn = windows.log.vehicle, median_of(witnesses_of(others, motion) or others)
    rim, fast = windows.mean("omega_f"), np.where(np.abs(speed) > _SLOW, speed, math.nan)
    ahead = np.zeros(len(turn)) if rim is None else vehicle.r * rim / fast - 1.0
    steered = np.isfinite(turn * fast) & (np.abs(np.nan_to_num(steer)) > _STEERED)
    if steered.sum() >= _ENOUGH and np.mean(ahead[steered] > _ROLLS) > _MOSTLY:
        return 1.0 / _TURNED < suspect.factor < _TURNED  # they push it where they point, or nowhere
    known = steered & (np.abs(ahead) < _ROLLS)
    if known.sum() < _ENOUGH or suspect.factor < 1.0:
        return False
    v, turn = speed[known], np.abs(turn[known])
    pure = np.arctan((vehicle.l_f + vehicle.l_r) * turn / np.abs(v))
    most = motion.spread * pure + _SLIDE * turn * np.abs(v)
    return float(np.mean(np.abs(steer[known]) < most)) > _MOSTLY


def _of_two(
    windows: Windows, route: Route, others: Sequence[Route], motion: Motion
) -> tuple[Suspect | None, bool]:
    """Two routes alone: where they contradict each other, either may be wrong."""
    if len(others) != 1:
        return None, False
    if _confirms(route, others[0], motion):
        return None, True
    found, decided = _contradiction(route, others[0].values, others[0].channels, motion)
    if found is None or found.kind == "contradiction":
        return None, decided
    wheels = motion is MOTIONS["speed"] and _of(route, _WHEELS) and _of(others[0], _WHEELS)
    if wheels and found.kind == "scale":
        front, rear = (route, others[0]) if route.channels == _WHEELS[:1] else (others[0], route)
        if one_spins(windows, front.values, rear.values):
            return None, True
    both = tuple(sorted((*route.channels, *others[0].channels)))
    return replace(found, channels=both), decided


def _contradiction(
    route: Route, reference: np.ndarray, names: tuple[str, ...], motion: Motion
) -> tuple[Suspect | None, bool]:
    both = np.isfinite(route.values) & np.isfinite(reference)
    if both.sum() < _ENOUGH:
        return None, False
    seen = likeness(route.values, reference, centred=motion.centred)
    spread = float(np.std(reference[both]))

    def suspect(kind: str, factor: float, correlation: float) -> tuple[Suspect | None, bool]:
        return (
            Suspect(
                channels=route.channels,
                motion=motion,
                kind=kind,
                factor=factor,
                correlation=correlation,
                witnesses=names,
            ),
            True,
        )

    own = route.values[both]
    constant = float(np.std(own)) <= 1e-9 * max(float(np.abs(own).max()), 1e-300)
    if seen is None or constant:
        return suspect("contradiction", 0.0, 0.0) if spread > motion.still else (None, False)
    if abs(seen.correlation) >= _CONFIRMS:
        if seen.factor < 0.0:
            return suspect("sign", seen.factor, seen.correlation)
        if abs(math.log(seen.factor)) >= math.log(motion.spread):
            return suspect("scale", seen.factor, seen.correlation)
    follows = likeness(route.values, reference, centred=True)
    if spread > motion.still and follows is not None and abs(follows.correlation) < _UNRELATED:
        return suspect("contradiction", seen.factor, follows.correlation)
    return None, False


# ------------------------------------------------------------------ held values


def _held_span(log: Log, name: str) -> tuple[float, float] | None:
    """(From, to) [s] of the longest run of equal samples, if it is long.

    A torque may rest at an end of its range, since full throttle is held, unless it never comes back.
    """
    t, values = log.samples(name)
    start, length = longest_run(values)
    if length < _HELD_SAMPLES or length == len(values):
        return None
    span = float(t[start]), float(t[start + length - 1])
    back = start + length < len(values)
    full = name in _TORQUES and back and values[start] in (values.min(), values.max())
    return span if span[1] - span[0] > _HELD and not full else None


def _stuck_in(
    windows: Windows, route: Route, reference: np.ndarray, span: tuple[float, float], motion: Motion
) -> bool:
    """Whether the others move in the span as they do elsewhere, where the route follows them."""
    inside = (windows.starts >= span[0]) & (windows.starts + windows.length <= span[1])
    outside = (windows.starts + windows.length < span[0]) | (windows.starts > span[1])
    known = np.isfinite(reference) & np.isfinite(route.values)
    inside, outside = inside & known, outside & known
    if inside.sum() < 4 or outside.sum() < 4:
        return False
    moved = float(np.std(reference[inside]))
    if moved < max(motion.still, _AS_LIVELY * float(np.std(reference[outside]))):
        return False
    elsewhere = np.corrcoef(route.values[outside], reference[outside])[0, 1]
    held = route.values[inside]
    here = 0.0 if np.std(held) <= 0.0 else float(np.corrcoef(held, reference[inside])[0, 1])
    return bool(elsewhere > _CONFIRMS and here < _FOLLOWS)
