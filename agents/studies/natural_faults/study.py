"""``offroad reproduce natural_faults``: faults in a natural world, one step outside the library's own.

Soil scatters, the road is unknown, and no number is exactly as stated. Faults have the library's form, or
another form of the same cause, or are a wrong number of the description, alone or two at once; causes are
judged by their family. A fault that no vehicle can have, since its size is beyond the physical range that a
diagnosis holds it to, is left out: the limit of the log is beyond it, too. The limit of a cause is that in
the drive that has it, and has the other one where there are two. Two are left out where one of them never
shows twice its limit, or less than its limit at seven times, as where the other stops the vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from agents.commands.options import Jobs
from agents.reports.output import Results, console, table
from agents.studies.fault_detection.one_log import Numbers, limits_beside, limits_of, possible, run_unit
from agents.studies.fault_detection.results import QUIET, share_of
from agents.studies.fault_detection.study import share_text
from agents.studies.runner import Key, run_units, stamp_of
from estimators.discrepancy.faults.other_forms import FAMILIES, OTHER_FORMS, WRONG_NUMBERS

__all__ = ["NaturalFaults", "counted_naturally"]

#: Multiple of the limit of a large fault.
_LARGE = 7.0
#: Multiple of their limits of two causes, by kind of log, and the kind of unit with these limits.
_PAIRS, _BESIDE = {"two": 2.0, "large two": _LARGE}, "limits of pairs"


@dataclass(kw_only=True)
class NaturalFaults(Results):
    """Faults in logs of a natural world: false alarms, families of causes, wrong numbers.

    Writes natural.jsonl with the result of every log (a log that is there is not repeated) and natural.json.
    """

    nulls: int = 300  #: logs without a fault
    seeds: int = 24  #: logs for each cause in each form, at twice its limit
    large: int = 7  #: logs for each cause at seven times its limit
    pairs: int = 7  #: pairs of causes of every seed, at twice their limits; half as many at seven times
    wrong: int = 17  #: logs for each wrong number
    first_seed: Annotated[int, arg(help="of the logs: others are a fresh sample")] = 5000  #: of the logs
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then count and print."""
        path = self.out / "natural.jsonl"
        stamp = stamp_of("agents.studies.fault_detection.one_log")
        seeds = [self.first_seed + i for i in range(max(self.seeds, self.large))]
        keys: list[Key] = [("limits", seed) for seed in seeds]
        stamps = dict.fromkeys(keys, stamp)
        limits = run_units(path, _limits, stamps, label="limits", n_jobs=self.n_jobs)
        known = {key[1]: found for key, found in limits.items() if "failed" not in found}
        known = self._with_pairs(path, known, stamp)
        work = partial(run_unit, known=known)
        stamps = dict.fromkeys(self._keys(known), stamp)
        results = run_units(path, work, stamps, label="logs", n_jobs=self.n_jobs)
        numbers = counted_naturally(results)
        rows = [(name, *(share_text(numbers[name][what]) for what in _COUNTS)) for name in numbers]
        console().print(table("faults in a natural world", ("logs", *_COUNTS), rows))
        self.save_numbers(numbers)

    def _with_pairs(self, path: Path, known: Mapping[int, Numbers], stamp: str) -> dict[int, Numbers]:
        """With the limits of two causes beside each other, of all pairs that a vehicle can have."""
        keys: list[Key] = [
            (_BESIDE, kind, pair, seed)
            for kind in _PAIRS
            for seed in sorted(known)
            for pair in self._drawn(kind, seed, known)
        ]
        work = partial(_limits_beside, known=known)
        found = run_units(path, work, dict.fromkeys(keys, stamp), label="limits of pairs", n_jobs=self.n_jobs)
        beside: dict[int, Numbers] = {seed: {} for seed in known}
        for (_, kind, pair, seed), result in found.items():
            if result["limits"] is not None:
                beside[seed][f"{kind} {pair}"] = result["limits"]
        return {seed: there | {"beside": beside[seed]} for seed, there in known.items()}

    def _keys(self, known: Mapping[int, Numbers]) -> list[Key]:
        """All logs; the first part of them has about the same share of every kind."""
        by_kind: dict[str, list[Key]] = {}
        for key in self._by_kind(known):
            by_kind.setdefault(str(key[0]), []).append(key)
        shares = [((i + 0.5) / len(own), kind) for kind, own in by_kind.items() for i in range(len(own))]
        places = {kind: iter(own) for kind, own in by_kind.items()}
        return [next(places[kind]) for _, kind in sorted(shares)]

    def _by_kind(self, known: Mapping[int, Numbers]) -> list[Key]:
        first = self.first_seed
        keys: list[Key] = [("natural", "", 0.0, first + i) for i in range(self.nulls)]
        keys += [("wrong", name, 1.0, first + i) for i in range(self.wrong) for name in WRONG_NUMBERS]
        for kind, multiple, count in (
            ("other", 2.0, self.seeds), ("library", 2.0, self.seeds), ("large", _LARGE, self.large),
        ):  # fmt: skip
            keys += [
                (kind, name, multiple, seed)
                for seed in sorted(known)[:count]
                for name in OTHER_FORMS
                if name in known[seed]["ranges"] and possible(name, multiple, seed, known)
            ]
        for kind, multiple in _PAIRS.items():
            keys += [
                (kind, pair, multiple, seed)
                for seed in sorted(known)
                for pair in self._drawn(kind, seed, known)
                if f"{kind} {pair}" in known[seed]["beside"]
            ]
        return keys

    def _drawn(self, kind: str, seed: int, known: Mapping[int, Numbers]) -> list[str]:
        """Two causes of different families each, drawn from those that a vehicle can have alone."""
        multiple, there = _PAIRS[kind], known[seed]["ranges"]
        names = [name for name in OTHER_FORMS if name in there and possible(name, multiple, seed, known)]
        every = [f"{a}+{b}" for a in names for b in names if not set(FAMILIES[a]) & set(FAMILIES[b])]
        order = np.random.default_rng([seed, 5]).permutation(len(every))
        count = self.pairs if kind == "two" else (self.pairs + 1) // 2
        return [every[i] for i in order[:count]]


#: Kinds of logs in which vehicles may get stuck, so that there is no drive to diagnose: counted without these
#: as well, where there are any.
_HARD = ("other", "library", "two", "large", "large two")
#: What is counted of every kind of log.
_COUNTS = ("detected", "family in the sets", "another cause for certain")


def _limits(_kind: str, seed: int) -> Numbers:
    return limits_of(seed, natural=True)


def _limits_beside(_label: str, kind: str, pair: str, seed: int, *, known: Mapping[int, Numbers]) -> Numbers:
    return limits_beside(pair, _PAIRS[kind], seed, known=known)


def counted_naturally(results: Mapping[Key, Numbers]) -> dict[str, Numbers]:
    """Shares by kind of log, and of each wrong number and each cause of another form."""
    done = [(key, result) for key, result in results.items() if "failed" not in result]
    stuck = {str(key[0]) for key, result in done if key[0] in _HARD and result.get("stuck")}
    groups: dict[str, list[tuple[str, Numbers]]] = {}
    for key, result in done:
        kind, name = str(key[0]), str(key[1])
        groups.setdefault(kind, []).append((name, result))
        if kind in stuck and not result.get("stuck"):
            groups.setdefault(f"{kind}, not stuck", []).append((name, result))
    for key, result in done:
        if key[0] in ("wrong", "other"):
            groups.setdefault(f"{key[0]}: {key[1]}", []).append((str(key[1]), result))
    return {kind: _shares(own) for kind, own in groups.items()}


def _shares(own: Sequence[tuple[str, Numbers]]) -> Numbers:
    truths = [(one, result) for name, result in own for one in _causes_of(name)]
    return {
        "detected": share_of(sum(r["verdict"] not in QUIET for _, r in own), len(own)),
        "family in the sets": share_of(sum(_family_in(one, r) for one, r in truths), len(truths)),
        "another cause for certain": share_of(sum(_wrong(name, r) for name, r in own), len(own)),
    }


def _family_in(name: str, result: Numbers) -> bool:
    members = {effect for found in result["sets"] for effect in found}
    return bool(members & set(FAMILIES.get(name, ())))


def _family(name: str) -> set[str]:
    """Effects that name a cause, or one of several, right."""
    return {effect for one in _causes_of(name) for effect in FAMILIES.get(one, ())}


def _causes_of(name: str) -> list[str]:
    """The cause of a log, or both of two; a wrong number may have a sign of its own in its name."""
    return [name] if name in FAMILIES else name.split("+")


def _wrong(name: str, result: Numbers) -> bool:
    """Whether a cause is named for certain, and no effect of its set is of the family."""
    if result["verdict"] not in ("NAMED", "NAMED + UNEXPLAINED REST"):
        return False
    sets = [found for found in result["sets"] if found[0] in result["named"]]
    return bool(result["structure"]) or any(not set(found) & _family(name) for found in sets)
