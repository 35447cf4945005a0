"""The whole procedure on vehicle logs: from data quality to one verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.discrepancy.fit import Fit, fit_runs
from estimators.discrepancy.gain import ChannelGain, Held, channel_gains, held_out
from estimators.discrepancy.probe import Beside, Rest, beside_forces, probe
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.search import Cause, Search, search
from estimators.discrepancy.windows import FIT, REPORT, SELECT
from estimators.logs.clocks import pose_age
from estimators.logs.log import Log
from estimators.logs.quality import Finding, quality
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["OVERLAP", "VERDICTS", "Diagnosis", "diagnose", "overlap_of", "split_runs"]

VERDICTS = (
    "DATA PROBLEM", "NUMERICS", "NOT TESTABLE", "UNEXPLAINED", "NAMED + UNEXPLAINED REST", "ONE OF", "NAMED",
    "NO EFFECT",
)  # fmt: skip

#: Share of null logs in which the first screen may find something; the gate on other data lets through about
#: one in four of these, so that with `REST_RATE` the whole stays near 3 %.
SCREEN_RATE = 0.06
#: The same for the unknown force of one equation of motion.
REST_RATE = 0.002
#: A cause that is beyond chance beside forces without a name stands on its own if these leave it the first
#: share of its information, or if it explains the second of what it and they explain together. Its size must
#: be the same within its 95 % interval or the third share.
_OWN, _MOST, _SAME, _Z = 0.5, 0.9, 0.5, 1.96
#: Causes whose sizes hang together by more than this (correlation) may be one that the library lacks.
OVERLAP = 0.2
#: An error of the solver moves scores by less than this, absolutely or as a share of the largest.
_SOLVER, _SOLVER_SHARE = 1.0, 0.1
#: What sensors tell of the age of the pose, with which every fit begins: kind of a finding, and its channel.
_OLD_POSE = ("clock", "yaw")
#: Effects that nobody can tell from what a log does not know.
_UNJUDGED = {
    "imu.position": ("lever_arm_x", "lever_arm_z"),
    "gnss.position": ("antenna_x",),
    # A payload shows by the springs, too: on hard ground, where tyres hold by load, by nothing else.
    "suspension": ("bump_stop", "coulomb_friction", "damper_nonlinear", "payload"),
    # Where wheels turn as measured, the noise of their sensors shakes the simulated body.
    "torque": ("bump_stop", "coulomb_friction", "damper_nonlinear", "payload", "lever_arm_z"),
}
#: A log can test the library if it would see this share of it at the largest plausible size.
_TESTABLE = 0.5


@dataclass(kw_only=True)
class Diagnosis:
    """Everything that was found; parts that were not reached are None or empty."""

    verdict: str
    causes: tuple[Cause, ...] = ()
    rest: tuple[Rest, ...] = ()
    beside: Beside | None = None  #: the causes with forces without a name beside them; where such are left
    findings: tuple[Finding, ...] = ()
    limits: dict[str, float] = field(default_factory=dict)  #: smallest size that would have been seen
    not_testable: dict[str, float] = field(default_factory=dict)  #: the limits beyond all plausible sizes
    missing: dict[str, str] = field(default_factory=dict)  #: effects that the log's channels cannot show
    unjudged: dict[str, str] = field(default_factory=dict)  #: effects of what a log does not know
    gains: tuple[ChannelGain, ...] = ()
    checks: dict[str, object] = field(default_factory=dict)
    search: Search | None = None
    report: tuple[Held, Held] | None = None  #: nominal and extended model on the report split
    logs: tuple[Log, ...] = ()

    @property
    def model(self) -> Fit | None:
        """The fit with the causes that are named; the nominal one without; None where nothing was fitted."""
        if self.search is None:
            return None
        # What the search found and the gate did not let through is no model.
        return self.search.extended if self.causes else self.search.nominal

    @property
    def unexplained(self) -> tuple[Rest, ...]:
        """Equations of motion in which a force without a name is left."""
        return tuple(rest for rest in self.rest if rest.chance < REST_RATE)

    @property
    def stands(self) -> tuple[bool, ...]:
        """Of every cause, whether it stands on its own when forces without a name are fitted beside it."""
        if self.beside is None:
            return (True,) * len(self.causes)
        return tuple(bool(one) and not any(self.halves) for one in self._beyond_forces())

    @property
    def halves(self) -> tuple[bool, ...]:
        """Of every cause, whether it and another that would stand may be halves of one that is not there."""
        if self.beside is None:
            return (False,) * len(self.causes)
        own = self._beyond_forces()
        return tuple((own & np.any(own & (self.beside.alike > OVERLAP), axis=1)).tolist())

    def _beyond_forces(self) -> np.ndarray:
        """Of every cause, whether it stays what it is beside forces without a name."""
        own, sizes = self.beside, self.search.extended.sizes
        strength = np.abs(own.sizes) / own.deviations
        share = strength**2 / (strength**2 + self.left)
        reach = np.maximum(_Z * own.deviations, _SAME * np.abs(sizes))
        same = (strength > self.search.threshold) & (np.abs(own.sizes - sizes) <= reach)
        return same & ((own.kept >= _OWN) | (share >= _MOST))

    @property
    def left(self) -> float:
        """What the causes leave, in twice the log-likelihood: to forces, or to effects that are refused."""
        forces = sum(rest.excess for rest in self.rest)
        refused = float(np.max(self.search.last.z**2, initial=0.0)) if self.search.refused else 0.0
        return max(forces, refused)

    @property
    def named(self) -> tuple[Cause, ...]:
        """Causes that the verdict names: where a force without a name is left, those that stand alone."""
        return tuple(cause for cause, stands in zip(self.causes, self.stands, strict=True) if stands)

    @property
    def doubtful(self) -> bool:
        """Whether something is left: a force, or what asks for effects that other windows refuse."""
        return bool(self.unexplained) or (bool(self.causes) and self.search.refused)


def diagnose(
    logs: Sequence[Log],
    *,
    library: Sequence[str] | None = None,
    white: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """Say what the simulation gets wrong in these runs of one vehicle on one soil.

    Parameters
    ----------
    library
        Effects that may be named; default all.
    white
        Take all noise for white: only to show what that does.
    progress
        Called with the name of every stage that begins.

    Raises
    ------
    DataError
        If a log cannot be used at all.
    SolverFailure
        If the nominal model cannot be run.
    """
    # Neither the order of files and effects nor a file's name may matter.
    logs = sorted(logs, key=lambda log: log.hash)
    progress("data quality")
    checked = [quality(log) for log in logs]
    problems = tuple(finding for report in checked for finding in report.problems)
    if problems:
        return Diagnosis(verdict="DATA PROBLEM", findings=problems, logs=tuple(logs))
    parts = split_runs(logs)
    progress("nominal model")
    nominal = fit_runs(parts[FIT], white=white)
    unjudged = _unjudged(nominal)
    library = [name for name in EFFECTS if (library is None or name in library) and name not in unjudged]
    progress("search")
    found = search(nominal, library, SCREEN_RATE, parts[SELECT], white=white)
    progress("solver")
    solver = found.solver_error()
    progress("what is left")
    rest = probe(found.extended)
    limits = found.first.limits()
    result = Diagnosis(
        verdict="",
        causes=found.causes,
        rest=rest,
        limits=limits,
        not_testable=_not_testable(nominal, limits, found.causes),
        missing=_missing(nominal, library),
        unjudged=unjudged,
        checks=_checks(found, solver, logs),
        search=found,
        logs=tuple(logs),
        findings=tuple(f for report in checked for f in report.findings if (f.kind, f.channel) == _OLD_POSE),
    )
    if result.causes and result.doubtful:
        result.beside = beside_forces(found.extended)
    result.verdict = _verdict(result, solver)
    progress("gain")
    if found.causes and parts[REPORT]:
        _report(result, parts[REPORT])
    return result


def _unjudged(fit: Fit) -> dict[str, str]:
    """Effects that nobody can tell from what some log does not know, and that."""
    missing = {what for run in fit.runs for what in run.log.config.unknown}
    missing |= {"torque" for run in fit.runs if not run.driven}
    return {effect: what for what, effects in _UNJUDGED.items() if what in missing for effect in effects}


def _checks(found: Search, solver: float, logs: Sequence[Log]) -> dict[str, object]:
    """What tells how far the verdict may be trusted, and what the fit makes of all that is no cause."""
    return {
        "solver": solver,
        "gate": list(found.gate),
        # A model that lacks much need not have a clean minimum: the one that is reported must.
        "converged": found.extended.converged,
        "threshold": found.threshold,
        "overlap": overlap_of(found.extended),
        "pose_age": [pose_age(log) for log in logs],
        "unknowns": found.extended.unknowns(),
        "nuisances": found.extended.healthy_values(),
    }


def split_runs(logs: Sequence[Log]) -> dict[int, list[RunModel]]:
    """Windows by their use: by run where there are three runs or more, else by time."""
    if len(logs) < 3:
        return {use: _with_windows([RunModel(log, use=use) for log in logs]) for use in (FIT, SELECT, REPORT)}
    first, second = round(0.6 * len(logs)), round(0.8 * len(logs))
    parts = {FIT: logs[:first], SELECT: logs[first : max(second, first + 1)]}
    parts[REPORT] = logs[max(second, first + 1) :]
    return {use: [RunModel(log, whole=use) for log in own] for use, own in parts.items()}


def _with_windows(runs: list[RunModel]) -> list[RunModel]:
    kept = [run for run in runs if len(run.windows) and len(run.y)]
    return kept


def _not_testable(fit: Fit, limits: dict[str, float], causes: Sequence[Cause]) -> dict[str, float]:
    vehicle = fit.runs[0].setup.plant.vehicle
    # Limits are the nominal model's: what was found all the same was testable.
    found = {rival.candidate.effect for cause in causes for rival in cause.rivals}
    return {
        name: limit
        for name, limit in limits.items()
        if limit > EFFECTS[name].plausible(vehicle) and name not in found
    }


def overlap_of(fit: Fit) -> float:
    """Largest correlation of the sizes of two effects in the model, from 0 to 1; 0 for fewer."""
    return float(fit.shares.alike(len(fit.sizes)).max(initial=0.0))


def _missing(fit: Fit, library: Sequence[str]) -> dict[str, str]:
    channels = set().union(*(run.log.channels for run in fit.runs))
    found = {}
    for name in library:
        for group in EFFECTS[name].needs:
            if not channels & set(group) and EFFECTS[name].searched:
                found[name] = " or ".join(group)
    return found


def _verdict(result: Diagnosis, solver: float) -> str:
    strongest = float(np.abs(result.search.first.z).max(initial=0.0))
    if solver > max(_SOLVER, _SOLVER_SHARE * strongest) or not result.checks["converged"]:
        return "NUMERICS"
    if result.doubtful:
        if not result.named:
            return "UNEXPLAINED"
        return "NAMED + UNEXPLAINED REST"
    if result.causes:
        sets = any(len(cause.rivals) > 1 for cause in result.causes)
        return "ONE OF" if sets or result.checks["overlap"] > OVERLAP else "NAMED"
    seen = len(result.limits) - len(result.not_testable)
    if seen < _TESTABLE * (len(result.limits) + len(result.missing)):
        return "NOT TESTABLE"
    return "NO EFFECT"


def _report(result: Diagnosis, runs: list[RunModel]) -> None:
    """Open the report split: once, after everything is decided."""
    try:
        nominal = held_out(result.search.nominal, runs)
        extended = held_out(result.search.extended, runs, nominal)
    except OffroadError:
        return
    result.report = nominal, extended
    result.gains = channel_gains(nominal, extended)
