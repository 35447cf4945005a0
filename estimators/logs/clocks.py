"""Channels that show one motion at different times: two clocks, or a filter that delays."""

from __future__ import annotations

import numpy as np

from estimators.logs.log import Log
from estimators.logs.signals import Offset, offset, unwrapped
from estimators.logs.units import Finding

__all__ = ["clock_findings", "pose_age"]

#: Least offset between two clocks that is reported [s].
_LEAST = 0.015

_Series = tuple[np.ndarray, np.ndarray]


def _significant(found: Offset | None) -> Offset | None:
    """The offset, if it is certain and not negligible."""
    return found if found is not None and found.sure and abs(found.delay) >= _LEAST else None


def pose_age(log: Log) -> float:
    """Age of a heading, and so of the position that comes with it, beyond its stamp [s].

    The heading is the integral of the yaw rate, whatever the vehicle, so the sensors
    determine the age without any model. Zero where they do not; a heading that seems early is a late gyro.
    """
    turns = _turns(log)
    found = None if turns is None else _significant(offset(*turns))
    return 0.0 if found is None else max(found.delay, 0.0)


def _turns(log: Log) -> tuple[_Series, _Series] | None:
    """The yaw rate by the gyro and by the change of the heading."""
    if not {"yaw", "yaw_rate"} <= set(log.channels):
        return None
    t, yaw = log.samples("yaw")
    return log.samples("yaw_rate"), (0.5 * (t[1:] + t[:-1]), np.diff(unwrapped(yaw)) / np.diff(t))


def clock_findings(log: Log, untrusted: set[str]) -> list[Finding]:
    """Channels that show one motion at different times."""
    findings = []
    for first, second, pair in _clock_pairs(log, untrusted):
        found = _significant(offset(*pair))
        if found is None:
            continue
        late = f"{abs(found.delay):.3f} s {'after' if found.delay > 0.0 else 'before'}"
        response = first == "steer"
        cause = (
            "dead time and lag of steering and vehicle, or two clocks"
            if response
            else "two clocks, or a filter that delays"
        )
        if second == "yaw" and found.delay > 0.0:
            cause += "; a diagnosis corrects the pose for it"
        findings.append(
            Finding(
                kind="clock",
                channel=second,
                severity="note" if response else "warning",
                sentence=f"{second} comes {late} {first} (standard error {found.error:.3f} s): {cause}",
                numbers={"delay": found.delay, "error": found.error, "correlation": found.correlation},
            )
        )
    return findings


def _clock_pairs(log: Log, untrusted: set[str]) -> list[tuple[str, str, tuple[_Series, _Series]]]:
    """(first, second, series): two channels with the same motion, each as times and values."""
    turns = _turns(log)
    pairs = [] if turns is None else [("yaw_rate", "yaw", turns)]
    speed = next((name for name in ("v_x", "speed") if name in log.channels), None)
    if speed is not None and "a_x" in log.channels and "a_x" not in untrusted:
        t, values = log.samples(speed)
        pairs.append(
            (speed, "a_x", ((0.5 * (t[1:] + t[:-1]), np.diff(values) / np.diff(t)), log.samples("a_x")))
        )
    # Wheel speed is accurate enough for the rate of turn, but not for a_x: a wheel spins up before it pulls.
    wheel = next((name for name in ("omega_r", "omega_f") if name in log.channels), None)
    if wheel is None or "yaw_rate" not in log.channels:
        return pairs
    (t, omega), (steer_t, steer) = log.samples(wheel), log.samples("steer")
    steered = np.interp(steer_t, t, omega) * np.tan(steer)
    if np.ptp(steered) > 0.0 and len(steer_t) >= 4:
        pairs.append(("steer", "yaw_rate", ((steer_t, steered), log.samples("yaw_rate"))))
    return pairs
