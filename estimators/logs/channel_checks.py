"""Findings of the checks that compare channels: what each is, and what could not be checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from estimators.logs.agreement import Suspect, suspects_of
from estimators.logs.log import Log
from estimators.logs.plausibility import Violation, moved_in, turns_without_steering, violations_of
from estimators.logs.raw import SIDES, SPLIT
from estimators.logs.units import Finding

__all__ = ["OUTSIDE", "channel_findings", "reconciled", "without_sliding_wheels"]

#: Kind of a finding by which no model of the log's class can be right.
OUTSIDE = "model class"
#: Kinds that one comparison finds, which a vote of several may overrule.
_BY_ONE_LAW = ("sign", "unit")
#: Why a channel could not be checked, where it is always the same.
_ALONE = {
    "a_z": "nothing else measures the vertical motion of the body; only its noise was compared",
    "pitch_rate": "the body did not lean enough with the change of speed; only its noise was compared",
    "roll_rate": "the body did not lean enough in bends; only its noise was compared",
    "v_y": "no other channel shows a slide to the side; only its size was compared with the speed",
    "yaw": "the vehicle hardly turned",
    "course": "the vehicle hardly turned, or was slow",
    "steer": "the vehicle hardly turned",
    "yaw_rate": "the vehicle hardly turned, or nothing else shows how it turned",
    "a_y": "the vehicle hardly turned, or was slow",
    "a_x": "the speed hardly changed",
    "x": "the vehicle hardly turned, so that a wrong scale of one coordinate looks like another heading",
}
_ALONE["y"] = _ALONE["x"]
_LEVEL = frozenset({"a_x", "a_y"})
#: By what motion a reason of those says that there was none; it is none where a channel shows the motion.
_SHOWS = {
    "yaw": "turn", "course": "turn", "steer": "turn", "yaw_rate": "turn", "a_y": "turn", "a_x": "push",
}  # fmt: skip
_CONTRADICTED = "the other channels that show it contradict each other, or are too few"
_SLIDES = "not compared with other channels: wheels that are not steered slide in every turn"
_OTHERS = "the speed hardly changed, or too few other channels agree on it"


def channel_findings(log: Log, earlier: Sequence[Finding]) -> tuple[list[Finding], set[str]]:
    """Findings of the comparison of all channels, and the channels that were judged sound.

    Parameters
    ----------
    earlier
        Findings of single laws; their channels are named no second time.
    """
    outside = turns_without_steering(log)
    if outside is not None:
        return _of_sliding(log, outside, earlier), set()
    suspects, judged = suspects_of(log)
    if any(finding.kind == "axes" for finding in earlier):
        # Each measures what the other should: a vote on either has no meaning.
        suspects, judged = [s for s in suspects if not _LEVEL & set(s.channels)], judged - _LEVEL
    suspected = {name for suspect in suspects for name in suspect.channels}
    sound = judged - suspected
    known = {f.channel for f in earlier if f.severity == "problem"}
    violations, seen = violations_of(log, frozenset(suspected | (known - sound)))
    judged |= seen
    positions = {name for violation in violations for name in violation.channels} & {"x", "y"}
    suspects = [s for s in suspects if not (positions and set(s.channels) == {"x", "y"})]
    findings = [*_one_each([*map(_of_suspect, suspects), *map(_of_violation, violations)])]
    named = {f.channel for f in findings} | known
    moved = moved_in(log)
    findings += [_unchecked(name, moved) for name in log.channels if name not in judged | named]
    if SPLIT in log.config.notes:
        findings = [_of_split(finding) for finding in findings]
    return findings, sound


def _of_sliding(log: Log, outside: str, earlier: Sequence[Finding]) -> list[Finding]:
    """Of a vehicle that turns without steering: each sensor by itself, since its wheels do not roll.

    They drag it through its turns, so that they show neither its speed nor its course, and it slides aside.
    """
    violations, judged = violations_of(log, frozenset(log.channels))
    findings = [_outside(log, outside), *_one_each(map(_of_violation, violations))]
    named = {"steer", *(f.channel for f in [*findings, *earlier] if f.severity == "problem")}
    return findings + [
        replace(_unchecked(name, set()), sentence=f"{name}: {_SLIDES}")
        for name in log.channels
        if name not in judged | named
    ]


def _of_split(finding: Finding) -> Finding:
    """The finding with the column of the file that it is about."""
    if finding.channel not in ("torque_f", "torque_r"):
        return finding
    of_total = "it is a share of torque_total"
    if finding.kind == "unchecked":
        return replace(
            finding, sentence=f"{finding.channel}: sign and scale could not be checked: {of_total}"
        )
    return replace(finding, sentence=f"{finding.sentence} ({of_total})")


def without_sliding_wheels(log: Log) -> Log:
    """The log, or that without its wheel speeds where the vehicle turns without steering: they show none."""
    if turns_without_steering(log) is None:
        return log
    return replace(log, channels={k: v for k, v in log.channels.items() if k not in ("omega_f", "omega_r")})


def reconciled(single: Iterable[Finding], found: Sequence[Finding], sound: set[str]) -> list[Finding]:
    """The findings of single laws without those that a vote of several channels refutes.

    Where one channel is wrong, every law with it fails, and each law blames a channel of its own.
    """
    guilty = any(finding.severity == "problem" for finding in found)
    return [f for f in single if not (guilty and f.kind in _BY_ONE_LAW and f.channel in sound)]


def _one_each(findings: Iterable[Finding]) -> list[Finding]:
    """The first finding of every channel and severity."""
    kept: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        kept.setdefault((finding.channel, finding.severity), finding)
    return list(kept.values())


def _of_suspect(suspect: Suspect) -> Finding:
    channel = " or ".join(suspect.channels)
    others = ", ".join(dict.fromkeys(suspect.witnesses))
    numbers = {"factor": suspect.factor}
    if suspect.kind == "stuck" and suspect.span is not None:
        sentence = (
            f"{channel} stays at one value from t = {suspect.span[0]:.3f} to {suspect.span[1]:.3f} s while "
            f"the {suspect.motion.name} changes by {others}: stuck - leave these samples empty, or mend them"
        )
    elif suspect.kind == "sign":
        sentence = (
            f"{channel} against the {suspect.motion.name} by {others}: factor {suspect.factor:.3g}: "
            f"the sign of {channel} is reversed"
        )
    elif suspect.kind == "scale":
        sentence = (
            f"{channel} is {suspect.factor:.3g} times the {suspect.motion.name} by {others} (correlation "
            f"{suspect.correlation:.2f}): another unit, or scale"
        )
    else:
        sentence = (
            f"{channel} does not follow the {suspect.motion.name}, on which {others} agree (correlation "
            f"{suspect.correlation:.2f}): stuck, noise, or another quantity"
        )
    return Finding(
        kind=suspect.kind, channel=suspect.channels[0], severity="problem", sentence=sentence, numbers=numbers
    )


def _of_violation(violation: Violation) -> Finding:
    return Finding(
        kind=violation.kind,
        channel=violation.channels[0],
        severity=violation.severity,
        sentence=violation.sentence,
        numbers=violation.numbers,
    )


def _outside(log: Log, sentence: str) -> Finding:
    """What no model of a steered vehicle can be right about; no problem of data that say so themselves."""
    severity = "warning" if SIDES in log.config.notes else "problem"
    return Finding(kind=OUTSIDE, channel="steer", severity=severity, sentence=sentence)


def _unchecked(name: str, moved: set[str]) -> Finding:
    reason = _ALONE.get(name, _OTHERS)
    if _SHOWS.get(name, "speed") in moved:
        reason = _CONTRADICTED if name in _SHOWS or name not in _ALONE else reason
    return Finding(
        kind="unchecked",
        channel=name,
        severity="note",
        sentence=f"{name}: sign and scale could not be checked: {reason}",
    )
