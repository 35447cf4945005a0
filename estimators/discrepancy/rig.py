"""The whole procedure on the trials of a wheel rig: from data quality to one verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from estimators.discrepancy.diagnosis import REST_RATE, SCREEN_RATE, Diagnosis
from estimators.discrepancy.gain import ChannelGain, Held
from estimators.discrepancy.probe import Rest, shapes_of
from estimators.discrepancy.rig_fit import RigFit, fit_rig, held_out_trials
from estimators.discrepancy.rig_model import RigModel, Trials
from estimators.discrepancy.rig_search import search_rig
from estimators.discrepancy.run_model import Channel
from estimators.discrepancy.windows import FIT, REPORT, SELECT
from estimators.logs.log import Log
from estimators.logs.quality import quality
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["RigRest", "diagnose_rig", "rig_library"]

#: Share of what is wrong beyond the repeats' scatter that must be left over before the causes found count
#: as no explanation. Repeats agree far better than any law of soil: more is left than in a vehicle's log.
_LEFT_OVER = 1.0 / 3.0
#: An error of the solver moves scores by less than this, absolutely or as a share of the largest.
_SOLVER, _SOLVER_SHARE = 1.0, 0.1
#: Trials can test the library if they would see this share of it at the largest plausible size.
_TESTABLE = 0.5
#: Units of the channels that are no forces.
_UNITS = {"sinkage": "m", "torque": "N m"}
#: Draws of whole conditions behind an interval.
_DRAWS = 2000


@dataclass(frozen=True, kw_only=True)
class RigRest(Rest):
    """What the means of the conditions keep of one channel: ``force`` is in the channel's unit."""

    unit: str = "N"


def rig_library() -> tuple[str, ...]:
    """Effects that mean something on a wheel rig."""
    return tuple(name for name, effect in EFFECTS.items() if "rig" in effect.models and effect.searched)


def diagnose_rig(
    logs: Sequence[Log],
    *,
    library: Sequence[str] | None = None,
    held: int | None = None,
    white: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """Say what the model gets wrong in these trials of one wheel on one soil.

    Parameters
    ----------
    library
        Effects that may be named; default all that mean something here.
    held
        Number of the slip angle (by size) that only the report sees; default the middle one.
    white
        Take what the repeats of a condition share for independent noise: only to show what that does.
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
    findings = tuple(finding for log in logs for finding in quality(log).problems)
    if findings:
        return Diagnosis(verdict="DATA PROBLEM", findings=findings, logs=tuple(logs))
    trials = Trials.of(logs)
    use = trials.uses(held)
    parts = {u: RigModel(logs[0], trials.only(use == u)) for u in (FIT, SELECT, REPORT) if (use == u).any()}
    progress("nominal model")
    nominal = fit_rig(parts[FIT], white=white)
    progress("scores")
    found = search_rig(nominal, library, SCREEN_RATE, parts.get(SELECT), progress)
    progress("what is left")
    solver = found.solver_error()
    causes = found.causes
    # What the causes leave is the noise that hides another effect, not what the nominal model leaves.
    limits = (found.last if causes else found.first).limits()
    vehicle = parts[FIT].setup.plant.vehicle
    result = Diagnosis(
        verdict="",
        causes=causes,
        rest=lack_of_fit(found.extended),
        limits=limits,
        not_testable={n: limit for n, limit in limits.items() if limit > EFFECTS[n].plausible(vehicle)},
        checks={
            "solver": solver,
            "gate": list(found.gate),
            "converged": nominal.converged,
            "threshold": found.threshold,
            "trials": {"used": len(trials), "left_out": trials.left_out},
            "conditions": {
                name: len(np.unique(trials.condition[use == u]))
                for name, u in (("search", FIT), ("gate", SELECT), ("report", REPORT))
            },
        },
        search=found,
        logs=tuple(logs),
    )
    result.verdict = _verdict(result, solver, nominal)
    progress("gain")
    if causes and REPORT in parts:
        _report(result, parts[REPORT])
    return result


def lack_of_fit(fit: RigFit) -> tuple[RigRest, ...]:
    """What the conditions' means keep, channel by channel: how much, and whether it has a shape.

    Soil that was prepared a little differently for each condition scatters the means, too. Something is
    missing in the model only where they follow the settings, beyond what such scatter would.
    """
    found = []
    for channel in fit.runs[0].channels:
        group, own = fit.whitener.groups[channel.name], fit.residual()[channel.rows]
        count = np.bincount(group)
        mean = np.bincount(group, own) / count
        scatter = fit.whitener.noise[channel.name].repeat ** 2
        settings = _settings(fit.runs[0], channel, group)
        found.append(
            RigRest(
                equation=channel.name,
                gain=float(np.sum(count * mean**2)) / scatter,
                freedom=len(count),
                chance=_chance_of_shape(settings, mean, count),
                force=mean,
                deviation=np.sqrt(scatter / count),
                shapes=shapes_of(settings, mean, count),
                unit=_UNITS.get(channel.name, "N"),
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


def _chance_of_shape(settings: dict[str, np.ndarray], mean: np.ndarray, weight: np.ndarray) -> float:
    """Share of scatters without any shape that follow a smooth surface over the settings as closely."""
    table = np.stack(list(settings.values()), axis=1)
    table = table[:, np.ptp(table, axis=0) > 1e-6]
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    products = [table[:, i] * table[:, j] for i in range(table.shape[1]) for j in range(i + 1)]
    root = np.sqrt(weight)
    basis = root[:, None] * np.column_stack([np.ones(len(mean)), table, *products])
    solution, _, rank, _ = np.linalg.lstsq(basis, root * mean, rcond=1e-6)
    spare = len(mean) - rank
    if spare < 4:
        return 1.0
    follows, keeps = np.sum((basis @ solution) ** 2), np.sum((root * mean - basis @ solution) ** 2)
    return float(fisher.sf(follows / rank * spare / max(keeps, 1e-300), rank, spare))


def _verdict(result: Diagnosis, solver: float, nominal: RigFit) -> str:
    strongest = float(np.abs(result.search.first.z).max(initial=0.0))
    if solver > max(_SOLVER, _SOLVER_SHARE * strongest) or not result.checks["converged"]:
        return "NUMERICS"
    if any(rest.chance < REST_RATE for rest in result.rest):
        left = sum(rest.excess for rest in result.rest)
        before = sum(rest.excess for rest in lack_of_fit(nominal))
        explains = result.causes and left <= _LEFT_OVER * before
        return "NAMED + UNEXPLAINED REST" if explains else "UNEXPLAINED"
    if result.causes:
        return "ONE OF" if any(len(cause.rivals) > 1 for cause in result.causes) else "NAMED"
    seen = len(result.limits) - len(result.not_testable)
    return "NOT TESTABLE" if seen < _TESTABLE * len(result.limits) else "NO EFFECT"


def _report(result: Diagnosis, run: RigModel) -> None:
    """Open the report's conditions: once, after everything is decided."""
    try:
        pair = tuple(held_out_trials(fit, run) for fit in (result.search.nominal, result.search.extended))
    except OffroadError:
        return
    result.report, result.gains = pair, rig_gains(*pair)


def rig_gains(nominal: Held, extended: Held, seed: int = 0) -> tuple[ChannelGain, ...]:
    """Errors of both models by channel, with intervals over whole conditions."""
    rng = np.random.default_rng(seed)
    run, found = nominal.fit.runs[0], []
    for channel in run.channels:
        group = np.unique(run.condition_of(channel), return_inverse=True)[1]
        before, after = (np.bincount(group, held.residual[channel.rows] ** 2) for held in (nominal, extended))
        draws = rng.integers(len(before), size=(_DRAWS, len(before)))
        ratio = 1.0 - np.sqrt(after[draws].sum(axis=1) / np.maximum(before[draws].sum(axis=1), 1e-300))
        low, high = np.quantile(ratio, (0.025, 0.975))
        found.append(
            ChannelGain(
                channel=channel.name,
                nominal=float(np.sqrt(before.sum() / len(group))),
                extended=float(np.sqrt(after.sum() / len(group))),
                low=float(low),
                high=float(high),
            )
        )
    return tuple(found)
