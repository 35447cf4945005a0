"""Sensors that hold one value while the vehicle moves on."""

from __future__ import annotations

import math

import numpy as np

from estimators.logs.log import Log
from estimators.logs.signals import longest_run, noise_sd, resolution

__all__ = ["stuck_while_moving"]

#: Share of logs in which samples of a sound channel repeat for as long as a stuck one.
_FALSE_ALARM = 1e-6
#: A vehicle that is faster shakes and turns its sensors [m/s].
_MOVING = 0.5
#: What a speed must change by elsewhere, and a heading by the gyro besides its bias [m/s, rad, rad/s].
_FASTER, _TURNED, _BIAS = 0.5, 0.1, 0.02

_RIMS = ("omega_f", "omega_r")
_SPEEDS = ("v_x", "speed", *_RIMS)
_SHAKEN = ("a_x", "a_y", "a_z", "roll_rate", "pitch_rate", "yaw_rate", *_RIMS)


def stuck_while_moving(log: Log, name: str) -> tuple[float, float] | None:
    """(From, to) [s] where a channel holds one value though what it measures changes; None if nowhere.

    Inputs, and slow angles, may rest.
    """
    t, values = log.samples(name)
    start, length = longest_run(values)
    span = float(t[start]), float(t[start + length - 1])
    outside = np.concatenate([values[:start], values[start + length :]])
    found = _unusual(outside, length) and _changes(log, name, values[start], span, outside)
    return span if found else None


def _unusual(outside: np.ndarray, length: int) -> bool:
    """Whether so long a run of equal samples is none that the channel makes elsewhere."""
    count = len(outside)
    if count < 2:
        return False
    longest = longest_run(outside)[1]
    again = (float(np.sum(np.diff(outside) == 0.0)) + 1.0) / (count + 1.0)
    rare = math.log(count) + (length - 1) * math.log(again) < math.log(_FALSE_ALARM)
    return rare and length > 5 * longest


def _changes(log: Log, name: str, value: float, span: tuple[float, float], outside: np.ndarray) -> bool:
    """Whether others show that the channel must have changed over the ``span`` [s]."""
    if name in _SHAKEN:
        # A wheel may be locked, and noise below the step of the numbers may not show.
        step = resolution(outside)
        shows = math.isnan(step) or noise_sd(outside) > step
        return shows and not (name in _RIMS and value == 0.0) and _speed(log, name, span)[0] > _MOVING
    if name in _SPEEDS:
        return _speed(log, name, span)[1] > _FASTER
    if name in ("x", "y"):
        other = "y" if name == "x" else "x"
        still = other not in log.channels or np.ptp(_within(log, other, span)) == 0.0
        return still and _speed(log, name, span)[0] > _MOVING
    if name in ("yaw", "course"):
        turned = abs(float(np.mean(_within(log, "yaw_rate", span)))) - _BIAS
        return turned * (span[1] - span[0]) > _TURNED
    return False


def _within(log: Log, name: str, span: tuple[float, float]) -> np.ndarray:
    """Samples of a channel over a span [s]; one zero where it has none."""
    if name not in log.channels:
        return np.zeros(1)
    t, values = log.samples(name)
    inside = values[(t >= span[0]) & (t <= span[1])]
    return inside if len(inside) else np.zeros(1)


def _speed(log: Log, name: str, span: tuple[float, float]) -> tuple[float, float]:
    """Least speed, and change of it, [m/s] over a span [s] by any channel but ``name``; 0 without one."""
    speeds = []
    for other in _SPEEDS:
        if other != name and other in log.channels:
            scale = log.vehicle.r if other in _RIMS else 1.0
            speeds.append(scale * _within(log, other, span))
    low = [float(np.median(np.abs(values))) for values in speeds]
    change = [float(np.diff(np.quantile(values, [0.05, 0.95]))[0]) for values in speeds]
    return min(low, default=0.0), min(change, default=0.0)
