"""What the charts and the tracks show of the past."""

from __future__ import annotations

import math

import numpy as np

from offroad_env.environment.snapshot import Snapshot
from offroad_env.physics import state as at

__all__ = ["History"]


class History:
    """What the charts and the tracks show of the past, one row a picture."""

    #: Columns. ``RUT_*``: middle of the rear axle [m].
    (TIME, N, MEAN, SD, SPEED, SLIP_F, SLIP_R, ERROR, RUT_X, RUT_Y, YAW) = range(11)
    _SIZE = 11

    def __init__(self) -> None:
        self._rows = np.empty((512, self._SIZE))
        self._count = 0

    @property
    def rows(self) -> np.ndarray:
        """(T, 11) in order of time."""
        return self._rows[: self._count]

    def add(self, snapshot: Snapshot) -> None:
        """Append this moment, unless it is there already."""
        if self._count and snapshot.time <= self._rows[self._count - 1, self.TIME]:
            return
        if self._count == len(self._rows):
            self._rows = np.concatenate((self._rows, np.empty_like(self._rows)))
        state, readings, estimate = snapshot.state, snapshot.readings, snapshot.estimate
        back = snapshot.plant.vehicle.l_r
        self._rows[self._count] = (
            snapshot.time,
            readings[at.EXPONENT],
            math.nan if estimate is None else estimate.mean,
            math.nan if estimate is None else estimate.sd,
            math.hypot(state[at.V_X], state[at.V_Y]),
            readings[at.SLIP],
            readings[at.AXLE + at.SLIP],
            snapshot.cross_track_error,
            state[at.X] - back * math.cos(state[at.YAW]),
            state[at.Y] - back * math.sin(state[at.YAW]),
            state[at.YAW],
        )
        self._count += 1

    def thinned(self, most: int) -> np.ndarray:
        """At most about ``most`` rows, the last one among them; which ones changes as rarely as possible."""
        rows = self.rows
        stride = 1
        while len(rows) > stride * most:
            stride *= 2
        return rows if stride == 1 else np.concatenate((rows[::stride], rows[-1:]))
