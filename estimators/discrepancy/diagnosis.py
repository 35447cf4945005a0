"""Diagnosis of vehicle logs: from the quality of the data to a result with its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.discrepancy.checks.forecast import predictions
from estimators.discrepancy.checks.holdout_gain import channel_gains, held_out
from estimators.discrepancy.checks.regime_rest import regime_rests
from estimators.discrepancy.checks.unmodelled_forces import sizes_with_unknown_inputs, unmodelled_forces
from estimators.discrepancy.data_quality import quality_of, unusable, used_findings
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.nuisances import nuisances_of
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT, SHORTEST
from estimators.discrepancy.search.result import Cause, SearchResult
from estimators.discrepancy.search.second_look import incomplete, looked_again
from estimators.discrepancy.search.stepwise import scored_only, search, without_cause
from estimators.discrepancy.sections import attempt
from estimators.discrepancy.stated_model import model_with
from estimators.discrepancy.stopping import stops_of
from estimators.discrepancy.structure_comparison import StructureComparison, compare_structures
from estimators.discrepancy.verdict import (
    JOINT_SIZES,
    NOMINAL,
    SEARCH,
    STOPS,
    VehicleChecks,
    VehicleDiagnosis,
    Verdict,
    solver_limit,
)
from estimators.logs.clocks import pose_age
from estimators.logs.immobile_findings import IMMOBILE
from estimators.logs.log import Log
from estimators.logs.quality import QualityReport
from offroad_env.effects import EFFECTS, Setup
from offroad_env.errors import OffroadError, SolverFailure

__all__ = ["SCREEN_RATE", "diagnose", "split_runs"]

#: False-alarm rate of the first score test. The hold-out test lets about one in four of these pass, so that
#: with `REST_RATE` the whole diagnosis stays near 3 %.
SCREEN_RATE = 0.06
#: How often the step of the solver is halved where it is not accurate enough for the scores.
_HALVINGS = 2
#: Another structure makes a finer solver unnecessary if it predicts better than the effects found so far, by
#: this share of their errors where their fit has not converged yet: twice what counts as a tie.
_CLEARLY = 0.2
#: Effects on the sprung body.
_OF_THE_BODY = (
    "bump_stop",
    "cg_height",
    "coulomb_friction",
    "damper_nonlinear",
    "payload",
    "placed_payload",
    "spring_rate",
)
#: Effects that cannot be distinguished from what a log states as unknown.
_NOT_JUDGED = {
    "imu.position": ("lever_arm_x", "lever_arm_z"),
    "gnss.position": ("antenna_x",),
    # A payload also acts by the springs: on hard ground, where tyres hold by load, by nothing else.
    "suspension": _OF_THE_BODY,
    # Where wheels turn as measured, the noise of their sensors shakes the simulated body.
    "torque": (*_OF_THE_BODY, "lever_arm_z"),
}


def diagnose(
    logs: Sequence[Log],
    *,
    library: Sequence[str] | None = None,
    white: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> VehicleDiagnosis:
    """Find the errors of the model in these runs of one vehicle on one soil.

    Parameters
    ----------
    library
        Effects that may be named; default all.
    white
        Take all noise for white: only to show the consequences.
    progress
        Called with the name of every stage that begins.

    Raises
    ------
    DataError
        If a log cannot be used at all.
    """
    # Neither the order of files and effects nor the name of a file may matter.
    ordered = tuple(sorted(logs, key=lambda log: log.hash))
    allowed = [name for name in EFFECTS if library is None or name in library]
    # The matrices are small: the threads of BLAS only wait for each other, the more so beside other work.
    with threadpool_limits(limits=1, user_api="blas"):
        result = _diagnosed(ordered, allowed, white=white, progress=progress)
        return _with_stops(result, allowed, progress)


def _diagnosed(
    ordered: tuple[Log, ...], allowed: Sequence[str], *, white: bool, progress: Callable[[str], None]
) -> VehicleDiagnosis:
    """The result by what is driven in these logs."""
    progress("data quality")
    failed: dict[str, str] = {}
    reports = quality_of(ordered, failed)
    reasons = unusable(ordered, reports)
    if reasons:
        return VehicleDiagnosis(logs=ordered, quality=reports, findings=reasons, failed=failed)
    splits = split_runs(ordered)
    try:
        done = _searched(splits, allowed, failed, white=white, progress=progress)
    except (SolverFailure, ArithmeticError, np.linalg.LinAlgError) as error:
        failed[NOMINAL] = f"{type(error).__name__}: {error}"
        return _without_nominal(ordered, reports, failed, progress)
    begun = VehicleDiagnosis(
        logs=ordered, quality=reports, findings=used_findings(ordered, reports), failed=failed
    )
    restructured = _clearly_restructured(begun, done, allowed, progress)
    if restructured is not None:
        return restructured
    looked = not done.accurate
    if looked:
        # A wrong effect may be what is stiff, and a finer solver takes longer than a wider search.
        done = _looked_again(done, allowed, failed, progress)
    done = _refined(done, allowed, failed, white=white, progress=progress)
    result = _completed(begun, done, allowed, failed, progress)
    if not looked and result.restructured is None:
        again = _looked_again(done, allowed, failed, progress)
        if again is not done:
            done, result = again, _completed(begun, again, allowed, failed, progress)
    return _with_fewer_causes(result, begun, done, allowed, progress)


def _with_stops(
    result: VehicleDiagnosis, allowed: Sequence[str], progress: Callable[[str], None]
) -> VehicleDiagnosis:
    """The result with what may stop a vehicle that gets stuck."""
    stuck = any(finding.kind == IMMOBILE for finding in result.findings)
    if not stuck or result.verdict is Verdict.DATA_PROBLEM:
        return result
    progress(STOPS)
    failed = dict(result.failed)
    stops = attempt(STOPS, lambda: stops_of(result.logs, allowed), result.stops, failed)
    return replace(result, stops=stops, failed=failed)


def _with_fewer_causes(
    result: VehicleDiagnosis,
    begun: VehicleDiagnosis,
    done: _Searched,
    allowed: Sequence[str],
    progress: Callable[[str], None],
) -> VehicleDiagnosis:
    """The result without some causes, where forecasts refute all of them together and not the others alone.

    One that is right is not lost with another that is wrong. The weakest is left out first; of two, either.
    """
    failed = dict(begun.failed)
    while result.misled and len(done.found.causes) > 1:
        fit = done.found.extended
        weakest = np.argsort(np.abs(fit.sizes) / fit.size_deviations())
        smaller = list[_Searched]()
        for k in weakest if len(weakest) == 2 else weakest[:1]:
            progress("fewer causes")
            drop = partial(without_cause, done.found, int(k), done.splits[SELECT], SCREEN_RATE)
            found = attempt("fewer causes", drop, None, failed)
            if found is None:
                continue
            smaller.append(done._replace(found=found, solver_error=found.solver_error()))
            fewer = _completed(replace(begun, failed=failed), smaller[-1], allowed, failed, progress)
            if fewer.stated:
                return fewer
        if not smaller:
            break
        done = smaller[0]
    return result


class _Searched(NamedTuple):
    """A search and the windows that it used."""

    splits: dict[int, list[RunModel]]
    nominal: FitResult
    not_judged: dict[str, str]
    found: SearchResult
    solver_error: float
    wide: bool = False

    @property
    def accurate(self) -> bool:
        """Whether the solver is accurate enough for the scores, and the fit has converged."""
        return self.found.extended.converged and self.solver_error <= solver_limit(self.found)


def _searched(
    splits: dict[int, list[RunModel]],
    allowed: Sequence[str],
    failed: dict[str, str],
    *,
    white: bool,
    progress: Callable[[str], None],
    near: FitResult | None = None,
    wide: bool = False,
) -> _Searched:
    """The search in these windows; ``near`` is a nominal fit of them by another step of the solver.

    Raises
    ------
    SolverFailure
        When the nominal model cannot be driven through them.
    """
    progress("nominal model")
    # The search simulates what roads do where it begins, which may be a better minimum.
    nominal = fit_runs(splits[FIT], white=white, null=False, near=near)
    not_judged = _not_judged(nominal)
    progress("search")
    names = [name for name in allowed if name not in not_judged]
    found = _search(nominal, names, splits[SELECT], failed, wide)
    progress("solver")
    return _Searched(splits, nominal, not_judged, found, found.solver_error(), wide)


def _clearly_restructured(
    begun: VehicleDiagnosis, done: _Searched, allowed: Sequence[str], progress: Callable[[str], None]
) -> VehicleDiagnosis | None:
    """The result where a finer search is due, and another structure predicts the runs clearly better anyway.

    Effects within a wrong structure are not judged: what a finer solver, at many times the cost, would change
    in them does not matter. None where it may.
    """
    if done.accurate:
        return None
    failed = dict(begun.failed)
    result = _judged(begun, done, allowed, failed)
    result = _with_structures(result, done.found.extended, failed, progress)
    named = result.restructured
    if named is None or named.gain_over_effects is None or named.tied:
        return None
    clear = done.found.extended.converged or named.gain_over_effects > _CLEARLY
    return replace(result, failed=failed) if clear else None


def _refined(
    done: _Searched,
    allowed: Sequence[str],
    failed: dict[str, str],
    *,
    white: bool,
    progress: Callable[[str], None],
) -> _Searched:
    """The search again by half the step, or a quarter, where that is needed and helps.

    A vehicle that crawls, or whose wheels grip and slip in turn, is stiff. Half the step may then err as much
    in another place, and its search end elsewhere.
    """
    best, splits = done, done.splits
    for _ in range(_HALVINGS):
        if best.accurate or SEARCH in failed:
            break
        splits = {use: [run.refined() for run in runs] for use, runs in splits.items()}
        try:
            near = best.found.nominal
            again = _searched(
                splits, allowed, failed, white=white, progress=progress, near=near, wide=best.wide
            )
        except (OffroadError, ArithmeticError, np.linalg.LinAlgError):
            continue
        if failed.pop(SEARCH, None) is None and (again.accurate or again.solver_error < best.solver_error):
            best = again
    return best


def _looked_again(
    done: _Searched, allowed: Sequence[str], failed: dict[str, str], progress: Callable[[str], None]
) -> _Searched:
    """A wider search, where the first leaves something and the other explains more; else as it is."""
    if not incomplete(done.found):
        return done
    progress("wider search")
    names, apart = [name for name in allowed if name not in done.not_judged], done.splits[SELECT]
    again = partial(looked_again, done.found, names, SCREEN_RATE, apart)
    found = attempt("wider search", again, done.found, failed)
    if found is done.found:
        return done
    other = done._replace(found=found, solver_error=found.solver_error(), wide=True)
    return other if other.accurate or not done.accurate else done


def _completed(
    begun: VehicleDiagnosis,
    done: _Searched,
    allowed: Sequence[str],
    failed: dict[str, str],
    progress: Callable[[str], None],
) -> VehicleDiagnosis:
    """The result with what a search found: other structures, unknown inputs, forecasts, and the test data."""
    progress("unknown inputs")
    result, found, apart = _judged(begun, done, allowed, failed), done.found, done.splits[REPORT]
    known = found.extended.converged and (result.causes or result.verdict is Verdict.NO_EFFECT)
    result = _with_structures(result, found.extended if known else None, failed, progress)
    if result.restructured is not None:
        return result
    if result.causes and result.incomplete:
        joint = attempt(JOINT_SIZES, lambda: sizes_with_unknown_inputs(found.extended), None, failed)
        result = replace(result, joint=joint)
    if 0 < len(result.stated) < len(result.causes):
        stated = attempt("model of the named causes", lambda: _partial(result, found), None, failed)
        result = replace(result, partial=stated)
    progress("forecasts")
    result = attempt("forecasts", lambda: _with_forecasts(result, found, apart), result, failed)
    progress("test data")
    return attempt("test data", lambda: _on_test_data(result, found, apart), result, failed)


def _judged(
    begun: VehicleDiagnosis, done: _Searched, allowed: Sequence[str], failed: dict[str, str]
) -> VehicleDiagnosis:
    """The result with the causes of a search, what they leave, and what was testable."""
    found, limits = done.found, done.found.first.limits()
    return replace(
        begun,
        search=found,
        causes=found.causes,
        unknown_inputs=attempt("unknown inputs", lambda: unmodelled_forces(found.extended), (), failed),
        rests=attempt("rest by regime", lambda: regime_rests(found.extended), (), failed),
        limits=limits,
        not_testable=_not_testable(done.nominal, limits, found.causes),
        missing=_missing(done.nominal, [name for name in allowed if name not in done.not_judged]),
        not_judged=done.not_judged,
        checks=_checks(found, done.solver_error, begun.logs),
    )


def _partial(result: VehicleDiagnosis, found: SearchResult) -> FitResult:
    """The model with the named causes alone: their sizes with unknown inputs in the place of the others."""
    kept = [k for k, one in enumerate(result.identifiable) if one]
    sizes = found.extended.sizes if result.joint is None else result.joint.sizes
    return model_with(found.extended, kept, sizes[kept])


def _without_nominal(
    logs: tuple[Log, ...],
    reports: tuple[QualityReport, ...],
    failed: dict[str, str],
    progress: Callable[[str], None],
) -> VehicleDiagnosis:
    """The result where the nominal model cannot be driven through the runs: other structures may."""
    progress("structures")
    compared = attempt("structures", lambda: compare_structures(logs), None, failed)
    return VehicleDiagnosis(
        logs=logs,
        quality=reports,
        findings=used_findings(logs, reports),
        structure=compared,
        failed=failed,
    )


def _search(
    nominal: FitResult, library: Sequence[str], apart: Sequence[RunModel], failed: dict[str, str], wide: bool
) -> SearchResult:
    """The search for effects; where it breaks down, the scores alone."""
    found = attempt(SEARCH, lambda: search(nominal, library, SCREEN_RATE, apart, wide=wide), None, failed)
    return scored_only(nominal, library, SCREEN_RATE) if found is None else found


def _with_structures(
    result: VehicleDiagnosis,
    fit: FitResult | None,
    failed: dict[str, str],
    progress: Callable[[str], None],
) -> VehicleDiagnosis:
    """The result with other structures compared, also with ``fit``; effects of a wrong one stand in for it.

    Where hardly an effect is testable, as on a straight drive, another structure still may be. Where none was
    found, numbers within their tolerances may stand in for a wrong structure, and n with them.
    """
    progress("structures")
    fine = result.verdict is Verdict.NO_EFFECT

    def compare() -> StructureComparison | None:
        setups = None if fit is None else _setups_of(fit, result.logs)
        return compare_structures(result.logs, setups, adequate_nominal=fine)

    compared = attempt("structures", compare, None, failed)
    if compared is None or not (compared.found and compared.adequate):
        return replace(result, structure=compared)
    stand_ins = tuple(cause.best.candidate.effect for cause in result.causes)
    return replace(result, structure=compared, causes=(), unknown_inputs=(), stand_ins=stand_ins)


def _setups_of(fit: FitResult, logs: Sequence[Log]) -> tuple[Setup, ...]:
    """Vehicle, soil, inputs and sensors of each log as fitted."""
    problem = fit.problem
    return tuple(problem.setup(RunModel(log, nuisances=problem.nuisances), fit.point) for log in logs)


def _not_judged(fit: FitResult) -> dict[str, str]:
    """Effects that cannot be distinguished from what some log states as unknown, and that."""
    missing = {what for run in fit.runs for what in run.log.config.unknown}
    missing |= {"torque" for run in fit.runs if not run.driven}
    return {effect: what for what, effects in _NOT_JUDGED.items() if what in missing for effect in effects}


def _checks(found: SearchResult, solver_error: float, logs: Sequence[Log]) -> VehicleChecks:
    return VehicleChecks(
        solver=solver_error,
        gate=tuple(found.holdout_gains),
        # A nominal model with large errors need not have a clean minimum: the reported model must.
        converged=found.extended.converged,
        threshold=found.threshold,
        overlap=found.extended.overlap,
        pose_age=tuple(pose_age(log) for log in logs),
        unknowns=found.extended.unknowns(),
        nuisances=found.extended.nuisance_values(),
    )


def split_runs(logs: Sequence[Log]) -> dict[int, list[RunModel]]:
    """Windows by their use: every run by time; several runs that are too short for that, one by one."""
    own = nuisances_of(logs)
    if len(logs) < 3 or min(log.duration for log in logs) >= SHORTEST:
        return {
            use: _with_windows([RunModel(log, use=use, nuisances=own) for log in logs])
            for use in (FIT, SELECT, REPORT)
        }
    # What only one run has cannot be known in another.
    first, second = round(0.6 * len(logs)), round(0.8 * len(logs))
    parts = {FIT: logs[:first], SELECT: logs[first : max(second, first + 1)]}
    parts[REPORT] = logs[max(second, first + 1) :]
    return {use: [RunModel(log, whole=use) for log in runs] for use, runs in parts.items()}


def _with_windows(runs: list[RunModel]) -> list[RunModel]:
    return [run for run in runs if len(run.windows) and len(run.y)]


def _not_testable(fit: FitResult, limits: Mapping[str, float], causes: Sequence[Cause]) -> dict[str, float]:
    vehicle = fit.runs[0].setup.plant.vehicle
    # Limits are those of the nominal model: an effect that was found all the same was testable.
    found = {one.candidate.effect for cause in causes for one in cause.alternatives}
    return {
        name: limit
        for name, limit in limits.items()
        if limit > EFFECTS[name].plausible(vehicle) and name not in found
    }


def _missing(fit: FitResult, library: Sequence[str]) -> dict[str, str]:
    """Effect -> the channels of which it needs one and the logs have none."""
    channels: set[str] = set().union(*(run.log.channels for run in fit.runs))
    found = {}
    for name in library:
        for group in EFFECTS[name].needs:
            if not channels & set(group) and EFFECTS[name].searched:
                found[name] = " or ".join(group)
    return found


def _with_forecasts(
    result: VehicleDiagnosis, found: SearchResult, runs: Sequence[RunModel]
) -> VehicleDiagnosis:
    """The result with the forecasts of both models: a cause that makes them worse is not named.

    Without the causes that are not certain, other parameters take over what these explain, which may lead
    further astray than all causes do: then the model with all of them is the extended one.
    """
    if not result.stated or result.model is None or not runs:
        return result
    named = replace(result, forecasts=predictions(found.nominal, result.model, runs))
    if result.partial is None or not named.misled:
        return named
    every = predictions(found.nominal, found.extended, runs)
    other = replace(result, partial=found.extended, forecasts=every)
    return named if other.misled else other


def _on_test_data(
    result: VehicleDiagnosis, found: SearchResult, runs: Sequence[RunModel]
) -> VehicleDiagnosis:
    """The result with both models on the test data: used once, after everything is decided."""
    if not result.stated or result.model is None or not runs:
        return result
    nominal = held_out(found.nominal, runs)
    extended = held_out(result.model, runs, nominal)
    return replace(result, on_test_data=(nominal, extended), gains=channel_gains(nominal, extended))
