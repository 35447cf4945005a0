"""Units that no law decides, because the drive hardly turns: by noise and by size."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from estimators.logs.checking.mends import Line, Remark
from estimators.logs.log import Log
from estimators.logs.mounting import GYROS
from estimators.logs.quality import QualityReport
from estimators.logs.signals import Windows

__all__ = ["weak_unit_remarks"]

#: Noise of a gyro in deg/s over the stated one in rad/s: 57.3, and a third more or less.
_NOISE = (43.0, 76.0)
#: A vehicle that steers turns; by this factor less it does not even on the softest soil.
_STEERS = 8.0
#: From this ratio on an angle in degrees, 57.3 times as large, is likelier than that of a steering wheel.
_DEGREES = 30.0


def weak_unit_remarks(
    log: Log, report: QualityReport, sources: Callable[[str], tuple[str, ...]]
) -> list[Remark]:
    """Gyros in deg/s by their noise, a steering angle in degrees by a vehicle that hardly turns.

    Parameters
    ----------
    sources
        Columns of the file behind a channel.
    """
    stated = {column for column, _ in log.config.units}
    remarks = []
    gyros = [name for name, _ in GYROS if name in log.channels]
    ratios = {
        f.channel: f.numbers["measured"] / f.numbers["stated"] for f in report.findings if f.kind == "noise"
    }
    if gyros and all(_NOISE[0] < ratios.get(name, 0.0) < _NOISE[1] for name in gyros):
        columns = [column for name in gyros for column in sources(name) if column not in stated]
        ratio = float(np.median([ratios[name] for name in gyros]))
        remarks.append(
            _remark(
                f"the noise of {', '.join(gyros)} is {ratio:.0f} times the stated one: in deg/s",
                columns,
                "deg/s",
            )
        )
    ratio = _steered_over_turned(log)
    if ratio > _STEERS and "steer" not in stated:
        more = f"steer would turn the vehicle {ratio:.0f} times as much as it turns"
        kind, unit = "in degrees", "deg"
        # Turns in deg/s, too, would seem 57 times as large.
        if not remarks and ratio < _DEGREES:
            kind, unit = (
                "the angle of a steering wheel? State its ratio to the wheels",
                f"{1.0 / ratio:.2g} rad",
            )
        remarks.append(_remark(f"{more}: {kind}", list(sources("steer")), unit))
    return [remark for remark in remarks if remark.lines]


def _remark(sentence: str, columns: list[str], unit: str) -> Remark:
    lines = tuple(Line(f"units.{column}", unit) for column in dict.fromkeys(columns))
    return Remark(severity="problem", sentence=sentence, lines=lines)


def _steered_over_turned(log: Log) -> float:
    """Spread of speed x steer / wheelbase over that of the yaw rate; 0 if unknown."""
    windows, vehicle = Windows(log), log.vehicle
    steer, turn = windows.mean("steer"), windows.mean("yaw_rate")
    speed = next((m for name in ("v_x", "speed") if (m := windows.mean(name)) is not None), None)
    if speed is None:
        rim = next((m for name in ("omega_r", "omega_f") if (m := windows.mean(name)) is not None), None)
        speed = None if rim is None else vehicle.r * rim
    if steer is None or turn is None or speed is None:
        return 0.0
    steered = speed * steer / (vehicle.l_f + vehicle.l_r)
    both = np.isfinite(steered) & np.isfinite(turn)
    if both.sum() < 10:
        return 0.0
    spread = float(np.std(turn[both]))
    return float(np.std(steered[both])) / spread if spread > 0.0 else math.inf
