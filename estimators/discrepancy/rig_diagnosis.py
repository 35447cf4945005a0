"""Diagnosis of the trials of a wheel rig: from the quality of the data to a result with its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher

from estimators.discrepancy.checks.holdout_gain import ChannelGain, Held, channel_gain
from estimators.discrepancy.checks.unmodelled_forces import UnmodelledForce, shapes_of
from estimators.discrepancy.data_quality import quality_of
from estimators.discrepancy.diagnosis import SCREEN_RATE
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.protocol import Channel
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT
from estimators.discrepancy.rig.fit import fit_rig, held_out_trials
from estimators.discrepancy.rig.jackknife import ground_by_blocks
from estimators.discrepancy.rig.repeat_noise import rig_noise
from estimators.discrepancy.rig.search import scored_only, search_rig
from estimators.discrepancy.rig.settings import measured_trials
from estimators.discrepancy.rig.structure_search import StructuralCause, search_structures
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from estimators.discrepancy.rig.trial_table import Trials
from estimators.discrepancy.search.result import SearchResult
from estimators.discrepancy.sections import attempt
from estimators.discrepancy.verdict import REST_RATE, RigChecks, RigDiagnosis
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["UNITS", "RigRest", "diagnose_rig", "rig_gains", "rig_library"]

#: Least number of conditions beyond the terms of a surface that is fitted to their means.
_SPARE = 4
#: Use of a condition -> its name in the checks.
_USES = {FIT: "search", SELECT: "gate", REPORT: "report"}
#: Units of the channels that are no forces.
UNITS = {"sinkage": "m", "torque": "N m"}


@dataclass(frozen=True, kw_only=True)
class RigRest(UnmodelledForce):
    """Residual means of the conditions in one channel: ``force`` is in the unit of the channel."""

    unit: str = "N"


def rig_library() -> tuple[str, ...]:
    """Effects that act on a wheel rig."""
    return tuple(name for name, effect in EFFECTS.items() if "rig" in effect.models and effect.searched)


def diagnose_rig(
    logs: Sequence[Log],
    *,
    library: Sequence[str] | None = None,
    held: int | None = None,
    white: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> RigDiagnosis:
    """Find the errors of the model in these trials of one wheel on one soil.

    Parameters
    ----------
    library
        Effects that may be named; default all that act on a rig.
    held
        Index of the slip angle (by size) that is kept as test data; default the middle one.
    white
        Take what the repeats of a condition share for independent noise: only to show the consequences.
    progress
        Called with the name of every stage that begins.

    Raises
    ------
    DataError
        If the trials cannot be used at all.
    SolverFailure
        If the nominal model cannot be run.
    """
    library = rig_library() if library is None else tuple(library)
    progress("data quality")
    failed: dict[str, str] = {}
    reports = quality_of(logs, failed)
    problems = tuple(finding for report in reports for finding in report.problems)
    if problems:
        return RigDiagnosis(logs=tuple(logs), quality=reports, findings=problems, failed=failed)
    trials = measured_trials(logs)
    use = trials.uses(held)
    parts = {u: RigModel(logs[0], trials.only(use == u)) for u in _USES if (use == u).any()}
    progress("nominal model")
    nominal = fit_rig(parts[FIT], white=white)
    progress("scores")
    found = _search(nominal, library, parts.get(SELECT), progress, failed)
    without: tuple[SearchResult, StructuralCause | None] = (found, None)
    found, structure = attempt(
        "laws of the wheel",
        lambda: _other_laws(without[0], library, parts.get(SELECT), progress),
        without,
        failed,
    )
    progress("unknown inputs")
    result = RigDiagnosis(
        logs=tuple(logs),
        quality=reports,
        search=found,
        causes=found.causes,
        structure=structure,
        unknown_inputs=attempt("unknown inputs", lambda: lack_of_fit(found.extended), (), failed),
        nominal_excess=sum(rest.excess for rest in lack_of_fit(nominal)),
        limits=_limits(found),
        not_testable=_not_testable(parts[FIT], _limits(found)),
        failed=failed,
        checks=_checks(found, trials, use, failed),
    )
    progress("test data")
    return _on_test_data(result, found, parts.get(REPORT))


def _checks(found: SearchResult, trials: Trials, use: np.ndarray, failed: dict[str, str]) -> RigChecks:
    """Numerical checks, and what the settings and n are worth."""
    return RigChecks(
        solver=found.solver_error(),
        gate=tuple(found.holdout_gains),
        converged=found.extended.converged,
        threshold=found.threshold,
        trials=len(trials),
        left_out=trials.left_out,
        conditions={name: len(np.unique(trials.condition[use == u])) for u, name in _USES.items()},
        ground_by_blocks=attempt("n by slip angle", lambda: ground_by_blocks(found.extended), (), failed),
        setting_errors=(float(trials.load_error.max()), float(trials.slip_error.max())),
    )


def _search(
    nominal: FitResult,
    library: Sequence[str],
    apart: RigModel | None,
    progress: Callable[[str], None],
    failed: dict[str, str],
) -> SearchResult:
    """The search for effects; where it breaks down, the scores alone."""
    found = attempt(
        "search", lambda: search_rig(nominal, library, SCREEN_RATE, apart, progress), None, failed
    )
    return scored_only(nominal, library, SCREEN_RATE) if found is None else found


def _other_laws(
    found: SearchResult,
    library: Sequence[str],
    apart: RigModel | None,
    progress: Callable[[str], None],
) -> tuple[SearchResult, StructuralCause | None]:
    """Other laws of the wheel, where the model is inadequate and a single effect does not mend it."""
    alarm = float(np.abs(found.first.z).max(initial=0.0)) > found.threshold
    rest = any(one.p_value < REST_RATE for one in lack_of_fit(found.extended))
    if not rest and (len(found.causes) == 1 or not alarm):
        return found, None
    return search_structures(found, library, SCREEN_RATE, apart, progress)


def _limits(found: SearchResult) -> dict[str, float]:
    """Smallest detectable sizes, with the causes in the model: what they explain is no noise for others."""
    return (found.last if found.causes else found.first).limits()


def _not_testable(run: RigModel, limits: Mapping[str, float]) -> dict[str, float]:
    vehicle = run.setup.plant.vehicle
    return {name: limit for name, limit in limits.items() if limit > EFFECTS[name].plausible(vehicle)}


def lack_of_fit(fit: FitResult) -> tuple[RigRest, ...]:
    """Residual means of the conditions by channel, and whether they depend on the settings.

    Soil that was prepared a little differently for each condition scatters the means, too. The model lacks
    an effect only where they follow the settings more than such scatter would.
    """
    run, noise, found = trials_of(fit.runs), rig_noise(fit), []
    for channel in run.channels:
        group, own = noise.groups[channel.name], fit.residual[channel.rows]
        count = np.bincount(group)
        mean = np.bincount(group, own) / count
        scatter = noise.channels[channel.name].repeat ** 2
        settings = _settings(run, channel, group)
        found.append(
            RigRest(
                equation=channel.name,
                gain=float(np.sum(count * mean**2)) / scatter,
                freedom=len(count),
                p_value=_shape_p_value(settings, mean, count),
                force=mean,
                deviation=np.sqrt(scatter / count),
                shapes=shapes_of(settings, mean, count),
                unit=UNITS.get(channel.name, "N"),
            )
        )
    return tuple(found)


def _settings(run: RigModel, channel: Channel, group: np.ndarray) -> dict[str, np.ndarray]:
    """Means of the settings of every condition that a channel has."""
    trials, rows, count = run.trials, channel.record, np.bincount(group)
    settings = {
        "slip [-]": trials.slip,
        "size of the slip [-]": np.abs(trials.slip),
        "slip angle [rad]": np.abs(trials.slip_angle),
        "load [N]": trials.load,
    }
    return {name: np.bincount(group, values[rows]) / count for name, values in settings.items()}


def _shape_p_value(settings: dict[str, np.ndarray], mean: np.ndarray, weight: np.ndarray) -> float:
    """p-value of the residual means following a quadratic surface over the settings (F test)."""
    table = np.stack(list(settings.values()), axis=1)
    table = table[:, np.ptp(table, axis=0) > 1e-6]
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    root = np.sqrt(weight)
    products = [table[:, i] * table[:, j] for i in range(table.shape[1]) for j in range(i + 1)]
    # Few conditions do not determine all products.
    for more in (products, table.T**2, ()):
        basis = root[:, None] * np.column_stack([np.ones(len(mean)), table, *more])
        solution, _, rank, _ = np.linalg.lstsq(basis, root * mean, rcond=1e-6)
        spare = len(mean) - rank
        if spare >= _SPARE:
            break
    else:
        return 1.0
    follows, keeps = np.sum((basis @ solution) ** 2), np.sum((root * mean - basis @ solution) ** 2)
    return float(fisher.sf(follows / rank * spare / max(keeps, 1e-300), rank, spare))


def _on_test_data(result: RigDiagnosis, found: SearchResult, run: RigModel | None) -> RigDiagnosis:
    """The result with both models on the test conditions: used once, after everything is decided."""
    if result.model is found.nominal or run is None:
        return result
    try:
        nominal, extended = held_out_trials(found.nominal, run), held_out_trials(found.extended, run)
    except OffroadError:
        return result
    return replace(result, on_test_data=(nominal, extended), gains=rig_gains(nominal, extended))


def rig_gains(nominal: Held, extended: Held, seed: int = 0) -> tuple[ChannelGain, ...]:
    """Errors of both models by channel, with intervals over whole conditions."""
    rng = np.random.default_rng(seed)
    run, found = trials_of(nominal.fit.runs), []
    for channel in run.channels:
        group = np.unique(run.condition_of(channel), return_inverse=True)[1]
        before, after = (np.bincount(group, held.residual[channel.rows] ** 2) for held in (nominal, extended))
        found.append(channel_gain(channel.name, before, after, len(group), rng))
    return tuple(found)
