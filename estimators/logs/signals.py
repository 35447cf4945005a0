"""Irregular, multi-rate channels over common windows of time, so that they can be compared.

Nothing here is handed to a filter: interpolation serves the quality checks only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage, stats

from estimators.logs.immobile import stuck_spans
from estimators.logs.log import Log

__all__ = [
    "ChannelTiming",
    "Likeness",
    "Offset",
    "Windows",
    "jumps",
    "likeness",
    "longest_run",
    "noise_sd",
    "offset",
    "resolution",
    "roll_back",
    "timing",
    "uninterrupted",
    "unwrapped",
]

#: Speed from positions: over how long, and what surrounds it [s].
_SPAN, _AROUND = 0.2, 0.5
#: No wheeled vehicle is so much faster than half a second before and after: 1 g over that time [m/s].
_JUMP = 5.0
#: Grid on which positions and offsets are interpolated [s].
_GRID = 0.02
#: A step between rows longer than this many usual ones, and than this [s], interrupts the run.
_PAUSE_STEPS, _SHORTEST_PAUSE = 5.0, 0.15
#: Wheels that turn backwards faster roll back [rad/s].
_ROLLS_BACK = 0.5
#: A speed that is further below zero has a sign [m/s]; correlation from which a law says which way it goes.
_BACKWARDS, _SAYS = 0.5, 0.5
_LONGEST_GAP = 0.25  # a window with a longer silence than this (or 3 steps) is left out [s]


class ChannelTiming(NamedTuple):
    """When a channel has samples."""

    rate: float  #: samples per second, from the median step [Hz]
    jitter: float  #: standard deviation of the steps without gaps [s]
    gaps: int  #: steps longer than five times the median
    longest_gap: float  #: [s]
    gap_at: float  #: where the longest gap begins [s]


def timing(t: np.ndarray) -> ChannelTiming:
    """Rate, jitter and gaps of the stamps ``t`` [s]."""
    if len(t) < 2:
        return ChannelTiming(0.0, 0.0, 0, 0.0, float(t[0]) if len(t) else 0.0)
    step = np.diff(t)
    typical = float(np.median(step))
    long = step > 5.0 * typical
    worst = int(np.argmax(step))
    return ChannelTiming(
        rate=1.0 / typical,
        jitter=float(np.std(step[~long])),
        gaps=int(long.sum()),
        longest_gap=float(step[worst]) if long.any() else 0.0,
        gap_at=float(t[worst]),
    )


def noise_sd(values: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth signal, from second differences; robust to spikes.

    For white noise of variance s^2 the second difference has 6 s^2.
    """
    if len(values) < 8:
        return math.nan
    second = np.diff(values, 2)
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / math.sqrt(6.0))


def resolution(values: np.ndarray) -> float:
    """Step of the numbers (quantisation), or NaN where they have none.

    Starts at the smallest difference and sharpens it on ever larger multiples, since files round.
    """
    distinct = np.unique(np.abs(values))
    if len(distinct) < 8 or distinct[-1] == 0.0:
        return math.nan
    steps = np.diff(distinct)
    q = float(np.median(steps[steps < 1.5 * steps.min()]))
    reach = 8.0 * q
    while reach < 2.0 * distinct[-1]:
        near = distinct[(distinct <= reach) & (distinct > 0.5 * q)]
        multiple = np.round(near / q)
        if len(near):
            q = float(near @ multiple / (multiple @ multiple))
        reach *= 2.0
    off = np.abs(distinct / q - np.round(distinct / q))
    coarse = distinct[-1] / q < 1e5  # beyond, every double is near a multiple
    return q if coarse and float(np.mean(off < 0.1)) > 0.98 else math.nan


def longest_run(values: np.ndarray) -> tuple[int, int]:
    """(start, length) of the longest run of equal values."""
    change = np.flatnonzero(np.diff(values) != 0.0) + 1
    edges = np.concatenate([[0], change, [len(values)]])
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    return int(edges[longest]), int(lengths[longest])


def unwrapped(angle: np.ndarray) -> np.ndarray:
    """The angle without jumps of a full turn, whether the turn is 2 pi or, by mistake, 360."""
    spread = float(np.ptp(angle)) if len(angle) else 0.0
    if spread <= 2.1 * math.pi:
        return np.unwrap(angle)
    return np.unwrap(angle, period=360.0) if 300.0 < spread <= 361.0 else angle


def jumps(log: Log) -> list[tuple[float, float]]:
    """Times (from, to) [s] at which the logged position moves as no vehicle can."""
    if not {"x", "y"} <= set(log.channels):
        return []
    t = log.samples("x")[0]
    if t[-1] - t[0] < 2.0 * _AROUND:
        return []
    grid = np.arange(t[0], t[-1] + 0.5 * _GRID, _GRID)
    ends = (grid - 0.5 * _SPAN, grid + 0.5 * _SPAN)
    moved = [np.diff([np.interp(end, *log.samples(name)) for end in ends], axis=0)[0] for name in ("x", "y")]
    speed = np.hypot(*moved) / _SPAN
    usual = ndimage.median_filter(speed, round(2.0 * _AROUND / _GRID) + 1, mode="nearest")
    sd = 0.0 if log.config.gnss is None else log.config.gnss.sd_position
    wild = np.flatnonzero(speed - usual > max(_JUMP, 6.0 * math.sqrt(2.0) * sd / _SPAN))
    if not len(wild):
        return []
    groups = np.split(wild, np.flatnonzero(np.diff(wild) * _GRID > _AROUND) + 1)
    return [(float(grid[g[0]]) - _SPAN, float(grid[g[-1]]) + _SPAN) for g in groups]


def uninterrupted(log: Log, times: np.ndarray) -> np.ndarray:
    """Which of the ``times`` (K,) [s] lie neither in a gap of the log nor where its position jumps."""
    t = log.times
    before = np.clip(np.searchsorted(t, times) - 1, 0, len(t) - 2)
    steps = np.diff(t)
    fine = steps[before] <= max(_PAUSE_STEPS * float(np.median(steps)), _SHORTEST_PAUSE)
    for start, stop in jumps(log):
        fine &= (times < start) | (times > stop)
    return np.asarray(fine)


def roll_back(t: np.ndarray, rims: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Whether all wheels turn backwards at ``t`` [s]; ``rims``: times [s] and speeds [rad/s] of each."""
    found = [np.interp(t, times, values) < -_ROLLS_BACK for times, values in rims if len(times)]
    return np.all(found, axis=0) if found else np.zeros(len(t), dtype=bool)


class Windows:
    """Windows of one length over a log, half overlapping; NaN where the vehicle is stuck."""

    def __init__(self, log: Log, length: float = 1.0) -> None:
        self.log, self.length = log, length
        self._stuck = stuck_spans(log)
        t = log.times
        self.starts = np.arange(t[0], t[-1] - length, 0.5 * length)

    def _series(self, name: str) -> tuple[np.ndarray, np.ndarray] | None:
        if name not in self.log.channels:
            return None
        t, values = self.log.samples(name)
        return (t, values) if len(t) >= 4 else None

    def _blank_gaps(self, t: np.ndarray, result: np.ndarray) -> np.ndarray:
        """NaN for windows that touch a gap, or where the channel has not begun or has ended."""
        step = np.diff(t)
        limit = max(_LONGEST_GAP, 3.0 * float(np.median(step)))
        result = result.copy()
        ends = self.starts + self.length
        result[(self.starts < t[0] - limit) | (ends > t[-1] + limit)] = math.nan
        for i in np.flatnonzero(step > limit):
            result[(self.starts < t[i + 1]) & (ends > t[i])] = math.nan
        for begin, end in self._stuck:
            result[(self.starts < end) & (ends > begin)] = math.nan
        return result

    def mean(self, name: str) -> np.ndarray | None:
        """Mean of a channel over each window (trapezium rule), NaN where it has a gap.

        A speed over ground without a sign has that of the direction of travel.
        """
        return self._signed(name, self._mean(name))

    def _signed(self, name: str, values: np.ndarray | None) -> np.ndarray | None:
        unsigned = name == "speed" and values is not None and self._has_no_sign
        return values * self.direction if unsigned and values is not None else values

    def _mean(self, name: str) -> np.ndarray | None:
        series = self._series(name)
        if series is None:
            return None
        t, values = series
        total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
        begin, end = (np.interp(at, t, total) for at in (self.starts, self.starts + self.length))
        return self._blank_gaps(t, (end - begin) / self.length)

    def slope(self, name: str, *, angle: bool = False) -> np.ndarray | None:
        """Change of a channel over each window divided by its length; of a speed as `mean` has it."""
        return self._signed(name, self._slope(name, angle=angle))

    def _slope(self, name: str, *, angle: bool = False) -> np.ndarray | None:
        series = self._series(name)
        if series is None:
            return None
        t, values = series
        values = unwrapped(values) if angle else values
        begin, end = (np.interp(at, t, values) for at in (self.starts, self.starts + self.length))
        return self._blank_gaps(t, (end - begin) / self.length)

    def displacement(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Mean velocity over ground (X, Y) in each window [m/s]."""
        x, y = self.slope("x"), self.slope("y")
        return None if x is None or y is None else (x, y)

    def travel(self) -> np.ndarray | None:
        """Speed of the position x, y in each window [m/s], below zero where the vehicle drives backwards."""
        way = self._way()
        return None if way is None else way * self.direction

    def _way(self) -> np.ndarray | None:
        velocity = self.displacement()
        return None if velocity is None else np.hypot(*velocity)

    @cached_property
    def _has_no_sign(self) -> bool:
        speed = self._mean("speed")
        return speed is not None and not (speed < -_BACKWARDS).any()

    @cached_property
    def direction(self) -> np.ndarray:
        """-1 in windows in which the vehicle drives backwards, by its wheels or v_x, otherwise 1; (W,).

        A speed over ground or a path has no sign: as a forward speed it would make every channel of a drive
        in reverse contradict it. Wheels whose own sign is reversed contradict steering, accelerations,
        torques and heading instead: then nothing is backwards.
        """
        forwards = np.ones(len(self.starts))
        signed = [self._mean("v_x"), *(self._mean(name) for name in ("omega_f", "omega_r"))]
        sources = [values for values in signed if values is not None]
        ground = self._mean("speed") if self._has_no_sign else self._way()
        if not sources or ground is None:
            return forwards
        back = np.all([np.where(np.isfinite(values), values, -1.0) < 0.0 for values in sources], axis=0)
        back &= np.any([np.isfinite(values) for values in sources], axis=0)
        votes = self._votes(np.where(back & (np.abs(ground) > _BACKWARDS), ground, math.nan))
        return np.where(back, -1.0, 1.0) if not votes or sum(votes) > 0 else forwards

    def _votes(self, ground: np.ndarray) -> list[int]:
        """1 for each law by which ``ground`` [m/s] (W,), NaN elsewhere, is a speed backwards, -1 against."""
        turn, steer = self._mean("yaw_rate"), self._mean("steer")
        change = self._slope("speed") if self._has_no_sign else None
        pairs = [
            (turn, None if steer is None else ground * steer),
            (self._mean("a_y"), None if turn is None else ground * turn),
            (self._mean("a_x"), None if change is None else np.where(np.isnan(ground), math.nan, change)),
        ]
        seen = [likeness(one, other) for one, other in pairs if one is not None and other is not None]
        votes = [-1 if one.factor > 0.0 else 1 for one in seen if one and abs(one.correlation) > _SAYS]
        torques = [self._mean(name) for name in ("torque_f", "torque_r", "drive_force")]
        # On the whole a drive takes power: its torques point where it goes.
        work = sum(float(np.nansum(torque * ground)) for torque in torques if torque is not None)
        velocity, yaw = self.displacement(), self._mean("yaw")
        if velocity is not None and yaw is not None:
            ahead = np.cos(np.arctan2(velocity[1], velocity[0]) - yaw)[np.isfinite(ground)]
            ahead = ahead[np.isfinite(ahead)]
            votes += [-int(np.sign(np.median(ahead)))] if len(ahead) and abs(np.median(ahead)) > _SAYS else []
        return votes + ([-int(np.sign(work))] if work else [])

    def course_rate(self) -> np.ndarray | None:
        """Turning rate of the direction of travel [rad/s]: from the window before to the one after."""
        velocity = self.displacement()
        if velocity is None:
            return None
        moved = np.hypot(*velocity) * self.length
        gnss = self.log.config.gnss
        # Ten standard deviations: the direction is then known to about 0.1 rad.
        enough = moved > 10.0 * (gnss.sd_position if gnss else 0.05)
        course = np.where(enough, np.arctan2(velocity[1], velocity[0]), math.nan)
        # Windows overlap by half, so those two before and after share no sample with each other.
        turn = np.full(len(course), math.nan)
        if len(course) < 3:
            return turn
        change = course[2:] - course[:-2]
        turn[1:-1] = np.arctan2(np.sin(change), np.cos(change)) / self.length
        return turn

    @staticmethod
    def as_course_rate(rate: np.ndarray) -> np.ndarray:
        """The window means ``rate`` smoothed as `course_rate` is: it takes the mean course of two windows."""
        smooth = np.full(len(rate), math.nan)
        if len(rate) >= 3:
            smooth[1:-1] = 0.25 * rate[:-2] + 0.5 * rate[1:-1] + 0.25 * rate[2:]
        return smooth


class Likeness(NamedTuple):
    """Agreement of two signals."""

    factor: float  #: first over second, with sign
    correlation: float
    windows: int  #: how many windows have both


def likeness(first: np.ndarray, second: np.ndarray, *, centred: bool = False) -> Likeness | None:
    """Compare two signals over the windows that have both; None with fewer than ten.

    Without ``centred`` a constant turn counts as evidence, with it only what varies. The factor is
    the ratio of root mean squares, which noise on either side shifts less than a regression.
    """
    both = np.isfinite(first) & np.isfinite(second)
    if both.sum() < 10:
        return None
    a, b = first[both], second[both]
    # The largest 2 % are left to spikes and to jumps of a filter.
    kept = (np.abs(a) <= np.quantile(np.abs(a), 0.98)) & (np.abs(b) <= np.quantile(np.abs(b), 0.98))
    a, b = a[kept], b[kept]
    if centred:
        a, b = a - a.mean(), b - b.mean()
    power_a, power_b = float(a @ a), float(b @ b)
    if min(power_a, power_b) <= 0.0:
        return None
    correlation = float(a @ b) / math.sqrt(power_a * power_b)
    factor = math.copysign(math.sqrt(power_a / power_b), correlation)
    return Likeness(factor, correlation, int(both.sum()))


class Offset(NamedTuple):
    """By how much the second signal comes after the first."""

    delay: float  #: [s]
    error: float  #: standard error over blocks of the log [s]
    correlation: float
    sure: bool  #: whether the blocks agree that it is not zero


#: Largest delay that is sought [s], and blocks of a log.
_REACH, _BLOCKS = 0.6, 5


def offset(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> Offset | None:
    """Delay of ``second`` after ``first``, each (times, values), by cross-correlation in blocks.

    None where more than one block of the log shows no clear peak.
    """
    if min(len(first[0]), len(second[0])) < 8:
        return None
    begin, end = max(first[0][0], second[0][0]), min(first[0][-1], second[0][-1])
    if end - begin < _BLOCKS * 4.0:
        return None
    grid = np.arange(begin, end, _GRID)
    a, b = (_smooth(np.interp(grid, *series)) for series in (first, second))
    found = [_peak(x, y) for x, y in zip(np.array_split(a, _BLOCKS), np.array_split(b, _BLOCKS), strict=True)]
    peaks = np.array([peak for peak in found if peak is not None])
    if len(peaks) < _BLOCKS - 1:
        return None
    delay, error = float(np.mean(peaks[:, 0])), float(np.std(peaks[:, 0], ddof=1)) / math.sqrt(len(peaks))
    # Few blocks know their own scatter badly: Student's t, two-sided 0.2 %, for logs without an offset.
    sure = abs(delay) > float(stats.t.ppf(0.999, len(peaks) - 1)) * error
    return Offset(delay, error, float(np.median(peaks[:, 1])), sure)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Two moving averages over 0.2 s: symmetric, so they delay nothing."""
    kernel = np.ones(11) / 11.0
    for _ in range(2):
        values = np.convolve(np.pad(values, 5, mode="edge"), kernel, mode="valid")
    return values


def _peak(a: np.ndarray, b: np.ndarray) -> tuple[float, float] | None:
    """(delay of b [s], correlation) at the highest correlation, between grid points by a parabola."""
    reach = round(_REACH / _GRID)
    core = a[reach:-reach] - a[reach:-reach].mean()
    if len(core) < 4 * reach or not core.any():
        return None
    shifts = np.arange(-reach, reach + 1)
    values = np.zeros(len(shifts))
    for i, shift in enumerate(shifts):
        other = b[reach + shift : len(b) - reach + shift]
        other = other - other.mean()
        power = float(core @ core) * float(other @ other)
        values[i] = float(core @ other) / math.sqrt(power) if power > 0.0 else 0.0
    best = int(np.argmax(values))
    if values[best] < 0.8 or best in (0, len(shifts) - 1):
        return None
    left, middle, right = values[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    fine = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return (float(shifts[best]) + fine) * _GRID, float(middle)
