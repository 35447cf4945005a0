"""``offroad reproduce rig_fault_detection``: diagnoses of wheel rigs, simulated with faults and measured.

Null rigs have no fault; single faults have multiples of the smallest detectable size; some faults are outside
the library. The faulty wheel is a second implementation. Then come the soil-bin trials of Carnegie Mellon
University, where they are at hand, with each slip angle in turn as test data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.fault_detection.one_log import Numbers
from agents.studies.fault_detection.results import MIMICRY, MULTIPLES, QUIET, share_of
from agents.studies.fault_detection.study import share_text
from agents.studies.runner import Key, run_units, stamp_of
from estimators.discrepancy.faults.rig import (
    RIG_FAULTS,
    UNMODELLED_RIG_FAULTS,
    RigCase,
    RigFault,
    draw_rig_case,
    simulated_trials,
)
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.rig.fit import fit_rig
from estimators.discrepancy.rig.settings import measured_trials
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from estimators.discrepancy.rig_diagnosis import diagnose_rig, rig_library
from estimators.discrepancy.search.score_test import candidates_for, score_test
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import Diagnosis
from estimators.rig.cmu_soil_bin import cmu_rig_log
from offroad_env.errors import DataError, OffroadError
from offroad_env.world.datasets import locate
from offroad_env.world.soils import SOILS

__all__ = ["RigFaultDetection", "counted", "run_rig_unit"]

#: Seeds of the report; tuning used those below 1000.
_FIRST_SEED = 1000
#: Size of the unmodelled faults [share of the load].
_UNMODELLED_SIZE = 0.1
_CHANNELS = ("sinkage", "drawbar", "side_force")
#: Slip angles of the measured trials, each the test data of one diagnosis.
_ANGLES = 6


def run_rig_unit(kind: str, name: str, multiple: float, seed: int) -> Numbers:
    """One set of trials diagnosed; the truth is compared only afterwards."""
    try:
        if kind == "measured":
            return _measured(seed)
        case = draw_rig_case(seed)
        if kind in ("null", "white"):
            return _diagnosed(case, None, white=kind == "white")
        if kind == "unmodelled":
            return _diagnosed(case, UNMODELLED_RIG_FAULTS[name](_UNMODELLED_SIZE))
        limit, alike, (low, high) = _limit(case, name)
        sign = float(np.random.default_rng([seed, 3]).choice((-1.0, 1.0)))
        # Where one sign is not physical, such as that of soil that pulls, the other is injected.
        sign = sign if low <= sign * multiple * limit <= high else -sign
        size = sign * multiple * limit
        library = [other for other in rig_library() if other != name] if kind == "removed" else None
        result = _diagnosed(case, RIG_FAULTS[name](size), library=library)
        return result | {"size": size, "limit": limit, "alike": alike}
    except OffroadError as error:
        return {"failed": str(error)}


def _limit(case: RigCase, name: str) -> tuple[float, dict[str, float], tuple[float, float]]:
    """Smallest detectable size in these trials without a fault, cosines, and the physical range."""
    log = simulated_trials(case)
    trials = measured_trials([log])
    fit = fit_rig(RigModel(log, trials.only(trials.uses() == FIT)))
    result = score_test(fit, candidates_for(fit, rig_library()))
    own = [candidate.effect for candidate in result.candidates].index(name)
    cosines = np.abs(result.cosines()[own])
    alike = {c.effect: float(cos) for c, cos in zip(result.candidates, cosines, strict=True) if cos > 0.5}
    return result.limits()[name], alike, trials_of(fit.runs).size_limits(name)


def _diagnosed(
    case: RigCase, fault: RigFault | None, *, white: bool = False, library: list[str] | None = None
) -> Numbers:
    diagnosis = diagnose_rig([simulated_trials(case, fault)], white=white, library=library)
    return _summary(diagnosis) | {"n_true": case.n, "n_stated": SOILS[case.soil].n}


def _measured(held: int) -> Numbers:
    log = cmu_rig_log(locate("cmu_single_wheel"))
    diagnosis = diagnose_rig([log], held=held)
    pair, found = diagnosis.on_test_data, diagnosis.search
    if found is None:
        raise DataError(f"{log.name}: the measured trials have problems: {diagnosis.findings[0].sentence}")
    report = None if pair is None else trials_of(pair[0].fit.runs).trials
    summary = summarise(diagnosis)
    return _summary(diagnosis) | {
        "angle": float(np.degrees(np.abs(report.slip_angle)).mean()) if report else None,
        "causes": summary.effects,
        "families": summary.families,
        "n": log.config.soil.n + float(found.extended.nuisances[0]),
        "wide": None if summary.n is None or summary.n.wide is None else asdict(summary.n.wide),
        "gain": {
            gain.channel: [gain.nominal, gain.extended, gain.low, gain.high] for gain in diagnosis.gains
        },
    }


def _summary(diagnosis: Diagnosis) -> Numbers:
    return {
        "verdict": diagnosis.verdict.value,
        "sets": [[one.candidate.effect for one in cause.alternatives] for cause in diagnosis.causes],
        "sizes": [[(one.size, one.deviation) for one in cause.alternatives] for cause in diagnosis.causes],
    }


@dataclass(kw_only=True)
class RigFaultDetection(Results):
    """Diagnoses of wheel rigs: false alarms, power, sets, wrong names; and the measured soil bin.

    Writes rig.jsonl with the result of every diagnosis (one that is there is not repeated).
    """

    quick: bool = False  #: a few of each kind
    nulls: int = 300  #: rigs without a fault
    whites: int = 100  #: of these, so many again with what repeats share taken for noise of each trial
    seeds: int = 8  #: rigs for each effect and size
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then count and print."""
        if self.quick:
            self.nulls, self.whites, self.seeds = 12, 4, 1
        stamp = stamp_of("estimators.discrepancy.rig_diagnosis", "estimators.discrepancy.faults.rig")
        units = dict.fromkeys(self._keys(), stamp)
        results = run_units(self.out / "rig.jsonl", run_rig_unit, units, label="rigs", n_jobs=self.n_jobs)
        numbers = counted(results)
        _show(numbers)
        self.save_numbers(numbers)

    def _keys(self) -> list[Key]:
        seeds = range(_FIRST_SEED, _FIRST_SEED + self.seeds)
        keys: list[Key] = [("single", name, 2.0, seed) for seed in seeds for name in RIG_FAULTS]
        keys += [("unmodelled", name, 1.0, seed) for seed in seeds for name in UNMODELLED_RIG_FAULTS]
        keys += [("removed", name, 4.0, seed) for seed in list(seeds)[:2] for name in RIG_FAULTS]
        keys += [("null", "", 0.0, _FIRST_SEED + i) for i in range(self.nulls)]
        keys += [("white", "", 0.0, _FIRST_SEED + i) for i in range(self.whites)]
        for multiple in MULTIPLES:
            keys += [
                ("single", name, multiple, seed) for seed in seeds for name in RIG_FAULTS if multiple != 2.0
            ]
        try:
            locate("cmu_single_wheel")
        except DataError as error:
            say(f"without the measured trials: {error}")
            return keys
        return keys + [("measured", "cmu", 0.0, held) for held in range(_ANGLES)]


def counted(results: Mapping[Key, Numbers]) -> Numbers:
    """Shares with intervals, from the results of all units."""
    done = {key: result for key, result in results.items() if "failed" not in result}
    numbers: Numbers = {"failed": len(results) - len(done)}
    for kind in ("null", "white"):
        own = [result for key, result in done.items() if key[0] == kind]
        numbers[kind] = _share([result["verdict"] not in QUIET for result in own])
    for multiple in MULTIPLES:
        singles = [(key[1], r) for key, r in done.items() if key[0] == "single" and key[2] == multiple]
        numbers[f"single at {multiple:g}"] = _singles(singles)
    for kind in ("unmodelled", "removed"):
        numbers[kind] = _share([_wrong_name(result) for key, result in done.items() if key[0] == kind])
    numbers["measured"] = [result for key, result in done.items() if key[0] == "measured"]
    return numbers


def _share(hits: list[bool]) -> Numbers:
    entry = share_of(sum(hits), len(hits))
    return {key: entry[key] for key in ("hits", "count", "low", "high")}


def _singles(own: list[tuple[str, Numbers]]) -> Numbers:
    found = [(name, r) for name, r in own if any(name in members for members in r["sets"])]
    sizes = [len(members) for name, r in found for members in r["sets"] if name in members]
    return {
        "detected": _share([r["verdict"] not in QUIET for _, r in own]),
        "truth in a set": _share([any(name in members for members in r["sets"]) for name, r in own]),
        "interval holds the truth": _share([_covers(name, r) for name, r in found]),
        "one name, and another than the truth": _share(
            [r["verdict"] == "NAMED" and _wrong_name(r) and [[name]] != r["sets"] for name, r in own]
        ),
        "mean set size": float(np.mean(sizes)) if sizes else None,
    }


def _covers(name: str, result: Numbers) -> bool:
    pairs = zip(result["sets"], result["sizes"], strict=True)
    members, sizes = next((members, sizes) for members, sizes in pairs if name in members)
    size, deviation = sizes[members.index(name)]
    return bool(abs(size - result["size"]) <= 1.959964 * deviation)


def _wrong_name(result: Numbers) -> bool:
    """Whether the verdict is NAMED, and one name does not have the trace of the fault in these trials."""
    alike = result.get("alike", {})
    copies = all(alike.get(members[0], 0.0) ** 2 >= MIMICRY for members in result["sets"])
    return result["verdict"] == "NAMED" and not copies


def _show(numbers: Numbers) -> None:
    heading = ("rigs", "alarm, wrong name or detected", "truth in a set", "interval holds", "set size")
    rows: list[tuple[str, ...]] = []
    for name, entry in numbers.items():
        if isinstance(entry, dict) and "count" in entry:
            rows.append((name, share_text(entry), "", "", ""))
        elif isinstance(entry, dict):
            parts = [share_text(entry[k]) for k in ("detected", "truth in a set", "interval holds the truth")]
            size = entry["mean set size"]
            rows.append((name, *parts, "-" if size is None else f"{size:.2f}"))
    console().print(table("faults on wheel rigs: share (95 % interval)", heading, rows))
    measured = [
        (
            f"{r['angle']:.0f}",
            r["verdict"],
            "; ".join(", ".join(families) for families in r["families"]),
            f"{r['n']:.2f}",
            *(_less(r["gain"][c]) for c in _CHANNELS),
        )
        for r in numbers["measured"]
        if r["gain"]
    ]
    if measured:
        columns = ("angle", "verdict", "families of causes", "n", *_CHANNELS)
        console().print(table("soil bin: errors at a slip angle [deg] not used", columns, measured, texts=3))
    if numbers["failed"]:
        say(f"{numbers['failed']} rigs could not be diagnosed")


def _less(gain: list[float]) -> str:
    nominal, extended, low, high = gain
    return f"{100.0 * (extended / nominal - 1.0):+.0f} % ({-100.0 * high:+.0f} to {-100.0 * low:+.0f})"
