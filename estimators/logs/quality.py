"""Quality of the data of a log, checked before any model is fitted to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from estimators.logs.channel_checks import channel_findings, reconciled, without_sliding_wheels
from estimators.logs.clocks import clock_findings
from estimators.logs.immobile_findings import stuck_findings
from estimators.logs.log import Log
from estimators.logs.schema import IMU, RIG_COLUMNS, VEHICLE_COLUMNS
from estimators.logs.signals import (
    ChannelTiming,
    jumps,
    longest_run,
    noise_sd,
    resolution,
    timing,
    unwrapped,
)
from estimators.logs.stuck import stuck_while_moving
from estimators.logs.units import Check, Finding, suspicions

__all__ = ["ChannelQuality", "QualityReport", "quality"]

_GYROS = ("roll_rate", "pitch_rate", "yaw_rate")
_ACCELEROMETERS = ("a_x", "a_y", "a_z")
_SENSED = (*_ACCELEROMETERS, *_GYROS, "omega_f", "omega_r")  #: channels that end somewhere and never rest

#: Columns of the printed table: heading, and how a channel fills it.
_TABLE: tuple[tuple[str, Callable[[ChannelQuality], str]], ...] = (
    ("channel", lambda c: c.name),
    ("unit", lambda c: c.unit),
    ("samples", lambda c: f"{c.samples}"),
    ("rate [Hz]", lambda c: _shown(c.rate)),
    ("jitter [ms]", lambda c: _shown(round(1e3 * c.jitter, 6))),
    ("gaps", lambda c: f"{c.gaps}" + (f" (to {c.longest_gap:.2g} s)" if c.gaps else "")),
    ("low", lambda c: _shown(c.low)),
    ("high", lambda c: _shown(c.high)),
    ("noise sd", lambda c: _shown(c.noise)),
    ("signal/noise", lambda c: _shown(c.excitation)),
    ("remarks", lambda c: ", ".join(c.remarks)),
)


@dataclass(frozen=True, kw_only=True)
class ChannelQuality:
    """One row of the table. A wheel-rig log has no times: rate and what follows from it are NaN."""

    name: str
    unit: str
    samples: int
    rate: float  #: samples per second, from the median step [Hz]
    jitter: float  #: standard deviation of the steps, gaps apart [s]
    gaps: int  #: steps longer than five times the median
    longest_gap: float  #: [s]
    low: float
    high: float
    noise: float  #: standard deviation of what is white, from second differences
    resolution: float  #: step of the numbers; NaN if there is none
    excitation: float  #: standard deviation over ``noise``
    saturated: float  #: share of the samples that stand at the end of the range
    stuck: float  #: longest time at one value [s]
    remarks: tuple[str, ...]  #: one word for each finding


@dataclass(frozen=True, kw_only=True)
class QualityReport:
    """Quality of the data of one log."""

    name: str
    rows: int
    duration: float  #: [s]
    channels: tuple[ChannelQuality, ...]
    findings: tuple[Finding, ...]  #: worst first
    checks: tuple[Check, ...]  #: the laws by which units were judged

    @classmethod
    def unchecked(cls, log: Log) -> QualityReport:
        """Of a log whose data nothing has checked: without channels and findings."""
        return cls(name=log.name, rows=len(log), duration=log.duration, channels=(), findings=(), checks=())

    @property
    def problems(self) -> tuple[Finding, ...]:
        """Findings after which no model should be fitted."""
        return tuple(finding for finding in self.findings if finding.severity == "problem")

    @property
    def suspected_units(self) -> dict[str, str]:
        """Channel -> the unit that it seems to be in."""
        return {f.channel: f.suspected_unit for f in self.findings if f.suspected_unit is not None}

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """(headings, rows) as text, for a terminal or a page."""
        return tuple(h for h, _ in _TABLE), [tuple(fill(c) for _, fill in _TABLE) for c in self.channels]

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON takes it: NaN becomes null."""
        plain: dict[str, Any] = _plain(
            {
                "name": self.name,
                "rows": self.rows,
                "duration": self.duration,
                "channels": [asdict(channel) for channel in self.channels],
                "findings": [asdict(finding) for finding in self.findings],
                "checks": [check._asdict() for check in self.checks],
                "suspected_units": self.suspected_units,
            }
        )
        return plain

    def __str__(self) -> str:
        head, rows = self.table()
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in (head, *rows)]
        return "\n".join([*lines, *(f"{f.severity}: {f.sentence}" for f in self.findings)])


def _shown(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3g}"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def quality(log: Log) -> QualityReport:
    """Rates, gaps, noise, saturation, stuck channels, units, clocks and excitation of a log.

    Returns
    -------
    QualityReport
        ``str()`` of it is a table with one sentence a finding; ``to_dict`` is for JSON.
    """
    checks: list[Check] = []
    if log.rig:
        findings = _rig_findings(log)
    else:
        single, checks = suspicions(without_sliding_wheels(log))
        together, sound = channel_findings(log, single)
        findings = reconciled(single, together, sound)
        named = {f.channel for f in findings if f.severity == "problem"}
        findings += [f for f in together if f.severity != "problem" or f.channel not in named]
        findings += _silence_findings(log)
        findings += _timing_findings("t", timing(log.times), 0.5)
        findings += clock_findings(log, {f.channel for f in findings if f.kind in ("axes", "sign")})
        findings += _excitation_findings(log)
        findings += [*_jump_findings(log), *stuck_findings(log)]
    measured = {name: _measure(log, name, findings) for name in log.channels}
    order = ("problem", "warning", "note")
    findings.sort(key=lambda finding: order.index(finding.severity))
    channels = tuple(
        ChannelQuality(**values, remarks=_remarks(name, findings)) for name, values in measured.items()
    )
    return QualityReport(
        name=log.name,
        rows=len(log),
        duration=log.duration,
        channels=channels,
        findings=tuple(findings),
        checks=tuple(checks),
    )


def _remarks(name: str, findings: list[Finding]) -> tuple[str, ...]:
    words = []
    for finding in findings:
        if finding.channel == name and finding.severity != "note":
            words.append(f"{finding.suspected_unit}?" if finding.kind == "unit" else finding.kind)
    return tuple(dict.fromkeys(words))


# ------------------------------------------------------------------ channel by channel


def _measure(log: Log, name: str, findings: list[Finding]) -> dict[str, Any]:
    """All numbers of one row; appends what they show to ``findings``."""
    column = (RIG_COLUMNS if log.rig else VEHICLE_COLUMNS)[name]
    values = log.channels[name][~np.isnan(log.channels[name])]
    t = np.arange(len(values), dtype=float) if log.rig else log.samples(name)[0]
    when = ChannelTiming(math.nan, math.nan, 0, 0.0, 0.0) if log.rig else timing(t)
    angle = column.dimension == "angle"
    noise = math.nan if log.rig else noise_sd(unwrapped(values) if angle else values)
    saturated = 0.0 if log.rig else _saturated(name, values)
    stuck = 0.0 if log.rig else _stuck(name, t, values)
    if not log.rig:
        # A silence of the whole log is reported once, not for every channel.
        findings += _timing_findings(name, when, max(0.5, 1.1 * timing(log.times).longest_gap))
        _note_ends(findings, _end_findings(log, name, saturated, stuck))
        if not any(f.kind == "unit" and f.channel == name for f in findings):
            findings += _noise_findings(log, name, noise)
    spread = float(np.std(values))
    return {
        "name": name,
        "unit": column.unit,
        "samples": len(values),
        "rate": when.rate,
        "jitter": when.jitter,
        "gaps": when.gaps,
        "longest_gap": when.longest_gap,
        "low": float(values.min()),
        "high": float(values.max()),
        "noise": noise,
        "resolution": resolution(values),
        "excitation": spread / noise if noise > 0.0 else math.nan,
        "saturated": saturated,
        "stuck": stuck,
    }


def _silence_findings(log: Log) -> list[Finding]:
    """Silences so long that the clock, more likely than the log, stood still or was set."""
    silences = log.config.silences
    if not silences:
        return []
    at, length = max(silences, key=lambda silence: silence[1])
    more = "" if len(silences) == 1 else f", the longest of {len(silences)}"
    return [
        Finding(
            kind="time jump",
            channel="t",
            severity="warning",
            sentence=(
                f"the time jumps by {length:.4g} s at t = {at:.3f} s{more}: a clock that was set, or two "
                "runs in one file? It counts as a short silence; what comes before and after is used"
            ),
            numbers={"jumps": float(len(silences)), "longest": length, "at": at},
        )
    ]


def _timing_findings(name: str, when: ChannelTiming, allowed: float) -> list[Finding]:
    if when.longest_gap < allowed:
        return []
    subject = "the log" if name == "t" else name
    return [
        Finding(
            kind="gap",
            channel=name,
            severity="warning",
            sentence=(
                f"{subject} is silent for {when.longest_gap:.3g} s from t = {when.gap_at:.3f} s "
                f"({when.gaps} gaps in all)"
            ),
            numbers={"gaps": float(when.gaps), "longest": when.longest_gap, "at": when.gap_at},
        )
    ]


def _saturated(name: str, values: np.ndarray) -> float:
    """Share of the samples at the largest or smallest value, if they are too many to be a coincidence.

    Numbers with a step repeat too, but fewer times towards the end of the range, or 2.4 times as
    often as next to it where a sine turns.
    """
    distinct, counts = np.unique(values, return_counts=True)
    if name not in _SENSED or len(distinct) < 20:
        return 0.0
    ends = ((counts[0], counts[1]), (counts[-1], counts[-2]))
    enough = max(5, 0.001 * len(values))
    return sum(int(end) for end, inner in ends if end >= enough and end > 3 * inner) / len(values)


def _stuck(name: str, t: np.ndarray, values: np.ndarray) -> float:
    """Longest time at one value [s]; a wheel may stand at zero."""
    start, length = longest_run(values)
    if length < 2 or (name.startswith("omega") and values[start] == 0.0):
        return 0.0
    return float(t[start + length - 1] - t[start])


def _note_ends(findings: list[Finding], found: Sequence[Finding]) -> None:
    """Add findings of one channel; one that other channels show as well is a problem, reported once."""
    for one in found:
        known = [
            f for f in findings if (f.kind, f.channel) == (one.kind, one.channel) and one.kind == "stuck"
        ]
        for other in known:
            findings.remove(other)
        findings.append(replace(one, severity="problem") if known else one)


def _end_findings(log: Log, name: str, saturated: float, stuck: float) -> list[Finding]:
    values, found = log.samples(name)[1], []
    if saturated > 0.0:
        found.append(
            Finding(
                kind="saturation",
                channel=name,
                severity="warning",
                sentence=f"{name} stands at the end of its range ({values.min():g} ... {values.max():g}) in "
                f"{100.0 * saturated:.2g} % of its samples: the sensor or the drive is at its limit",
                numbers={"share": saturated},
            )
        )
    start, length = longest_run(values)
    if stuck < 1.0 or length < 10:
        return found
    span = stuck_while_moving(log, name)
    if span is not None:
        sentence = (
            f"{name} stays at exactly {values[start]:g} from t = {span[0]:.3f} to {span[1]:.3f} s while the "
            "vehicle moves on: stuck - leave these samples empty, or mend them"
        )
    elif name in _SENSED:
        sentence = f"{name} stays at exactly {values[start]:g} for {stuck:.3g} s, without any noise: stuck"
    else:
        return found
    found.append(
        Finding(
            kind="stuck",
            channel=name,
            severity="problem" if span is not None or np.ptp(values) == 0.0 else "warning",
            sentence=sentence,
            numbers={"time": stuck},
        )
    )
    return found


def _noise_findings(log: Log, name: str, noise: float) -> list[Finding]:
    """Whether the YAML's noise is of the order of the noise in the channel."""
    if name not in (*IMU, "roll_rate") or not noise > 0.0:
        return []
    stated = log.imu.sd_a if name in _ACCELEROMETERS else log.imu.sd_rate
    ratio = noise / stated
    if 1.0 / 3.0 <= ratio <= 3.0:
        return []
    return [
        Finding(
            kind="noise",
            channel=name,
            severity="note",
            sentence=f"{name} has a noise of {noise:.3g}, {ratio:.2g} times the {stated:g} in the YAML",
            numbers={"measured": noise, "stated": stated},
        )
    ]


# ------------------------------------------------------------------ positions


def _jump_findings(log: Log) -> list[Finding]:
    found = jumps(log)
    if not found:
        return []
    times = ", ".join(f"{0.5 * (start + stop):.1f}" for start, stop in found[:5])
    return [
        Finding(
            kind="jump",
            channel="x",
            severity="warning",
            sentence=f"the position jumps as no vehicle can move, {len(found)} times: at t = {times} s",
            numbers={"times": float(len(found)), "at": found[0][0]},
        )
    ]


# ------------------------------------------------------------------ excitation


def _excitation_findings(log: Log) -> list[Finding]:
    """Motions that the run does not excite."""
    findings = []
    steer = log.samples("steer")[1]
    if np.ptp(steer) < 0.02 and np.max(np.abs(steer)) < 0.02:
        findings.append(
            _unexcited("steer", "never moves: nothing lateral can be learned from this run", np.ptp(steer))
        )
    for name in ("omega_r", "omega_f", "v_x", "speed"):
        if name not in log.channels:
            continue
        values = log.samples(name)[1]
        low, high = np.quantile(values, [0.05, 0.95])
        if high - low < 0.1 * max(abs(low), abs(high), 1e-9):
            findings.append(
                _unexcited(name, "varies by less than 10 %: nothing that grows with speed shows", high - low)
            )
        break
    return findings


def _unexcited(channel: str, sentence: str, spread: float) -> Finding:
    return Finding(
        kind="excitation",
        channel=channel,
        severity="note",
        sentence=f"{channel} {sentence}",
        numbers={"spread": float(spread)},
    )


# ------------------------------------------------------------------ wheel rigs


def _rig_findings(log: Log) -> list[Finding]:
    findings = []
    r = log.wheel.r
    # One trial may plough deeper than the wheel's radius; half of all trials cannot.
    usual = float(np.nanmedian(log.channels.get("sinkage", np.zeros(1))))
    if usual > r:
        unit = "cm" if 1e-2 * usual <= r else "mm"
        findings.append(
            Finding(
                kind="unit",
                channel="sinkage",
                severity="problem",
                sentence=f"sinkage is {usual:g} m in the median trial, beyond the wheel's radius {r:g} m: "
                f"sinkage is in {unit}",
                suspected_unit=unit,
                numbers={"median": usual},
            )
        )
    slip = log.channels["slip"]
    if np.nanmax(slip) - np.nanmin(slip) < 0.1:
        findings.append(
            _unexcited(
                "slip",
                "spans less than 0.1: nothing that grows with slip shows",
                np.nanmax(slip) - np.nanmin(slip),
            )
        )
    return findings
