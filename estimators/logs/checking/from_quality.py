"""Lines that mend what the quality checks of the data find."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from estimators.logs.checking.columns import STEERING_WHEELS
from estimators.logs.checking.conventions import is_compass
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.checking.weak_evidence import weak_unit_remarks
from estimators.logs.log import Log
from estimators.logs.mounting import ACCELEROMETERS, GYROS
from estimators.logs.quality import QualityReport
from estimators.logs.schema import VEHICLE_INPUTS
from estimators.logs.stuck import stuck_while_moving
from estimators.logs.unit_conversion import conversion
from estimators.logs.units import Finding
from offroad_env.errors import InvalidParameter

__all__ = ["quality_remarks", "sources_of"]

#: Columns of a file from which a channel of the log may have been computed.
_RAW = {
    "yaw_rate": ("gyro_z",), "pitch_rate": ("gyro_y",), "roll_rate": ("gyro_x",),
    "omega_f": ("omega_fl", "omega_fr", "omega_left", "omega_right", "omega"),
    "omega_r": ("omega_rl", "omega_rr", "omega_left", "omega_right", "omega"),
    "torque_f": ("torque_fl", "torque_fr", "torque_total"), "torque_r": ("torque_rl", "torque_rr",
    "torque_total"),
    "x": ("longitude",), "y": ("latitude",),
}  # fmt: skip
_TRIADS = (tuple(name for name, _ in ACCELEROMETERS), tuple(name for name, _ in GYROS))
_RIM = "m/s (a rim speed)"
_STEERED = "yaw_rate against speed x steer / wheelbase"
#: Least correlation, and factors from which a steering angle is taken to be that of the steering wheel: any,
#: or one with an assumed ratio. No steering gear has a smaller ratio, and wheels that plough halve the turn.
_FOLLOWS, _SCALED, _ASSUMED = 0.9, 5.0, 1.6


def sources_of(log: Log, channel: str, files: frozenset[str]) -> tuple[str, ...]:
    """Columns of the file behind a channel: before mounting, wheels and sides were put together."""
    axes = log.imu.orientation
    for triad in _TRIADS:
        if channel in triad and axes is not None:
            row = axes[triad.index(channel)]
            channel = triad[max(range(3), key=lambda i: abs(row[i]))]
            break
    if channel in files:
        return (channel,)
    return tuple(name for name in _RAW.get(channel, ()) if name in files)


def quality_remarks(log: Log, report: QualityReport, files: frozenset[str]) -> list[Remark]:
    """The problems of the data that a line mends, of one kind: units, then frame, signs, stuck sensors."""
    units = [f for f in report.problems if f.kind == "unit" and f.suspected_unit]
    if units:
        found = [_unit_remark(log, finding, files) for finding in units]
        return _whole_triads(log, [remark for remark in found if remark is not None], files)
    for kind in ("frame", "sign", "stuck"):
        remarks = [
            remark
            for f in report.problems
            if f.kind == kind and (remark := _others(log, f, files)) is not None
        ]
        if remarks:
            return remarks
    weak = weak_unit_remarks(log, report, lambda channel: sources_of(log, channel, files))
    return weak or _steering_scale(log, report)


def _steering_scale(log: Log, report: QualityReport) -> list[Remark]:
    """A steering angle that is not that of the road wheels: the scale that fits the turns."""
    check = next((check for check in report.checks if check.name == _STEERED), None)
    stated = dict(log.config.units).get("steer")
    assumed = stated in STEERING_WHEELS.values()
    if check is None or abs(check.correlation) < _FOLLOWS or not math.isfinite(check.factor):
        return []
    factor = abs(check.factor)
    if abs(math.log(factor)) < math.log(_ASSUMED if assumed else _SCALED):
        return []
    unit = _combined(log, "steer", f"{factor:.6g} rad")
    if unit is None:
        return []
    return [
        Remark(
            severity="problem",
            sentence=(
                f"the vehicle turns {factor:.3g} times as much as steer and wheelbase have it (correlation "
                f"{check.correlation:.2f}): steer is not the angle of the road wheels; a steering ratio "
                "that is known is better than this line"
            ),
            lines=(Line("units.steer", unit),),
        )
    ]


def _unit_remark(log: Log, finding: Finding, files: frozenset[str]) -> Remark | None:
    unit = "m/s" if finding.suspected_unit == _RIM else finding.suspected_unit
    assert unit is not None  # only such findings are passed
    lines = []
    for column in sources_of(log, finding.channel, files):
        text = _combined(log, column, unit)
        if text is not None:
            lines.append(Line(f"units.{column}", text))
    if finding.channel in ("x", "y"):
        lines = [Line(f"units.{name}", unit) for name in ("x", "y") if name in files]
    return Remark(severity="problem", sentence=finding.sentence, lines=tuple(lines)) if lines else None


def _combined(log: Log, column: str, unit: str) -> str | None:
    """The unit to state for a column whose values, as they were converted, are in ``unit``."""
    stated = dict(log.config.units).get(column)
    if stated is None:
        return unit
    try:
        once, more = (conversion(text, VEHICLE_INPUTS[column]) for text in (stated, unit))
    except InvalidParameter:
        return None
    factor = once.factor * more.factor
    return None if once.over_radius or more.over_radius else f"{factor:.6g} {VEHICLE_INPUTS[column].unit}"


def _whole_triads(log: Log, remarks: list[Remark], files: frozenset[str]) -> list[Remark]:
    """The same unit for all axes of one sensor, where the file does not state theirs."""
    stated = {column for column, _ in log.config.units}
    named = {line.key.removeprefix("units.") for remark in remarks for line in remark.lines}
    result = list(remarks)
    for axes in (_TRIADS[0], ("gyro_x", "gyro_y", "gyro_z"), _TRIADS[1]):
        units = {
            str(line.value) for r in remarks for line in r.lines if line.key.removeprefix("units.") in axes
        }
        rest = [name for name in axes if name in files and name not in named | stated]
        if len(units) == 1 and rest:
            (unit,) = units
            sentence = f"{', '.join(rest)}: of the same sensor, so in {unit}, too"
            lines = tuple(Line(f"units.{name}", unit) for name in rest)
            result.append(Remark(severity="problem", sentence=sentence, lines=lines))
    return result


def _others(log: Log, finding: Finding, files: frozenset[str]) -> Remark | None:
    lines: Iterable[Line]
    if finding.kind == "frame":
        lines = [Line("imu.kinematic", not log.imu.kinematic)]
    elif finding.kind == "sign" and finding.channel == "course" and is_compass(log, "course"):
        lines = [Line("units.course", "deg compass")]
    elif finding.kind == "sign":
        lines = [Line(f"signs.{name}", -1) for name in sources_of(log, finding.channel, files)]
    else:
        lines = _stuck_lines(log, finding.channel, files)
    lines = tuple(lines)
    return Remark(severity="problem", sentence=finding.sentence, lines=lines) if lines else None


def _stuck_lines(log: Log, channel: str, files: frozenset[str]) -> list[Line]:
    """Samples of a stuck sensor as none."""
    columns = sources_of(log, channel, files)
    values = log.samples(channel)[1]
    if len(values) and np.ptp(values) == 0.0:
        return [Line(f"blank.{name}", "all") for name in columns]
    span = stuck_while_moving(log, channel)
    if span is None:
        return []
    # Rounded outwards, so that both ends are inside.
    ends = [math.floor(1e3 * span[0]) / 1e3, math.ceil(1e3 * span[1]) / 1e3]
    return [Line(f"blank.{name}", [ends]) for name in columns]
