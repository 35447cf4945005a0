"""Damage to single channels of a log, to test what the quality checks of the data notice.

Each kind is what happens to real logs: another unit (a factor), an axis the other way (a sign), a sensor that
holds its last value, a loose contact (noise).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from estimators.logs.log import Log

__all__ = ["CORRUPTIONS", "corrupted", "corruptible"]

#: Factors by kind: milli units, degrees for radians, km/h for m/s, an axis turned about.
_FACTORS: Mapping[str, float] = MappingProxyType({"x1000": 1000.0, "x57.3": 57.3, "x3.6": 3.6, "sign": -1.0})
#: All kinds.
CORRUPTIONS = (*_FACTORS, "stuck", "stuck half", "noise")
#: Noise in standard deviations of the channel.
_LOUD = 3.0


def corruptible(log: Log) -> tuple[str, ...]:
    """Channels that hold more than one value: an axle without brakes has no torque to be wrong."""
    return tuple(name for name in log.channels if np.ptp(log.samples(name)[1]) > 0.0)


def corrupted(log: Log, channel: str, kind: str, *, seed: int = 0) -> Log:
    """The log with one channel damaged.

    Parameters
    ----------
    channel
        One of `corruptible`.
    kind
        One of `CORRUPTIONS`: a factor; "stuck" from the first sample, or "stuck half" from the middle of the
        log, at a value of the channel; "noise", white, of three standard deviations of the channel.
    """
    values = np.array(log.channels[channel])
    there = np.flatnonzero(~np.isnan(values))
    if kind in _FACTORS:
        values *= _FACTORS[kind]
    elif kind == "stuck":
        values[there] = values[there[len(there) // 2]]
    elif kind == "stuck half":
        late = there[len(there) // 2 :]
        values[late] = values[late[0]]
    elif kind == "noise":
        rng = np.random.default_rng(seed)
        values[there] += _LOUD * float(np.std(values[there])) * rng.standard_normal(len(there))
    else:
        raise ValueError(f"kind must be one of {', '.join(CORRUPTIONS)}, got {kind!r}")
    return replace(log, channels={**log.channels, channel: values})
