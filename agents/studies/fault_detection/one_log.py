"""One log of the fault-detection study: a fault is injected, and the log diagnosed."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.discrepancy.checks.holdout_gain import Held, held_out
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.combined import combined
from estimators.discrepancy.faults.drive import TICK, Case, draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS, ONE_SIDED
from estimators.discrepancy.faults.other_forms import OTHER_FORMS, WRONG_NUMBERS
from estimators.discrepancy.faults.unmodelled import UNMODELLED_FAULTS
from estimators.discrepancy.model.fit import fit_runs, settled
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel, drives
from estimators.discrepancy.model.windows import FIT, REPORT
from estimators.discrepancy.physical_ranges import NEVER_NEGATIVE
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.search.result import SearchResult
from estimators.discrepancy.search.score_test import DETECTABLE, ScoreTest, candidates_for, score_test
from estimators.discrepancy.verdict import VehicleDiagnosis
from estimators.logs.immobile import stuck_spans
from estimators.logs.immobile_findings import IMMOBILE, hardly_driven, stuck_findings
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS, apply
from offroad_env.errors import OffroadError
from offroad_env.simulation.drive import Faults
from offroad_env.world.soils import SOILS

__all__ = ["NATURAL", "Numbers", "limits_beside", "limits_of", "natural_case", "possible", "run_unit"]

Numbers = dict[str, Any]  #: result of one unit, or of the study, as JSON takes it

#: Kinds of logs of the natural world.
NATURAL = ("natural", "wrong", "other", "library", "large", "two", "large two")
#: A fault that is possible lies within this share of its physical range: a size at an end is never named.
_WITHIN = 0.9
#: How often a limit is taken from a drive at twice the limit before, in which the vehicle gets stuck.
_ROUNDS = 3
#: A limit that is larger by no more than this share is the same.
_CLOSE = 0.1
#: Effects that cannot be negative.
_ONE_SIDED = (*ONE_SIDED, *NEVER_NEGATIVE, "aero_drag")
#: Where the soil of a fault changes, as parameters of the effect.
_PLACES = {"n_step": {"place": 35.0, "direction": 0.0}, "n_trend": {"place": 80.0, "direction": 0.0}}
#: Size of the unmodelled faults [share of the weight].
_UNMODELLED_SIZE = 0.03


def natural_case(seed: int) -> Case:
    """A run on an unknown road, with numbers within their tolerances and soil that scatters."""
    return draw_case(seed, road="unknown", natural=True)


def limits_of(seed: int, *, natural: bool = False) -> Numbers:
    """Smallest detectable sizes in the log of this seed, and similarity of the effects in it.

    From the same run without a fault; in the natural world also from those with each fault, see
    `_limit_with_fault`.
    """
    try:
        case = natural_case(seed) if natural else draw_case(seed)
        fit = fit_runs([RunModel(simulated_log(case), use=FIT)])
        result = score_test(fit, candidates_for(fit, tuple(EFFECTS)))
    except OffroadError as error:
        return {"failed": str(error)}
    names, cosines = result.by_effect()
    limits, run = result.limits(), fit.runs[0]
    ranges = {name: run.size_limits(name) for name in FAULTS if name in limits}
    if natural:
        limits |= {
            name: _limit_with_fault(case, name, limits[name], ranges[name])
            for name in OTHER_FORMS
            if name in ranges
        }
    return {
        "limits": limits,
        "ranges": {name: list(ends) for name, ends in ranges.items()},
        # Without a receiver it can have no fault.
        "alike": {name: _alike(result, name) for name in FAULTS if name in limits},
        "names": names,
        "cosines": cosines.round(4).tolist(),
    }


def _limit_with_fault(case: Case, name: str, limit: float, ends: tuple[float, float]) -> float:
    """Limit of a cause in the drive that has it at twice ``limit``, which is that of the drive without.

    A fault changes the drive: what grows with the sinkage scatters with the ground that shakes it, and a slow
    vehicle shows less, one that gets stuck next to nothing. Where no vehicle can have it the limit remains;
    where what is left before the vehicle gets stuck never shows half of what stops it, none exists.
    """
    beyond = max(map(abs, ends))
    for _ in range(_ROUNDS):
        size = _size(name, 2.0 * limit, case.seed)
        if not ends[0] < size < ends[1]:
            return limit
        log = simulated_log(case, _fault(name, size))
        own = _limit_in(log, name, size)
        if not stuck_spans(log):
            return max(limit, own) if math.isfinite(own) else limit
        if own <= limit:
            return limit
        limit = min(own, beyond)
    return beyond


def _limit_in(log: Log, name: str, size: float) -> float:
    """Limit of a cause in the log that has it at this size; infinite where there is too little to fit."""
    return _limits_in(log, [name], [size])[0]


def _limits_in(log: Log, names: Sequence[str], sizes: Sequence[float]) -> list[float]:
    """Limits of causes in the log that has all of them, each beside the others."""
    nowhere = [math.inf] * len(names)
    if any(hardly_driven(finding) for finding in stuck_findings(log)):
        return nowhere
    try:
        trial = refit(fit_runs([RunModel(log, use=FIT)]), [Candidate(effect=name) for name in names], sizes)
        if trial is None:
            return nowhere
        return [DETECTABLE * float(one) for one in settled(trial, fresh=False).size_deviations()]
    except OffroadError:
        return nowhere


def limits_beside(pair: str, multiple: float, seed: int, *, known: Mapping[int, Numbers]) -> Numbers:
    """Limits of two causes in the drive that has both at twice these, for a log at this multiple of them.

    Beside another cause one shows less: the drive is another one, and part of what it does the other may do.
    None where no vehicle can have both, where one never shows twice its limit, or where one shows less than
    its limit at the multiple: what stops a vehicle leaves nothing that shows the other.

    Parameters
    ----------
    pair
        Two names with + between.
    known
        Seed -> `limits_of` it: limits of each cause alone, from which it begins.
    """
    limits = {name: float(known[seed]["limits"][name]) for name in pair.split("+")}
    for _ in range(_ROUNDS):
        own = _own_limits(limits, 2.0, seed, known)
        if own is None:
            break
        if all(own[name] <= (1.0 + _CLOSE) * limit for name, limit in limits.items()):
            there = own if multiple == 2.0 else _own_limits(limits, multiple, seed, known)
            shown = there is not None and all(there[name] <= multiple * limits[name] for name in limits)
            return {"limits": [*limits.values()] if shown else None}
        limits = {name: max(own[name], limit) for name, limit in limits.items()}
    return {"limits": None}


def _own_limits(
    limits: Mapping[str, float], multiple: float, seed: int, known: Mapping[int, Numbers]
) -> dict[str, float] | None:
    """Limits in the drive that has both causes at this multiple of ``limits``; None where there is none."""
    if not all(possible(name, multiple, seed, {seed: known[seed] | {"limits": limits}}) for name in limits):
        return None
    sizes = [_size(name, multiple * limit, seed) for name, limit in limits.items()]
    try:
        own = _limits_in(_with_both(natural_case(seed), [*limits], sizes), [*limits], sizes)
    except OffroadError:
        return None
    return dict(zip(limits, own, strict=True))


def _with_both(case: Case, names: Sequence[str], sizes: Sequence[float]) -> Log:
    """The log with the first cause in the library's form, and the second in another one."""
    first, second = names
    return simulated_log(case, combined([_fault(first, sizes[0]), OTHER_FORMS[second](sizes[1])]))


def possible(name: str, multiple: float, seed: int, known: Mapping[int, Numbers]) -> bool:
    """Whether a fault of so many limits is one that a vehicle can have, so that a diagnosis may name it."""
    low, high = known[seed]["ranges"][name]
    return bool(_WITHIN * low <= _size(name, multiple * known[seed]["limits"][name], seed) <= _WITHIN * high)


def _mimicry(known: Numbers, gone: str, named: Sequence[str]) -> float:
    """Share of the trace of an effect that others reproduce together (R^2), in a run without a fault."""
    places = {name: i for i, name in enumerate(known["names"])}
    inside = [places[name] for name in named if name in places]
    if gone not in places or not inside:
        return 0.0
    cosines = np.array(known["cosines"])
    cross = cosines[inside, places[gone]]
    return float(cross @ np.linalg.lstsq(cosines[np.ix_(inside, inside)], cross, rcond=None)[0])


def _alike(result: ScoreTest, name: str) -> dict[str, float]:
    own = [i for i, candidate in enumerate(result.candidates) if candidate.effect == name]
    best = own[int(np.argmax(np.diag(result.information)[own]))]
    cosines = np.abs(result.cosines()[best])
    found: dict[str, float] = {}
    for candidate, cosine in zip(result.candidates, cosines, strict=True):
        found[candidate.effect] = max(found.get(candidate.effect, 0.0), float(cosine))
    return {effect: cosine for effect, cosine in found.items() if cosine > 0.5}


def run_unit(kind: str, name: str, multiple: float, seed: int, *, known: Mapping[int, Numbers]) -> Numbers:
    """One log with a fault, diagnosed; the truth is compared only afterwards.

    Parameters
    ----------
    kind
        "null", "white", "single", "pair", "removed", "unmodelled" or "same"; in the natural world "natural"
        (without a fault), "wrong" (a number of the description), "other" (of another form), "library" (the
        same cause in the library's form), "large" (likewise, far beyond the limit), "two" and "large two"
        (the first cause in the library's form, the second in another one).
    name
        The fault; two names with + between for a pair.
    multiple
        Size in multiples of the smallest detectable one.
    known
        Seed -> `limits_of` it.
    """
    case = natural_case(seed) if kind in NATURAL else draw_case(seed)
    try:
        if kind in NATURAL:
            return _natural(kind, name, multiple, case, known)
        if kind in ("null", "white"):
            return _diagnosed(simulated_log(case), case, white=kind == "white")
        if kind == "unmodelled":
            return _diagnosed(simulated_log(case, UNMODELLED_FAULTS[name](_UNMODELLED_SIZE)), case)
        names, limits = name.split("+"), known[seed]["limits"]
        sizes = [_size(one, multiple * limits[one], seed) for one in names]
        log = simulated_log(case, combined([_fault(one, x) for one, x in zip(names, sizes, strict=True)]))
        if kind == "same":
            return _same(log, case)
        gone = name if kind == "removed" else None
        truth = (name, sizes[0]) if kind == "single" and multiple == 2.0 else None
        result = _diagnosed(log, case, gone=gone, truth=truth)
        if gone is not None:
            result["mimicry"] = _mimicry(known[seed], gone, [members[0] for members in result["sets"]])
        truths = {one: size / limits[one] for one, size in zip(names, sizes, strict=True)}
        alike = known[seed]["alike"][names[0]]
        return result | {"sizes_true": sizes, "multiples": truths, "alike": alike}
    except OffroadError as error:
        return {"failed": str(error)}


def _natural(kind: str, name: str, multiple: float, case: Case, known: Mapping[int, Numbers]) -> Numbers:
    """One log of the natural world, with a fault or without one."""
    if kind == "natural":
        return _diagnosed(simulated_log(case), case)
    if kind == "wrong":
        return _diagnosed(simulated_log(case, WRONG_NUMBERS[name]), case)
    names, there = name.split("+"), known[case.seed]
    if len(names) > 1:
        beside = there["beside"][f"{kind} {name}"]
        sizes = [_size(one, multiple * limit, case.seed) for one, limit in zip(names, beside, strict=True)]
        shares = [limit / there["limits"][one] for one, limit in zip(names, beside, strict=True)]
        result = _diagnosed(_with_both(case, names, sizes), case)
        return result | {"size_true": sizes, "limit_over_alone": shares}
    size = _size(name, multiple * there["limits"][name], case.seed)
    fault = OTHER_FORMS[name](size) if kind == "other" else _fault(name, size)
    return _diagnosed(simulated_log(case, fault), case) | {"size_true": size}


def _size(name: str, size: float, seed: int) -> float:
    """Size with its sign drawn; a delay in whole ticks."""
    if name == "steer_delay":
        return max(round(size / TICK), 1) * TICK
    if name in _ONE_SIDED:
        return size
    return size * float(np.random.default_rng([seed, 3]).choice((-1.0, 1.0)))


def _fault(name: str, size: float) -> Faults:
    """A fault of this size; the lag of the simulation, held over ticks, gets the same mean delay."""
    if name == "steer_lag":
        size = TICK / math.log1p(TICK / size)
    return FAULTS[name](size)


def _diagnosed(
    log: Log,
    case: Case,
    *,
    white: bool = False,
    gone: str | None = None,
    truth: tuple[str, float] | None = None,
) -> Numbers:
    start = time.process_time()
    diagnosis = diagnose([log], white=white, library=[name for name in EFFECTS if name != gone])
    result = _summary(diagnosis, case) | {"seconds": time.process_time() - start}
    found, pair = diagnosis.search, diagnosis.on_test_data
    if truth is not None and found is not None and pair is not None:
        result["gain"] = _gains(found, pair, log, *truth)
    return result


def _summary(diagnosis: VehicleDiagnosis, case: Case) -> Numbers:
    found, checks = diagnosis.search, diagnosis.checks
    return {
        "verdict": diagnosis.verdict.value,
        "stuck": any(one.kind == IMMOBILE for one in diagnosis.findings),
        "road": case.road,
        "sets": [[one.candidate.effect for one in cause.alternatives] for cause in diagnosis.causes]
        + [[name for name, _ in stop.effects] for stop in diagnosis.stops if stop.effects],
        "stops": [stop.to_dict() for stop in diagnosis.stops],
        "sizes": [[(one.size, one.deviation) for one in cause.alternatives] for cause in diagnosis.causes],
        "structure": diagnosis.restructured is not None,
        "named": [cause.best.candidate.effect for cause in diagnosis.named],
        "strongest": float(np.abs(found.first.z).max()) if found else None,
        "threshold": found.threshold if found else None,
        "gate": list(found.holdout_gains) if found else [],
        "rest": {rest.equation: rest.p_value for rest in diagnosis.unknown_inputs},
        "converged": checks.converged if checks else None,
        "solver": checks.solver if checks else None,
        "regime": max((abs(rest.z) for rest in diagnosis.rests), default=None),
        "adequate": [not wrong for wrong in diagnosis.inadequate],
        "forecasts": [
            (one.quantity, one.horizon, one.nominal, one.extended, one.low, one.high, one.kept)
            for one in diagnosis.forecasts
        ],
        "failed_sections": dict(diagnosis.failed),
        "overlap": checks.overlap if checks else None,
        "refused": found.refused if found else None,
        "n_true": case.n,
        "n_fit": SOILS[case.soil].n + float(found.extended.nuisances[0]) if found else None,
    }


def _gains(
    found: SearchResult, pair: tuple[Held, Held], log: Log, name: str, size: float
) -> tuple[float, float]:
    """Gains on the test data, of the extended model and of one with the true effect."""
    run = copy.copy(drives(found.nominal.runs)[0])
    run.setup = apply(run.setup, [(name, {EFFECTS[name].size.name: size, **_PLACES.get(name, {})})])
    informed = fit_runs([run])
    # The noise of the diagnosis for both: likelihoods are compared under one law.
    informed = replace(informed, noise=found.extended.noise)
    apart = RunModel(log, use=REPORT)
    apart.setup = run.setup
    nominal, extended = pair
    weighed = replace(found.nominal, noise=informed.noise)
    before = held_out(weighed, nominal.fit.runs).cost
    return before - extended.cost, before - held_out(informed, [apart]).cost


def _same(log: Log, case: Case) -> Numbers:
    """Whether another order of the library and another name of the log change a diagnosis."""
    first = _summary(diagnose([log]), case)
    again = _summary(diagnose([replace(log, name="another")], library=list(EFFECTS)[::-1]), case)
    return first | {"same": first == again}
