"""``offroad reproduce diagnosis``: effects are hidden in simulated logs, and the finder must find them.

Null logs hide nothing: how often does the finder cry wolf, and how often if it took all noise for white?
Single effects at multiples of the smallest size that the log could show; forces that the library does not
hold; a library from which the true effect was taken. Nothing that hides uses the finder's own laws.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agents.commands.output import Results, console, say, table
from agents.studies.units import Key, run_units, stamp_of
from estimators.discrepancy.diagnosis import Diagnosis, diagnose
from estimators.discrepancy.fit import fit_runs
from estimators.discrepancy.hide import (
    HIDERS,
    ONE_SIDED,
    STRANGERS,
    Case,
    Hidden,
    draw_case,
    hidden_log,
)
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.screen import candidates_for, screen
from estimators.discrepancy.windows import FIT
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.soils import SOILS

__all__ = ["DiagnosisStudy", "run_unit", "wilson"]

#: Seeds of the report; tuning used those below 1000.
_FIRST_SEED = 1000
MULTIPLES = (0.5, 1.0, 2.0, 4.0)
#: Effects that cannot be negative.
_ONE_SIDED = (*ONE_SIDED, "aero_drag")
#: Size of the forces without a name [share of the weight].
_STRANGE = 0.03
#: An explanation that copies this share of the removed effect's trace is no wrong name.
MIMICRY = 0.9


def wilson(hits: int, count: int, z: float = 1.959964) -> tuple[float, float]:
    """95 % interval of a share (Wilson, JASA 22, 1927)."""
    if count == 0:
        return 0.0, 1.0
    p, centre = hits / count, hits / count + z * z / (2.0 * count)
    half = z * math.sqrt(p * (1.0 - p) / count + z * z / (4.0 * count * count))
    scale = 1.0 + z * z / count
    return max((centre - half) / scale, 0.0), min((centre + half) / scale, 1.0)


def run_unit(kind: str, name: str, multiple: float, seed: int) -> dict:
    """One log hidden and diagnosed; the answer is compared only afterwards."""
    case = draw_case(seed)
    try:
        if kind in ("null", "white"):
            return _diagnosed(case, None, white=kind == "white")
        if kind == "stranger":
            return _diagnosed(case, STRANGERS[name](_STRANGE))
        sign = 1.0 if name in _ONE_SIDED else float(np.random.default_rng([seed, 3]).choice((-1.0, 1.0)))
        limit, alike = _limit(case, name)
        size = sign * multiple * limit
        library = [other for other in EFFECTS if other != name] if kind == "removed" else None
        result = _diagnosed(case, HIDERS[name](size), library=library)
        return result | {"size": size, "limit": limit, "alike": alike}
    except OffroadError as error:
        return {"failed": str(error)}


def _limit(case: Case, name: str) -> tuple[float, dict[str, float]]:
    """Smallest size that this log would show, from the same run with nothing hidden; and cosines."""
    fit = fit_runs([RunModel(hidden_log(case), use=FIT)])
    result = screen(fit, candidates_for(fit, tuple(EFFECTS)))
    own = [i for i, candidate in enumerate(result.candidates) if candidate.effect == name]
    best = own[int(np.argmax(np.diag(result.information)[own]))]
    cosines = np.abs(result.cosines()[best])
    alike = {c.effect: float(cos) for c, cos in zip(result.candidates, cosines, strict=True) if cos > 0.5}
    return result.limits()[name], alike


def _diagnosed(
    case: Case, hidden: Hidden | None, *, white: bool = False, library: Sequence[str] | None = None
) -> dict:
    log = hidden_log(case, hidden)
    start = time.process_time()
    diagnosis = diagnose([log], white=white, library=library)
    return _summary(diagnosis, case) | {"seconds": time.process_time() - start}


def _summary(diagnosis: Diagnosis, case: Case) -> dict:
    found = diagnosis.search
    return {
        "verdict": diagnosis.verdict,
        "road": case.road,
        "sets": [[rival.candidate.effect for rival in cause.rivals] for cause in diagnosis.causes],
        "sizes": [[(rival.size, rival.deviation) for rival in cause.rivals] for cause in diagnosis.causes],
        "strongest": float(np.abs(found.first.z).max()) if found else None,
        "threshold": found.threshold if found else None,
        "searched": [candidate.effect for candidate in found.extended.candidates] if found else [],
        "rest": {rest.equation: rest.chance for rest in diagnosis.rest},
        "converged": diagnosis.checks.get("converged"),
        "n_true": case.n,
        "n_fit": SOILS[case.soil].n + float(found.extended.nuisances[0]) if found else None,
    }


@dataclass(kw_only=True)
class DiagnosisStudy(Results):
    """Hide and find: false alarms, power, sets, wrong names.

    Writes diagnosis.jsonl with the result of every log (a log that is there is not repeated) and
    diagnosis.json.
    """

    quick: bool = False  #: a few logs of each kind
    nulls: int = 300  #: logs with nothing wrong
    whites: int = 30  #: of these, so many again with all noise taken for white
    seeds: int = 8  #: logs for each effect and size
    effects: tuple[str, ...] = tuple(HIDERS)  #: effects to hide
    n_jobs: int = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then count and print."""
        if self.quick:
            self.nulls, self.whites, self.seeds = 6, 2, 1
        stamp = stamp_of("estimators.discrepancy.diagnosis", "estimators.discrepancy.hide")
        units = dict.fromkeys(self._keys(), stamp)
        results = run_units(
            self.out / "diagnosis.jsonl", run_unit, units, label="hide and find", n_jobs=self.n_jobs
        )
        numbers = counted(results)
        _show(numbers)
        self.save_numbers(numbers)

    def _keys(self) -> list[Key]:
        first = range(_FIRST_SEED, _FIRST_SEED + self.seeds)
        keys: list[Key] = [("null", "", 0.0, _FIRST_SEED + i) for i in range(self.nulls)]
        keys += [("single", name, 2.0, seed) for seed in first for name in self.effects]
        keys += [("white", "", 0.0, _FIRST_SEED + i) for i in range(self.whites)]
        keys += [("stranger", name, 1.0, seed) for seed in first for name in STRANGERS]
        keys += [("removed", name, 4.0, seed) for seed in first[:2] for name in self.effects]
        others = [multiple for multiple in MULTIPLES if multiple != 2.0]
        keys += [
            ("single", name, multiple, seed) for seed in first for name in self.effects for multiple in others
        ]
        return keys


def counted(results: Mapping[Key, dict]) -> dict:
    """Shares with intervals, from the results of all units."""
    numbers: dict = {"failed": sum("failed" in result for result in results.values())}
    for kind in ("null", "white"):
        verdicts = [r["verdict"] for key, r in results.items() if key[0] == kind and "failed" not in r]
        alarms = sum(verdict not in ("NO EFFECT", "NOT TESTABLE") for verdict in verdicts)
        numbers[kind] = _share(alarms, len(verdicts))
    for multiple in MULTIPLES:
        own = [
            (key[1], r)
            for key, r in results.items()
            if key[0] == "single" and key[2] == multiple and "failed" not in r
        ]
        numbers[f"single at {multiple:g}"] = _singles(own)
    confident = [
        (key, r) for key, r in results.items() if key[0] in ("stranger", "removed") and "failed" not in r
    ]
    for kind in ("stranger", "removed"):
        own = [(key, r) for key, r in confident if key[0] == kind]
        numbers[kind] = _share(sum(_wrong_name(key, r) for key, r in own), len(own))
    return numbers


def _share(hits: int, count: int) -> dict:
    low, high = wilson(hits, count)
    return {"hits": hits, "count": count, "share": hits / max(count, 1), "low": low, "high": high}


def _singles(own: Sequence[tuple[str, dict]]) -> dict:
    detected = [(name, r) for name, r in own if r["verdict"] not in ("NO EFFECT", "NOT TESTABLE")]
    inside = [(name, r) for name, r in own if any(name in members for members in r["sets"])]
    covered = sum(_covers(name, r) for name, r in inside)
    sizes = [len(members) for name, r in inside for members in r["sets"] if name in members]
    return {
        "detected": _share(len(detected), len(own)),
        "truth in a set": _share(len(inside), len(own)),
        "interval holds the truth": _share(covered, len(inside)),
        "mean set size": float(np.mean(sizes)) if sizes else None,
    }


def _covers(name: str, result: dict) -> bool:
    for members, sizes in zip(result["sets"], result["sizes"], strict=True):
        if name in members:
            size, deviation = sizes[members.index(name)]
            return abs(size - result["size"]) <= 1.959964 * deviation
    return False


def _wrong_name(key: Key, result: dict) -> bool:
    """One name without a doubt, and not one that looks the same to this log."""
    if result["verdict"] != "NAMED":
        return False
    alike = result.get("alike", {})
    return not all(alike.get(members[0], 0.0) ** 2 >= MIMICRY for members in result["sets"])


def _show(numbers: dict) -> None:
    rows = []
    for name, entry in numbers.items():
        if isinstance(entry, dict) and "share" in entry:
            rows.append((name, _text(entry), "", "", ""))
        elif isinstance(entry, dict):
            size = entry["mean set size"]
            parts = [_text(entry[k]) for k in ("detected", "truth in a set", "interval holds the truth")]
            rows.append((name, *parts, "-" if size is None else f"{size:.2f}"))
    heading = ("logs", "alarm, or wrong name, or detected", "truth in a set", "interval holds", "set size")
    console().print(table("hide and find: share (95 % interval) of logs", heading, rows))
    if numbers["failed"]:
        say(f"{numbers['failed']} logs could not be driven or diagnosed")


def _text(entry: dict) -> str:
    return f"{entry['hits']}/{entry['count']} ({entry['low']:.1%} to {entry['high']:.1%})"
