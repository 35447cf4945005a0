"""Stretches in which a vehicle is stuck: it stands while a wheel spins, or though its wheels are driven hard.

The wheels tell nothing of the speed there, and no law of a rolling vehicle holds.
"""

from __future__ import annotations

import numpy as np

from estimators.logs.log import Log
from offroad_env.physics.numerics import GRAVITY

__all__ = ["driven_time", "has_rolled", "only_spins", "stuck_spans"]

#: A vehicle that is slower stands, while a rim that is faster spins, and is so many times as fast [m/s, -].
_STANDS, _SPINS, _MORE = 0.3, 1.0, 4.0
#: A vehicle that stands without wheels that spin is driven by more than this share of its weight: on firm
#: ground it would gain 1 m/s every second. Idling, or a motor that holds it on a moderate slope, takes less.
_PUSHED = 0.1
#: Elsewhere a wheel must agree with the vehicle within this factor: else its unit or scale may be wrong.
_AGREES = 2.0
#: A vehicle that stands turns by less: wheels that spin may turn it on the spot [rad/s].
_TURNS = 0.2
#: Slower vehicles count as this fast: noise of a sensor that stands [m/s].
_LEAST_SPEED = 0.05
#: Windows, and the shortest stretch [s].
_LENGTH, _STEP, _SHORTEST = 1.0, 0.5, 3.0

#: A rim that rolls is as fast as the vehicle within this factor, in this share of the windows with motion and
#: in so many at least; it is slower by twice that in no more than the last share. So many windows tell it.
_ROLLS, _SOMETIMES, _TIMES, _SELDOM, _WINDOWS = 1.3, 0.02, 2, 0.1, 10
#: One factor stands between the vehicle and a rim with another unit or scale, but for slip. Where its outer
#: deciles are so far apart the rim spins more here than there.
_UNEVEN, _DECILES = 3.0, (0.1, 0.9)

#: So near to the speed of the vehicle is a rim that has rolled, for so long and in so many samples [-, s].
_ALIKE, _MOMENT, _SAMPLES = 1.5, 0.3, 5

_RIMS = ("omega_f", "omega_r")


def stuck_spans(log: Log) -> tuple[tuple[float, float], ...]:
    """(From, to) [s] of the stretches in which the vehicle is stuck.

    Without a sensor of the vehicle's own speed, the slower wheels show that it stands, and the gyro that it
    does not turn.
    """
    t = log.times
    starts = np.arange(t[0], t[-1] - _LENGTH, _STEP)
    rims = [log.vehicle.r * _means(log, name, starts) for name in _RIMS if _has(log, name)]
    if log.rig or not rims or len(starts) == 0:
        return ()
    body = _body_speeds(log, starts)
    if not body and len(rims) < 2:
        return ()
    fastest = np.max(rims, axis=0)
    slowest = np.max(body, axis=0) if body else np.min(rims, axis=0)
    stands = slowest < _STANDS
    if not body and _has(log, "yaw_rate"):
        stands &= _means(log, "yaw_rate", starts) < _TURNS
    spins = stands & (fastest > np.maximum(_SPINS, _MORE * slowest))
    stuck = stands & (fastest < _SPINS) & (_push(log, starts) > _PUSHED)
    if _is_slip(slowest, fastest, spins):
        stuck |= spins
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stuck.astype(int), [0]])))
    spans = [
        (float(starts[a]), float(starts[b - 1] + _LENGTH))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return tuple(span for span in spans if span[1] - span[0] >= _SHORTEST and _alive(log, span))


def _is_slip(body: np.ndarray, rims: np.ndarray, spins: np.ndarray) -> bool:
    """Whether rims (W,) that spin differ from the vehicle by their slip, and not by a unit or a scale.

    They agree while it moves, or are then far less ahead of it than where it stands: one factor is the same
    everywhere. A vehicle that digs in where it starts never rolls.
    """
    moves = (body > _STANDS) & ~spins
    if np.any(moves & (rims < _AGREES * body)):
        return True
    if not moves.any() or not spins.any():
        return False
    ahead = rims / np.maximum(body, _LEAST_SPEED)
    return bool(np.median(ahead[spins]) > _UNEVEN * np.median(ahead[moves]))


def _push(log: Log, starts: np.ndarray) -> np.ndarray:
    """Mean force of the drive over the windows, (W,) as a share of the weight; braking is negative."""
    total = np.zeros(len(starts))
    for name in (one for one in ("torque_f", "torque_r", "drive_force") if _has(log, one)):
        lever = 1.0 if name == "drive_force" else log.vehicle.r
        total += _signed_means(*log.samples(name), starts) / lever
    return total / (log.vehicle.m * GRAVITY)


def driven_time(log: Log) -> float:
    """Time in which the vehicle is not stuck [s]."""
    last = float(log.times[-1])
    return log.duration - sum(min(end, last) - begin for begin, end in stuck_spans(log))


def only_spins(rim: np.ndarray, speed: np.ndarray) -> bool:
    """Whether a rim differs from the vehicle by its slip alone: it rolls at times, or spins unevenly.

    A rim with another unit or scale rolls in none and differs by one factor, one of another sign rolls in
    none, and noise is often too slow.

    Parameters
    ----------
    rim, speed : (W,)
        Means [m/s] over windows.
    """
    known = np.isfinite(rim) & np.isfinite(speed) & (np.abs(speed) > _STANDS)
    if known.sum() < _WINDOWS:
        return False
    ratio = rim[known] / speed[known]
    rolls = int(np.sum(np.abs(np.log(np.maximum(ratio, 1e-9))) < np.log(_ROLLS)))
    enough = rolls >= max(_TIMES, _SOMETIMES * len(ratio))
    if not enough:
        least, most = np.quantile(ratio, _DECILES)
        enough = most > _UNEVEN * least > 0.0
    return bool(enough and np.mean(ratio < 1.0 / _ROLLS**2) < _SELDOM)


def has_rolled(log: Log, rim: str) -> bool:
    """Whether a rim was once about as fast as the vehicle without being braked: its unit is right.

    One with another unit agrees in no such moment, however the vehicle digs in later.
    """
    torque = rim.replace("omega", "torque")
    name = next((one for one in ("v_x", "speed") if _has(log, one)), None)
    if name is None or not _has(log, rim) or not _has(log, torque):
        return False
    t, omega = log.samples(rim)
    speed, push = (np.interp(t, *log.samples(one)) for one in (name, torque))
    fast = np.abs(speed) > _SPINS
    ratio = np.where(fast, log.vehicle.r * omega / np.where(fast, speed, 1.0), 0.0)
    rolls = (np.abs(np.log(np.maximum(ratio, 1e-9))) < np.log(_ALIKE)) & (push * speed > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rolls.astype(int), [0]])))
    runs = list(zip(edges[::2], edges[1::2], strict=True))
    return any(b - a >= _SAMPLES and t[b - 1] - t[a] >= _MOMENT for a, b in runs)


def _has(log: Log, name: str) -> bool:
    return name in log.channels and len(log.samples(name)[0]) >= 4


def _means(log: Log, name: str, starts: np.ndarray) -> np.ndarray:
    """Means of the absolute values of a channel over the windows, (W,): those of noise are not 0."""
    t, values = log.samples(name)
    return _signed_means(t, np.abs(values), starts)


def _signed_means(t: np.ndarray, values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.asarray((np.interp(starts + _LENGTH, t, total) - np.interp(starts, t, total)) / _LENGTH)


def _body_speeds(log: Log, starts: np.ndarray) -> list[np.ndarray]:
    """Speeds (W,) of the vehicle [m/s] by every sensor of its own motion."""
    found = [_means(log, name, starts) for name in ("v_x", "speed") if _has(log, name)]
    if _has(log, "x") and _has(log, "y"):
        way = []
        for name in ("x", "y"):
            t, values = log.samples(name)
            way.append(np.interp(starts + _LENGTH, t, values) - np.interp(starts, t, values))
        found.append(np.hypot(*way) / _LENGTH)
    return found


def _alive(log: Log, span: tuple[float, float]) -> bool:
    """Whether no sensor that shows the standing holds one value there: that one is stuck, not the vehicle."""
    for name in ("v_x", "speed", *_RIMS):
        if _has(log, name):
            t, values = log.samples(name)
            inside = values[(t >= span[0]) & (t <= span[1])]
            if len(inside) and np.ptp(inside) == 0.0:
                return False
    return True
