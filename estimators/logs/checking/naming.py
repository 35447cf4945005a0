"""What the columns of a file are, from their names.

A name is split into words (``imu/linear_acceleration.y`` -> imu, linear, acceleration, y); the unit at its
end, in brackets or as a suffix, is taken off. The first rule whose words are all there names the column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from estimators.logs.checking.languages import english, plain_letters
from estimators.logs.schema import ALL_COLUMNS, VEHICLE_INPUTS, plain_unit
from estimators.logs.unit_conversion import conversion
from offroad_env.errors import InvalidParameter

__all__ = ["Match", "match_columns", "named_unit"]

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(<{](?P<unit>[^\])>}]*)[\])>}]\s*$")
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")

#: Units at the end of a name, as words without separators -> unit.
_SUFFIXES = {
    "degs": "deg/s", "degsec": "deg/s", "dps": "deg/s", "degps": "deg/s", "rads": "rad/s", "radsec": "rad/s",
    "radps": "rad/s", "mradps": "mrad/s", "ms2": "m/s^2", "mps2": "m/s^2", "mss": "m/s^2", "mpss": "m/s^2",
    "ms": "m/s", "mps": "m/s", "kmh": "km/h", "kph": "km/h", "kmph": "km/h", "mph": "mph", "knots": "kn",
    "rpm": "rpm",
    "deg": "deg", "degrees": "deg", "rad": "rad", "g": "g", "gs": "g", "mg": "mg", "nm": "N m", "n": "N",
    "kn": "kN", "m": "m", "mm": "mm", "cm": "cm", "s": "s", "sec": "s", "secs": "s", "seconds": "s",
    "msec": "ms",
    "us": "us", "usec": "us", "ns": "ns", "nsec": "ns", "nanoseconds": "ns", "milliseconds": "ms",
}  # fmt: skip

#: Spellings of one word, and words that stand for two.
_SAME = {
    "acc": "accel", "acceleration": "accel", "accelerometer": "accel", "accelerations": "accel",
    "gyr": "gyro",
    "gyroscope": "gyro", "gyros": "gyro", "vel": "velocity", "spd": "speed", "pos": "position",
    "quat": "quaternion",
    "steering": "steer", "delta": "steer", "trq": "torque", "tau": "torque", "whl": "wheel",
    "wheels": "wheel",
    "wss": "wheel", "ws": "wheel", "tire": "wheel", "tyre": "wheel", "rim": "wheel", "encoder": "wheel",
    "enc": "wheel", "vesc": "wheel", "longitudinal": "x", "forward": "x", "fwd": "x", "lateral": "y",
    "vertical": "z", "vert": "z", "psi": "yaw", "heading": "yaw", "hdg": "yaw", "azimuth": "yaw",
    "theta": "pitch", "phi": "roll",
    "cog": "course", "lng": "lon", "latitude": "lat", "longitude": "lon", "easting": "east",
    "northing": "north",
    "tow": "time",
    "timestamp": "time", "stamp": "time", "elapsed": "time", "datetime": "time", "dot": "rate",
    "ang": "angular",
    "command": "cmd", "commanded": "cmd", "back": "rear", "moment": "torque", "axle": "wheel", "revs": "rpm",
}  # fmt: skip
_PAIRS = {
    "ax": "accel x", "ay": "accel y", "az": "accel z", "accx": "accel x", "accy": "accel y",
    "accz": "accel z",
    "gx": "gyro x", "gy": "gyro y", "gz": "gyro z", "gyrox": "gyro x", "gyroy": "gyro y", "gyroz": "gyro z",
    "wx": "gyro x", "wy": "gyro y", "wz": "gyro z", "vx": "velocity x", "vy": "velocity y",
    "px": "position x",
    "py": "position y", "qw": "quaternion w", "qx": "quaternion x", "qy": "quaternion y",
    "qz": "quaternion z",
    "fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right", "lf": "front left",
    "rf": "front right", "lr": "rear left", "yawrate": "yaw rate", "pitchrate": "pitch rate", "secs": "time",
    "rollrate": "roll rate", "wheelspeed": "wheel speed", "wheelspeeds": "wheel speed",
    "swa": "steer wheel angle",
    "seconds": "time", "sec": "time", "nsecs": "time nano", "nanosec": "time nano", "nsec": "time nano",
    "lin": "linear", "utc": "time", "ns": "time nano",
}  # fmt: skip

#: A column with one of these is about another, or is what was wished and not what was measured.
_ABOUT = {
    "std", "cov", "covariance", "var", "variance", "accuracy", "error", "err", "status", "valid",
    "quality", "bias",
    "target", "desired", "setpoint", "reference", "ref", "limit", "max", "min", "temperature", "temp",
    "seq", "age",
    "count", "sat", "sats", "mag", "magnetic", "current", "voltage", "power", "jerk",
}  # fmt: skip
#: Less likely the one that is meant.
_WORSE = {"raw", "pf", "sim", "cmd", "est", "estimated", "filtered", "fused", "ekf", "input"}


def _rule(column: str, *wanted: str, without: str = "") -> tuple[str, frozenset[str], frozenset[str]]:
    return column, frozenset(wanted), frozenset(without.split())


_NO_RATE = "rate velocity angular accel gyro speed"
#: (column, words that must be there, words that must not); the first that fits.
_RULES = (
    *(_rule(f"q_{axis}", "quaternion", axis) for axis in "wxyz"),
    *(_rule(f"q_{axis}", "orientation", axis) for axis in "wxyz"),
    *(_rule(f"a_{axis}", "accel", axis, without="angular gyro") for axis in "xyz"),
    _rule("a_y", "accel", "lat"),
    _rule("a_x", "accel", "long"),
    *(_rule(f"gyro_{axis}", "gyro", axis) for axis in "xyz"),
    *(_rule(f"gyro_{axis}", "angular", axis) for axis in "xyz"),
    *(_rule(f"gyro_{axis}", "omega", axis) for axis in "xyz"),
    *(_rule(f"{angle}_rate", angle, word) for angle in ("yaw", "pitch", "roll") for word in ("rate", "gyro")),
    *(_rule(f"{angle}_rate", angle, "velocity") for angle in ("yaw", "pitch", "roll")),
    *(
        _rule(f"omega_{end[0]}{side[0]}", kind, end, side, without="torque steer accel")
        for kind in ("wheel", "omega", "rpm", "speed", "velocity")
        for end in ("front", "rear")
        for side in ("left", "right")
    ),
    *(
        _rule(f"torque_{end[0]}{side[0]}", "torque", end, side)
        for end in ("front", "rear")
        for side in ("left", "right")
    ),
    _rule("torque_f", "torque", "front", without="steer"),
    _rule("torque_r", "torque", "rear", without="steer"),
    _rule("torque_total", "torque", without="steer"),
    _rule("drive_force", "force", "drive"),
    _rule("drive_force", "force", "traction"),
    *(
        _rule(column, kind, word, without="torque steer accel angular")
        for kind in ("wheel", "omega", "rpm")
        for column, word in (
            ("omega_f", "front"), ("omega_r", "rear"), ("omega_left", "left"), ("omega_right", "right"),
        )
    ),
    _rule("steer", "steer", without="torque rate velocity speed"),
    _rule("steer", "wheel", "angle", without="torque rate velocity speed"),
    _rule("omega", "rpm", without="cmd torque engine motor"),
    _rule("omega", "wheel", "speed", without="cmd torque"),
    _rule("omega", "wheel", "velocity", without="cmd torque"),
    _rule("omega", "wheel", "rpm", without="cmd torque"),
    _rule("omega", "omega", "wheel", without="cmd torque"),
    _rule("latitude", "lat", without="accel y vel velocity std"),
    _rule("longitude", "lon", without="accel"),
    _rule("longitude", "long", without="accel velocity speed"),
    _rule("course", "course"),
    _rule("course", "track", "angle"),
    _rule("yaw", "yaw", without=_NO_RATE),
    _rule("pitch", "pitch", without=_NO_RATE),
    _rule("roll", "roll", without=_NO_RATE),
    _rule("v_x", "velocity", "x", without="angular gyro cmd"),
    _rule("v_y", "velocity", "y", without="angular gyro cmd"),
    _rule("v_x", "speed", "x", without="angular cmd"),
    _rule("v_y", "speed", "y", without="angular cmd"),
    _rule("v_x", "twist", "linear", "x"),
    _rule("v_y", "twist", "linear", "y"),
    _rule("speed", "speed", without="x y z cmd wheel angular rate wind engine motor"),
    _rule("speed", "velocity", without="x y z cmd wheel angular engine motor east north up down"),
    _rule("speed", "v"),
    _rule("x", "position", "x"),
    _rule("y", "position", "y"),
    _rule("x", "pose", "x", without="orientation"),
    _rule("y", "pose", "y", without="orientation"),
    _rule("x", "x", without="accel gyro angular velocity orientation z mag linear"),
    _rule("y", "y", without="accel gyro angular velocity orientation z mag linear"),
    _rule("x", "east", without="velocity speed"),
    _rule("y", "north", without="velocity speed"),
    _rule("t", "time", without="nano x y z"),
    _rule("t", "t"),
)  # fmt: skip

#: A column that another one makes superfluous.
_SUPERSEDED = {
    "gyro_x": ("roll_rate",), "gyro_y": ("pitch_rate",), "gyro_z": ("yaw_rate",), "latitude": ("x", "y"),
    "longitude": ("x", "y"), "torque_total": ("torque_f", "torque_r", "torque_fl", "torque_rl"),
    "omega": ("omega_f", "omega_r", "omega_fl", "omega_rl"), "omega_left": ("omega_fl", "omega_rl",
    "omega_f"),
    "omega_right": ("omega_fr", "omega_rr", "omega_f"), "omega_f": ("omega_fl", "omega_fr"),
    "omega_r": ("omega_rl", "omega_rr"), "torque_f": ("torque_fl",), "torque_r": ("torque_rl",),
}  # fmt: skip
_TOGETHER = (
    ("q_w", "q_x", "q_y", "q_z"), ("latitude", "longitude"), ("omega_fl", "omega_fr"), ("omega_rl",
    "omega_rr"),
    ("omega_left", "omega_right"), ("torque_fl", "torque_fr"), ("torque_rl", "torque_rr"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Match:
    """A column of a log in a file."""

    column: str  #: name in a log
    source: str | list[str]  #: name in the file; [seconds, nanoseconds] for split stamps
    unit: str | None  #: unit that the name states, if it is not the log's own
    others: tuple[str, ...] = ()  #: further columns of the file that could be it

    @property
    def first(self) -> str:
        """The file's name, of the seconds for split stamps."""
        return self.source if isinstance(self.source, str) else self.source[0]


def named_unit(name: str) -> tuple[str, str | None]:
    """(name without its unit, the unit as it is written there or None)."""
    brackets = _BRACKETS.match(name.strip())
    if brackets and brackets["name"]:
        return brackets["name"].strip(), brackets["unit"].strip() or None
    words = _WORD.findall(name)
    for count in (3, 2, 1):
        suffix = "".join(words[-count:]).lower()
        if len(words) > count and suffix in _SUFFIXES:
            cut = name.lower().rfind(words[-count].lower())
            return name[:cut].rstrip(" _-./"), _SUFFIXES[suffix]
    return name, None


def _words(name: str) -> set[str]:
    own = [word.lower() for word in _WORD.findall(plain_letters(name))]
    words: list[str] = []
    for word, foreign in zip(own, english(own), strict=True):
        if foreign is not None:
            words += foreign
        else:
            words += _PAIRS[word].split() if word in _PAIRS else [_SAME.get(word, word)]
    # a_x, v_x, w_z, q_w: the letter before an axis names the quantity.
    for letter, meaning in (("q", "quaternion"), ("a", "accel"), ("v", "velocity"), ("w", "gyro")):
        axes = ("w", "x", "y", "z") if letter == "q" else ("x", "y", "z")
        if len(words) >= 2 and letter in words[:-1] and words[-1] in axes:
            words[words.index(letter)] = meaning
            break
    return set(words)


def _placed(words: set[str], *, sides: bool) -> set[str]:
    """Words with single letters read as what they are beside a wheel or a torque."""
    ends = {"front", "rear", "left", "right"}
    letters = {"f": "front", "l": "left", "r": "right" if sides else "rear"}
    if words & {"wheel", "omega", "rpm", "torque"}:
        words = {letters.get(word, word) for word in words}
    if words & ends:
        words = {{"m": "torque", "n": "rpm"}.get(word, word) for word in words}
    return words - {"m"} if len(words) > 1 else words


def _by_sides(names: Iterable[str]) -> bool:
    """Whether the letter r at a wheel stands for right: there is an l and no f."""
    placed = [words for words in map(_words, names) if words & {"wheel", "omega", "rpm", "torque"}]
    return any("l" in words for words in placed) and not any(words & {"f", "front"} for words in placed)


def column_of(name: str, *, sides: bool = False) -> str | None:
    """The log's column that a file's column of this name is, or None.

    With ``sides``, the letter r of a wheel stands for right, otherwise for rear.
    """
    plain, unit = named_unit(name)
    words = _words(plain) | ({"rpm"} if unit is not None and plain_unit(unit) == "rpm" else set())
    words = _placed(words, sides=sides)
    if not words or words & _ABOUT:
        return None
    if "w" in words and "orientation" not in words and "quaternion" not in words:
        words -= {"w"}
    return next((column for column, need, without in _RULES if need <= words and not without & words), None)


def match_columns(names: Sequence[str], taken: Iterable[str] = ()) -> tuple[list[Match], list[str]]:
    """(columns that the names are, names that are no column of a log).

    Parameters
    ----------
    names
        Of the file's columns, without those that the YAML names or ignores.
    taken
        Columns of the log that have a source already.
    """
    candidates: dict[str, list[str]] = {}
    rest = []
    sides = _by_sides(names)
    for name in names:
        exact = name in VEHICLE_INPUTS and not (sides and name in ("omega_r", "torque_r"))
        column = name if exact else column_of(name, sides=sides)
        if column is None:
            rest.append(name)
        else:
            candidates.setdefault(column, []).append(name)
    _split_stamp(names, candidates, rest)
    _body_rates(names, candidates, rest)
    nanoseconds = [name for name in rest if {"time", "nano"} <= _words(named_unit(name)[0])]
    have = {*taken, *candidates}
    matches = []
    for column, found in candidates.items():
        superseded = any(other in have for other in _SUPERSEDED.get(column, ()))
        exact = column in found
        if column in taken or (superseded and not exact):
            rest += found
            continue
        found = sorted(found, key=_preference)
        if exact:
            found = [column, *(name for name in found if name != column)]
        matches.append(_match(column, found, nanoseconds if column == "t" else []))
    rest += [name for match in matches for name in match.others]
    matches = _whole_groups(matches, set(taken), rest)
    used = {match.first for match in matches} | {
        name for match in matches if isinstance(match.source, list) for name in match.source
    }
    return matches, [name for name in names if name not in used and name in {*rest, *names}]


def _body_rates(names: Sequence[str], candidates: dict[str, list[str]], rest: list[str]) -> None:
    """Take p, q, r for the rates about x, y, z, where all three are there."""
    found = {name.lower(): name for name in names}
    if {"p", "q", "r"} <= set(found):
        for letter, column in (("p", "gyro_x"), ("q", "gyro_y"), ("r", "gyro_z")):
            if column not in candidates:
                candidates[column] = [found[letter]]
                if found[letter] in rest:
                    rest.remove(found[letter])


def _split_stamp(names: Sequence[str], candidates: dict[str, list[str]], rest: list[str]) -> None:
    """Take a column S beside one of nanoseconds for the stamp, where there is no other."""
    seconds = next((name for name in names if name.lower() in ("s", "sec", "secs")), None)
    nanoseconds = any(name.lower() in ("ns", "nsec", "nsecs", "nanosec") for name in names)
    if seconds is not None and nanoseconds and "t" not in candidates:
        candidates["t"] = [seconds]
        if seconds in rest:
            rest.remove(seconds)


def _whole_groups(matches: list[Match], taken: set[str], rest: list[str]) -> list[Match]:
    """Without columns of a group that is not complete."""
    have = taken | {match.column for match in matches}
    broken = {name for group in _TOGETHER if not set(group) <= have for name in group}
    rest += [match.first for match in matches if match.column in broken]
    return [match for match in matches if match.column not in broken]


def _preference(name: str) -> tuple[int, int]:
    words = _words(named_unit(name)[0])
    return len(words & _WORSE), len(words)


def _match(column: str, found: list[str], nanoseconds: list[str]) -> Match:
    source, others = found[0], tuple(found[1:])
    _, unit = named_unit(source)
    if nanoseconds and unit in (None, "s"):
        return Match(column=column, source=[source, nanoseconds[0]], unit=None, others=others)
    return Match(column=column, source=source, unit=_foreign(unit, column), others=others)


def _foreign(unit: str | None, column: str) -> str | None:
    """The unit, unless it is the log's own or none of the column."""
    if unit is None:
        return None
    if column == "t" and unit == "m/s":
        unit = "ms"
    try:
        found = conversion(unit, ALL_COLUMNS[column])
    except InvalidParameter:
        return None
    return unit if found.factor != 1.0 or found.over_radius else None
