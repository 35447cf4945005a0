"""Has the soil changed? A whiteness test of the updates of eta.

The updates of a parameter by a filter whose model is right are white, and each has the variance that the
belief loses by it. Where their sum over a fading window is many of its standard deviations away from zero,
the parameter has changed. A change shows there within tenths of a second, in the size of the innovations
only after seconds.
"""

from __future__ import annotations

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["MOVE", "MOVE_VARIANCE", "OPEN", "WINDOW", "add_update", "has_changed"]

#: Columns of a window: sum of the updates of eta, the variance that it is expected to have, and for how long
#: the window has been open [s].
MOVE, MOVE_VARIANCE, OPEN = range(3)
WINDOW = 3


@kernel
def add_update(window: FloatArray, shift: float, variance: float, time: float, dt: float) -> None:
    """Take an update of eta and its expected variance into a window that fades over ``time`` [s]."""
    kept = 1.0 - dt / time
    window[MOVE] = kept * window[MOVE] + shift
    window[MOVE_VARIANCE] = kept * kept * window[MOVE_VARIANCE] + variance
    window[OPEN] += dt


@kernel
def has_changed(window: FloatArray, time: float, level: float) -> bool:
    """Whether the updates sum to more than ``level`` standard deviations after ``time`` [s] or more."""
    move = window[MOVE]
    changed: bool = move * move > level * level * window[MOVE_VARIANCE] and window[OPEN] > time
    return changed
