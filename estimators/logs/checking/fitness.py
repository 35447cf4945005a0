"""What each command can do with a log, and what it cannot judge."""

from __future__ import annotations

import numpy as np

from estimators.log_estimation import log_samples
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.log import Log
from estimators.logs.schema import IMU
from estimators.logs.substitutes import substituted
from offroad_env.errors import DataError

__all__ = ["fitness", "uneven", "unjudged"]

#: Rates that a filter takes [Hz], the one to which a slower IMU is brought, and the shortest log of a
#: diagnosis [s].
_FILTER, _SLOWEST, _SHORTEST = (50.0, 1000.0), 50.0, 3.0
_UNJUDGED = {
    "a_x": "estimate takes the change of speed in its place; a diagnosis does not compare it",
    "a_y": "estimate takes speed x yaw_rate; side slip is not judged",
    "a_z": "the axles are taken to carry their static load; vertical motion is not judged",
    "pitch_rate": "pitching, springs and the height of the IMU are not judged",
    "yaw_rate": "estimate takes the change of yaw, or speed and steering; steering is judged less",
}


def unjudged(log: Log) -> list[Remark]:
    """What cannot be judged, because a channel is missing."""
    if log.rig:
        return []
    found = [
        Remark(severity="note", sentence=f"there is no {name}: {_UNJUDGED[name]}")
        for name in IMU
        if name not in log.channels
    ]
    return found + [Remark(severity="warning", sentence=note) for note in log.config.notes]


def uneven(log: Log) -> Remark | None:
    """An even rate for an IMU that samples too slowly or unevenly for a filter; None where it needs none."""
    if log.rig or log.config.soil.rigid > 0.5 or log.imu.rate is not None or not _driven(log):
        return None
    try:
        complete, _ = substituted(log)
        log_samples(complete)
    except DataError as error:
        reason = str(error).partition(": ")[2]
        if "imu.rate" not in reason:
            return None
        own = _own_rate(log)
        rate = float(np.clip(round(own), *_FILTER))
        slower = f"; the {own:.3g} Hz hold less than filters with {rate:g} Hz take" if own < _SLOWEST else ""
        return Remark(
            severity="problem",
            sentence=f"{reason.partition(' - ')[0]}{slower}",
            lines=(Line("imu.rate", f"{rate:g} Hz"),),
        )
    return None


def _driven(log: Log) -> bool:
    return bool({"torque_f", "torque_r", "drive_force"} & set(log.channels))


def _own_rate(log: Log) -> float:
    """Samples per second of the channel of the IMU that has most."""
    rates = []
    for name in IMU:
        if name in log.channels and len(t := log.samples(name)[0]) > 1:
            rates.append(1.0 / float(np.median(np.diff(t))))
    return max(rates, default=_SLOWEST)


def fitness(log: Log) -> dict[str, str]:
    """Command -> "" where it takes the log, or why it does not."""
    if log.rig:
        return {"estimate": "trials of a wheel rig have no time", "diagnose": "", "replay": "no drive"}
    speeds = {"x", "v_x", "speed", "omega_f", "omega_r"} & set(log.channels)
    no_drive = (
        ""
        if _driven(log)
        else "needs torque_f, torque_r or drive_force (a motor current: units.torque_r: 0.3 N m)"
    )
    short = log.duration < _SHORTEST
    too_short = f"lasts {log.duration:.3g} s, needs {_SHORTEST:g} s" if short else ""
    return {
        "estimate": no_drive or too_short or _estimate(log),
        "diagnose": too_short,
        "replay": no_drive or ("" if speeds else "needs a position or a speed"),
    }


def _estimate(log: Log) -> str:
    if log.config.soil.rigid > 0.5:
        return "hard ground has no sinkage exponent to estimate"
    drive = {"full": "torque", "paper": "force"}[log.config.model]
    if log.config.drivetrain != drive:
        return f"model {log.config.model} is driven by {drive}, but drivetrain is {log.config.drivetrain}"
    try:
        complete, _ = substituted(log)
        log_samples(complete)
    except DataError as error:
        return str(error).partition(": ")[2]
    return ""
