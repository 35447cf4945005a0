"""How an IMU is mounted: its samples in the axes of the vehicle, and at an even rate."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from estimators.logs.schema import IMU
from estimators.logs.yaml_sections import Section
from offroad_env.world.yaml_text import shown

__all__ = [
    "ACCELEROMETERS",
    "GYROS",
    "IMU_CHANNELS",
    "at_even_rate",
    "axes_of",
    "parse_orientation",
    "turned",
]

#: Channels about or along x, y, z, with the sign of their axis: the pitch rate is positive nose up, which
#: is a
#: rotation about the axis to the left by the left hand.
ACCELEROMETERS = (("a_x", 1.0), ("a_y", 1.0), ("a_z", 1.0))
GYROS = (("roll_rate", 1.0), ("pitch_rate", -1.0), ("yaw_rate", 1.0))
IMU_CHANNELS = ("roll_rate", *IMU)

#: An axis that contributes less than this to a channel may be missing.
_NEGLIGIBLE = 0.1
#: A pause longer than this many usual steps, and than this [s], is not bridged.
_PAUSE_STEPS, _PAUSE = 5.0, 0.15
_NAMES = ("forward", "left", "up")
_ANGLES = ("yaw", "pitch", "roll")

Axes = tuple[tuple[float, float, float], ...]


def parse_orientation(section: Section) -> Axes | None:
    """The vehicle's forward, left and up axes in the axes of the IMU, from ``imu.orientation``.

    Either the axes themselves (``{forward: -y}``, up is z unless stated), or angles by which the IMU is
    turned
    from the vehicle (``{yaw: 90 deg}``: its x axis points left; also pitch, nose up, and roll, right side
    down).

    Raises
    ------
    DataError
        With file, line and key.
    """
    own = section.optional("orientation")
    if own is None:
        return None
    named = {name: own.take(name, None) for name in (*_NAMES, *_ANGLES)}
    own.finish()
    given = {name: value for name, value in named.items() if value is not None}
    if not given or (set(given) & set(_NAMES) and set(given) & set(_ANGLES)):
        raise section.error(
            "imu.orientation takes axes (forward: -y, left: x) or angles (yaw: 90 deg), not both",
            "orientation",
        )
    if set(given) & set(_ANGLES):
        yaw, pitch, roll = (_angle(own, name, given.get(name, 0.0)) for name in _ANGLES)
        return axes_of(yaw, pitch, roll)
    return _from_axes(own, {name: _axis(own, name, value) for name, value in given.items()})


def _angle(section: Section, name: str, value: object) -> float:
    """An angle as rad, from a number [rad] or text with its unit."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if abs(value) > 2.0 * math.pi:
            raise section.error(f"{section.name(name)}: {value} rad? Write {value} deg", name)
        return float(value)
    words = str(value).split()
    units = {"deg": math.radians(1.0), "°": math.radians(1.0), "rad": 1.0}
    try:
        number, unit = float(words[0]), units[words[1] if len(words) > 1 else "rad"]
    except (ValueError, KeyError, IndexError):
        message = f"{section.name(name)} must be an angle such as 90 deg, got {shown(value)}"
        raise section.error(message, name) from None
    return number * unit


def axes_of(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Axes:
    """Axes of the vehicle in an IMU that is turned from it by these angles [rad]."""
    c, s = np.cos([yaw, -pitch, roll]), np.sin([yaw, -pitch, roll])
    about_z = np.array([[c[0], -s[0], 0.0], [s[0], c[0], 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[c[1], 0.0, s[1]], [0.0, 1.0, 0.0], [-s[1], 0.0, c[1]]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c[2], -s[2]], [0.0, s[2], c[2]]])
    return _as_rows(about_z @ about_y @ about_x)


def _as_rows(matrix: np.ndarray) -> Axes:
    """Rows without the rounding errors of right angles."""
    kept = np.where(np.abs(matrix) < 1e-12, 0.0, matrix)
    kept = np.where(np.abs(np.abs(kept) - 1.0) < 1e-12, np.sign(kept), kept)
    return tuple((float(row[0]), float(row[1]), float(row[2])) for row in kept)


def _axis(section: Section, name: str, value: object) -> np.ndarray:
    text = str(value).strip().lower()
    letter = text.lstrip("+-")
    if letter not in ("x", "y", "z") or len(text) > 2:
        message = (
            f"{section.name(name)} must be an axis of the IMU: x, -x, y, -y, z or -z, got {shown(value)}"
        )
        raise section.error(message, name)
    axis = np.zeros(3)
    axis["xyz".index(letter)] = -1.0 if text.startswith("-") else 1.0
    return axis


def _from_axes(section: Section, given: Mapping[str, np.ndarray]) -> Axes:
    """All three axes from those that are stated; right-handed."""
    axes = dict(given)
    if len(axes) == 1:
        axes["forward" if "up" in axes else "up"] = np.eye(3)[0 if "up" in axes else 2]
    order = {"forward": ("left", "up"), "left": ("up", "forward"), "up": ("forward", "left")}
    for name, (second, third) in order.items():
        if name not in axes:
            axes[name] = np.cross(axes[second], axes[third])
    matrix = np.stack([axes[name] for name in _NAMES])
    if abs(float(np.linalg.det(matrix)) - 1.0) > 1e-9:
        raise section.error(
            "imu.orientation: these axes are not at right angles and right-handed (forward x left = up)"
        )
    return _as_rows(matrix)


def turned(channels: Mapping[str, np.ndarray], axes: Axes) -> dict[str, np.ndarray]:
    """The channels with those of the IMU in the axes of the vehicle.

    A channel that would need an axis that was not measured is left out.
    """
    result = {name: values for name, values in channels.items() if name not in IMU_CHANNELS}
    for triad in (ACCELEROMETERS, GYROS):
        for (name, sign), row in zip(triad, axes, strict=True):
            parts = [
                (weight * own * sign, channels.get(source))
                for weight, (source, own) in zip(row, triad, strict=True)
                if weight != 0.0
            ]
            if any(part is None and abs(weight) > _NEGLIGIBLE for weight, part in parts):
                continue
            result[name] = sum(
                (weight * part for weight, part in parts if part is not None),
                start=np.zeros(len(next(iter(channels.values())))),
            )
    return result


def at_even_rate(
    t: np.ndarray, channels: Mapping[str, np.ndarray], rate: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Stamps and channels with the IMU at an even ``rate`` [Hz]; the others keep their samples.

    A sample is the mean over one period of what runs straight between the IMU's own samples.
    """
    own = [name for name in IMU_CHANNELS if name in channels]
    inside = np.any([~np.isnan(channels[name]) for name in own], axis=0)
    first, last = t[inside][0], t[inside][-1]
    grid = first + np.arange(math.floor((last - first) * rate + 1e-6) + 1) / rate
    rest = [name for name in channels if name not in own]
    kept = t[np.any([~np.isnan(channels[name]) for name in rest], axis=0)] if rest else t[:0]
    grid, kept = np.round(grid, 9), np.round(kept, 9)
    rows = np.union1d(grid, kept)
    result = {}
    for name, values in channels.items():
        present = ~np.isnan(values)
        column = np.full(len(rows), math.nan)
        if name in own:
            column[np.searchsorted(rows, grid)] = _means(t[present], values[present], grid, 1.0 / rate)
        else:
            column[np.searchsorted(rows, np.round(t[present], 9))] = values[present]
        result[name] = column
    return rows, result


def _means(t: np.ndarray, values: np.ndarray, grid: np.ndarray, period: float) -> np.ndarray:
    """Means over a period about every instant of the grid; NaN in pauses."""
    steps = np.diff(t)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * steps)])
    ends = [np.clip(grid + side * period, t[0], t[-1]) for side in (-0.5, 0.5)]
    # The integral between samples is quadratic.
    low, high = (_integral(t, values, total, end) for end in ends)
    means = (high - low) / np.maximum(ends[1] - ends[0], 1e-12)
    before = np.clip(np.searchsorted(t, grid) - 1, 0, max(len(steps) - 1, 0))
    pause = steps[before] > max(_PAUSE_STEPS * float(np.median(steps)), _PAUSE, 1.5 * period)
    outside = (grid < t[0] - period) | (grid > t[-1] + period)
    return np.asarray(np.where(pause | outside, math.nan, means))


def _integral(t: np.ndarray, values: np.ndarray, total: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Integral from the first sample of what runs straight between samples."""
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    part = at - t[i]
    slope = (values[i + 1] - values[i]) / (t[i + 1] - t[i])
    return np.asarray(total[i] + part * (values[i] + 0.5 * part * slope))
