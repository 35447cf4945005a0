"""Where a window may begin: the states that sensors suggest, and how far these may be off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimators.logs.log import Log
from offroad_env.physics import state as at

__all__ = ["COURSE_SPEED", "FREE", "StartSensors"]

#: States that are free at the start of a window, with the standard deviations of their priors: generous,
#: only so that what a log does not show stays finite [m, rad, m/s, rad/s; rims in m/s].
FREE = {
    at.X: 3.0, at.Y: 3.0, at.YAW: 0.5, at.Z: 0.05, at.PITCH: 0.05, at.V_X: 2.0, at.V_Y: 0.5, at.V_Z: 0.3,
    at.PITCH_RATE: 0.3, at.YAW_RATE: 0.5, at.OMEGA_F: 1.0, at.OMEGA_R: 1.0,
}  # fmt: skip
#: Below this speed the course of a satellite receiver is noise [m/s].
COURSE_SPEED = 1.0
#: Half width of the mean that starts a window [s].
_NEAR = 0.15
#: Heading from a gyro alone: its standard deviation at first, and for every second the bias of a sound
#: gyro [rad, rad/s]. Over a longer pause between its samples the vehicle may turn unseen [s].
_TURNED, _DRIFT, _PAUSE = 0.005, 5e-4, 0.5

_RIMS = ("omega_f", "omega_r")


class _GyroHeading(NamedTuple):
    """Heading of a log that has no other sensor of it."""

    t: np.ndarray  #: (K,) [s]
    yaw: np.ndarray  #: (K,) [rad]
    lost: float  #: from here on nothing is known, infinite where it is to the end [s]

    def deviation(self, t: np.ndarray) -> np.ndarray:
        """Its standard deviation at ``t`` [s], [rad]."""
        drifted = np.hypot(_TURNED, _DRIFT * (t - self.t[0]))
        return np.where(t < self.lost, np.minimum(drifted, FREE[at.YAW]), FREE[at.YAW])


class StartSensors:
    """What the sensors of a drive tell of its state at an instant.

    Without a sensor of heading or position, the gyro's integral tells the heading: windows that were free to
    choose theirs would turn a slope of the ground into a sideways push of any size, each its own, and so
    explain scattering soil by a grade: beside a wrong rolling resistance one gained 28 to 52 more in the
    log-likelihood than the truth, on four soils, and with the gyro's heading 2 to 13.

    Parameters
    ----------
    radius
        Of the wheels [m].
    driven
        Whether the wheels' speeds are states; else they turn as measured.
    """

    def __init__(self, log: Log, *, radius: float, driven: bool) -> None:
        self._log, self._radius, self._driven = log, radius, driven
        self._heading = _gyro_heading(log)

    def spread(self, free: Sequence[int], t: np.ndarray) -> np.ndarray:
        """(W, S) standard deviations of the priors of ``free`` states at ``t`` (W,) [s]."""
        widths = [FREE[i] / (self._radius if i >= at.OMEGA_F else 1.0) for i in free]
        spread = np.tile(np.array(widths), (len(t), 1))
        if self._heading is not None and at.YAW in free:
            spread[:, list(free).index(at.YAW)] = self._heading.deviation(t)
        return spread

    def correct(self, x: np.ndarray, t: float) -> None:
        """Set the states that sensors measure near ``t`` [s]."""
        speed = self._near("v_x", t) or self._near("speed", t)
        rims = [self._near(name, t) for name in _RIMS]
        if speed is None and any(rim is not None for rim in rims):
            speed = self._radius * float(np.mean([rim for rim in rims if rim is not None]))
        if speed is not None:
            x[at.V_X] = speed
        for i, rim in enumerate(rims):
            if rim is not None and self._driven:
                x[at.OMEGA_F + i] = rim
        if (rate := self._near("yaw_rate", t)) is not None:
            x[at.YAW_RATE] = rate
        course = self._near("yaw", t)
        if course is None and speed is not None and speed > COURSE_SPEED:
            course = self._near("course", t)
            course = None if course is None else course - math.atan2(x[at.V_Y], x[at.V_X])
        if self._heading is not None and t < self._heading.lost:
            course = float(np.interp(t, self._heading.t, self._heading.yaw))
        if course is not None:
            x[at.YAW] += math.remainder(course - x[at.YAW], 2.0 * math.pi)
        for name, i in (("x", at.X), ("y", at.Y)):
            if (place := self._near(name, t)) is not None:
                x[i] = place

    def _near(self, name: str, t: float) -> float | None:
        """Mean of the samples about ``t`` [s], or None."""
        if name not in self._log.channels:
            return None
        times, values = self._log.samples(name)
        values = values[np.abs(times - t) <= _NEAR]
        if len(values) == 0:
            return None
        return float(np.unwrap(values).mean() if name in ("course", "yaw") else values.mean())


def _gyro_heading(log: Log) -> _GyroHeading | None:
    """Heading from the start by the gyro; None where another sensor tells it, or without a gyro."""
    if any(name in log.channels for name in ("yaw", "course", "x", "y")) or "yaw_rate" not in log.channels:
        return None
    t, rate = log.samples("yaw_rate")
    if len(t) < 2:
        return None
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    paused = np.flatnonzero(np.diff(t) > _PAUSE)
    lost = float(t[paused[0]]) if len(paused) else math.inf
    return _GyroHeading(t=t, yaw=log.config.start.yaw + turned, lost=lost)
