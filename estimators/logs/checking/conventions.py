"""Mounting of the IMU and signs of all channels, by the motions that several channels show at once.

Gravity points down, the yaw rate is the turn of heading and path and follows the steering, the acceleration
to the left is speed times yaw rate, the one forward is the change of speed. Correlations of window means with
these decide
between the 24 mountings at right angles and the signs of single channels; no unit matters. Each change costs
something, so that one mounting is preferred to several signs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from estimators.logs.checking.mends import Line, Remark
from estimators.logs.log import Log
from estimators.logs.mounting import ACCELEROMETERS, GYROS
from estimators.logs.signals import Windows, unwrapped
from offroad_env.physics.numerics import GRAVITY

__all__ = ["conventions", "is_compass"]

#: A correlation below this decides nothing; a law weighs so much; each change costs so much.
_CLEAR, _GRAVITY, _COST = 0.45, 1.5, 0.45
#: More things are not wrong at once, a mounting counted as one.
_MOST_CHANGES = 3
#: What a better hypothesis must gain.
_LEAST_GAIN = 0.5
#: A mounting that is off by more than this is stated by its angles.
_TILTED = math.radians(12.0)
#: Share of gravity that a mean must have to be gravity, where it is said to be taken out.
_HIDDEN = 0.5
#: Windows in which something moves [m/s].
_MOVING = 0.5
_FORWARD, _LEFT, _UP = range(3)
_TURNS = ("yaw", "path", "steer")


class _Evidence(NamedTuple):
    """Signed squares of the correlations of the IMU's axes with what they may show; NaN: nothing decides."""

    turn: dict[str, np.ndarray]  #: by reference of the turn: (3,) of each gyro axis
    lateral: dict[str, np.ndarray]  #: by reference of the turn, or gyro axis "0" ... "2": (3,)
    forward: np.ndarray  #: (3,) of each accelerometer axis with the change of speed
    gravity: np.ndarray  #: (3,) direction of the mean specific force; NaN without gravity
    between: dict[tuple[str, str], float]  #: of two references of the turn with each other


@dataclass(frozen=True)
class _Hypothesis:
    """A mounting, and signs: of a_x, a_y, a_z, yaw rate after it, and of the references of the turn."""

    rows: tuple[tuple[int, int], ...]  #: of forward, left, up: axis of the IMU and its sign
    signs: tuple[int, ...] = (1, 1, 1, 1)
    turns: tuple[int, ...] = (1, 1, 1)

    @cached_property
    def changes(self) -> int:
        """How many things are other than they were read."""
        return (self.rows != _AS_READ) + sum(s < 0 for s in (*self.signs, *self.turns))


_AS_READ = ((0, 1), (1, 1), (2, 1))


def _mountings() -> Iterator[tuple[tuple[int, int], ...]]:
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0.0:
                yield tuple(zip(order, signs, strict=True))


@cache
def _hypotheses() -> tuple[_Hypothesis, ...]:
    """All with few changes."""
    signs = list(itertools.product((1, -1), repeat=4))
    turns = list(itertools.product((1, -1), repeat=3))
    found = (_Hypothesis(*parts) for parts in itertools.product(_mountings(), signs, turns))
    return tuple(hypothesis for hypothesis in found if hypothesis.changes <= _MOST_CHANGES)


def conventions(log: Log, files: frozenset[str]) -> list[Remark]:
    """What is turned or reversed, with the lines that mend it; empty where all agrees.

    Parameters
    ----------
    files
        Columns of the log that the file has, under the names of the log: raw ones included.
    """
    evidence = _evidence(log)
    turns = [name in evidence.turn for name in _TURNS]
    best, before = _Hypothesis(_AS_READ), _score(_Hypothesis(_AS_READ), evidence)
    highest = before
    for hypothesis in _hypotheses():
        if any(sign < 0 and not has for sign, has in zip(hypothesis.turns, turns, strict=True)):
            continue
        value = _score(hypothesis, evidence)
        if value > highest + 1e-9:
            best, highest = hypothesis, value
    if highest < before + _LEAST_GAIN:
        best = _Hypothesis(_AS_READ)
    remarks = _mounting_remarks(log, best, evidence)
    if not remarks:
        remarks = _sign_remarks(log, best, files)
    return remarks


# ------------------------------------------------------------------ evidence


def _correlation(a: np.ndarray | None, b: np.ndarray | None, *, centred: bool = True) -> float:
    if a is None or b is None:
        return math.nan
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 8:
        return math.nan
    x, y = a[both], b[both]
    kept = (np.abs(x) <= np.quantile(np.abs(x), 0.98)) & (np.abs(y) <= np.quantile(np.abs(y), 0.98))
    x, y = x[kept], y[kept]
    if centred:
        x, y = x - x.mean(), y - y.mean()
    power = float(x @ x) * float(y @ y)
    found = float(x @ y) / math.sqrt(power) if power > 0.0 else math.nan
    # Squared with its sign: one clear law outweighs several weak ones.
    return found * abs(found) if abs(found) >= _CLEAR else math.nan


def _speeds(windows: Windows) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(forward speed, its change) by the first channel that has it; of a wheel, in units of its radius."""
    for name in ("v_x", "speed", "omega_r", "omega_f"):
        mean, slope = windows.mean(name), windows.slope(name)
        if mean is not None:
            return mean, slope
    return windows.travel(), None


def _evidence(log: Log) -> _Evidence:
    windows = Windows(log)
    speed, change = _speeds(windows)
    accelerations = [windows.mean(name) for name, _ in ACCELEROMETERS]
    gyros = [None if (mean := windows.mean(name)) is None else sign * mean for name, sign in GYROS]
    steer = windows.mean("steer")
    turns = {
        "yaw": windows.slope("yaw", angle=True),
        "path": windows.course_rate(),
        "steer": None if speed is None or steer is None else speed * steer,
    }
    found = {name: turn for name, turn in turns.items() if turn is not None}
    axes = {str(i): gyro for i, gyro in enumerate(gyros) if gyro is not None}
    lateral = {
        name: np.array([_correlation(a, None if speed is None else speed * turn) for a in accelerations])
        for name, turn in {**found, **axes}.items()
    }
    return _Evidence(
        turn={
            name: np.array([_correlation(_like(windows, gyro, name), turn, centred=False) for gyro in gyros])
            for name, turn in found.items()
        },
        lateral=lateral,
        forward=np.array([_correlation(a, change) for a in accelerations]),
        gravity=_gravity(log, accelerations),
        between={
            (a, b): _correlation(_like(windows, found[a], b), _like(windows, found[b], a), centred=False)
            for a, b in itertools.combinations(found, 2)
        },
    )


def _like(windows: Windows, gyro: np.ndarray | None, name: str) -> np.ndarray | None:
    """A rate as a reference of the turn has it: the course of a path is smoothed."""
    return windows.as_course_rate(gyro) if name == "path" and gyro is not None else gyro


def _gravity(log: Log, means: list[np.ndarray | None]) -> np.ndarray:
    """Direction of the mean specific force; NaN where the accelerometers show none.

    Where gravity is said to be taken out a mean that is less than a share of it is the vehicle's own, of one
    that only brakes, say, or a bias.
    """
    nothing = np.full(3, math.nan)
    present = [mean for mean in means if mean is not None]
    if not present or log.duration < 3.0:
        return nothing
    vector = np.array([math.nan if mean is None else np.nanmedian(mean) for mean in means])
    spread = np.array([math.nan if mean is None else np.nanstd(mean) for mean in means])
    size = math.sqrt(np.nansum(vector**2))
    least = _HIDDEN * GRAVITY if log.imu.kinematic else 0.0
    if not size > max(least, 2.0 * math.sqrt(np.nansum(spread**2))):
        return nothing
    return np.asarray(np.where(np.isnan(vector), 0.0, vector) / size)


def _score(hypothesis: _Hypothesis, evidence: _Evidence) -> float:
    """Sum of all correlations as the hypothesis has their signs, less what its changes cost."""
    (forward, s_forward), (left, s_left), (up, s_up) = hypothesis.rows
    a_x, a_y, a_z, rate = hypothesis.signs
    turns = dict(zip(_TURNS, hypothesis.turns, strict=True))
    terms = [s_forward * a_x * evidence.forward[forward], _GRAVITY * s_up * a_z * evidence.gravity[up]]
    terms += [turns[name] * s_up * rate * values[up] for name, values in evidence.turn.items()]
    for name, values in evidence.lateral.items():
        if name == str(up):
            terms.append(s_left * a_y * s_up * rate * values[left])
        elif name in turns:
            terms.append(0.5 * turns[name] * s_left * a_y * values[left])
    terms += [0.5 * turns[a] * turns[b] * value for (a, b), value in evidence.between.items()]
    total = sum(float(term) for term in terms if not math.isnan(term))
    # Positions have a sign of their own last of all.
    mirrored = 0.5 * (turns["path"] < 0)
    return total - _COST * (hypothesis.changes + mirrored)


# ------------------------------------------------------------------ findings


def _matrix(hypothesis: _Hypothesis) -> np.ndarray:
    matrix = np.zeros((3, 3))
    for i, (axis, sign) in enumerate(hypothesis.rows):
        matrix[i, axis] = sign
    return matrix


def _mounting_remarks(log: Log, best: _Hypothesis, evidence: _Evidence) -> list[Remark]:
    """How the IMU is turned, if it is."""
    stated = log.imu.orientation
    own = np.eye(3) if stated is None else np.array(stated)
    matrix = _matrix(best)
    tilt = _tilt(best, evidence)
    angle = math.acos(np.clip(0.5 * (np.trace(tilt) - 1.0), -1.0, 1.0))
    complete = all(name in log.channels for name, _ in ACCELEROMETERS)
    if complete and angle > _TILTED and not log.imu.kinematic and best.signs == (1, 1, 1, 1):
        total = tilt @ matrix @ own
        return [_tilted(total, angle)]
    if best.rows == _AS_READ:
        return []
    total = matrix @ own
    axes = {name: _axis_name(total[i]) for name, i in (("forward", _FORWARD), ("left", _LEFT))}
    if any(name is None for name in axes.values()):
        return [_tilted(total, math.acos(np.clip(0.5 * (np.trace(matrix) - 1.0), -1.0, 1.0)))]
    shown = f"forward is its {axes['forward']} axis, left its {axes['left']} axis"
    return [
        Remark(
            severity="problem",
            sentence=f"the IMU is turned on the vehicle: {shown} (by gravity, turns and changes of speed)",
            lines=(Line("imu.orientation", axes),),
        )
    ]


def _tilt(best: _Hypothesis, evidence: _Evidence) -> np.ndarray:
    """Least rotation that turns the mean specific force, mounted as in ``best``, upright (Rodrigues)."""
    if np.isnan(evidence.gravity).any():
        return np.eye(3)
    upward = _matrix(best) @ evidence.gravity
    axis, cosine = np.cross(upward, [0.0, 0.0, 1.0]), float(upward[_UP])
    if cosine < -0.9:
        return np.eye(3)
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + cosine))


def _tilted(matrix: np.ndarray, angle: float) -> Remark:
    yaw = math.atan2(matrix[1, 0], matrix[0, 0])
    pitch = math.asin(np.clip(matrix[2, 0], -1.0, 1.0))
    roll = math.atan2(matrix[2, 1], matrix[2, 2])
    named = {"yaw": yaw, "pitch": pitch, "roll": roll}
    shown = {name: f"{math.degrees(value):.0f} deg" for name, value in named.items() if abs(value) > 0.009}
    return Remark(
        severity="problem",
        sentence=(
            f"the IMU is tilted by {math.degrees(angle):.0f} degrees: the mean specific force does not "
            "point up along "
            "its z axis"
        ),
        lines=(Line("imu.orientation", shown or {"yaw": "0 deg"}),),
    )


def _axis_name(row: np.ndarray) -> str | None:
    axis = int(np.argmax(np.abs(row)))
    if abs(abs(row[axis]) - 1.0) > 1e-6:
        return None
    return f"{'-' if row[axis] < 0.0 else ''}{'xyz'[axis]}"


_RAW = {"yaw_rate": "gyro_z", "pitch_rate": "gyro_y", "roll_rate": "gyro_x", "yaw": "q_z", "y": "latitude"}


def _sign_remarks(log: Log, best: _Hypothesis, files: frozenset[str]) -> list[Remark]:
    """Channels with a reversed sign."""
    found = [
        (name, sentence)
        for name, sign, sentence in (
            ("a_x", best.signs[0], "runs against the change of speed"),
            ("a_y", best.signs[1], "runs against speed x yaw_rate"),
            ("a_z", best.signs[2], "shows gravity downwards"),
            ("yaw_rate", best.signs[3], "runs against heading, path or steering"),
        )
        if sign < 0
    ]
    reasons = {
        "yaw": "turns against yaw_rate",
        "path": "the path turns against yaw_rate",
        "steer": "turns against yaw_rate",
    }
    names = {"yaw": "yaw", "path": "y", "steer": "steer"}
    found += [(names[name], reasons[name]) for name, s in zip(_TURNS, best.turns, strict=True) if s < 0]
    return [_reversed(log, name, sentence, files) for name, sentence in found]


def _reversed(log: Log, name: str, sentence: str, files: frozenset[str]) -> Remark:
    axes = log.imu.orientation
    triads = {
        channel: (i, triad) for triad in (ACCELEROMETERS, GYROS) for i, (channel, _) in enumerate(triad)
    }
    column = name
    if axes is not None and name in triads:
        i, triad = triads[name]
        column = triad[int(np.argmax(np.abs(axes[i])))][0]
    if column not in files and _RAW.get(column) in files:
        column = _RAW[column]
    if name == "yaw" and is_compass(log, name):
        unit = "deg compass"
        return Remark(
            severity="problem",
            sentence="yaw counts clockwise from north, a log counterclockwise from x (east)",
            lines=(Line(f"units.{column}", unit),),
        )
    return Remark(
        severity="problem",
        sentence=f"the sign of {column} is reversed: {name} {sentence}",
        lines=(Line(f"signs.{column}", -1),),
    )


def is_compass(log: Log, name: str) -> bool:
    """Whether a heading or course fits the path as a compass's; by its numbers where there is no path."""
    values = log.samples(name)[1]
    windows = Windows(log)
    moved = windows.displacement()
    t, yaw = log.samples(name)
    if moved is None:
        degrees = np.degrees(values)
        return bool(degrees.min() >= -1.0 and 180.0 < np.ptp(degrees) <= 361.0)
    fast = np.hypot(*moved) > _MOVING
    middle = np.interp(windows.starts + 0.5 * windows.length, t, unwrapped(yaw))
    way = np.arctan2(moved[1], moved[0])
    if name == "yaw":
        way = np.where(windows.direction < 0.0, way + math.pi, way)
    fits = np.cos(0.5 * math.pi - middle - way)[fast & np.isfinite(way)]
    return bool(len(fits) and np.median(fits) > 0.8)
