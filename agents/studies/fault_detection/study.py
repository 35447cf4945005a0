"""``offroad reproduce fault_detection``: faults are injected in simulated logs, and the logs diagnosed.

Null logs have no fault: they give the false-alarm rate, and the rate if all noise were taken for white.
Faults are injected alone, at multiples of the smallest detectable size, and in pairs; some are outside the
library, and some logs are diagnosed with a library that lacks the true effect. No fault uses the laws of the
library.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.fault_detection.one_log import Numbers, limits_of, run_unit
from agents.studies.fault_detection.results import MULTIPLES, counted
from agents.studies.runner import Key, run_units, stamp_of
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.faults.unmodelled import UNMODELLED_FAULTS
from offroad_env.effects import FORMER_IDS

__all__ = ["FaultDetection", "share_text"]

#: Seeds of the report; tuning used those below 1000.
_FIRST_SEED = 1000
#: Former name of an option.
_FORMER = ("--stranger-seeds",)  # alias
#: Faults in the one map of the soil, which cannot be combined.
_EXCLUSIVE = ("slip_exponent", "n_step", "n_trend")


@dataclass(kw_only=True)
class FaultDetection(Results):
    """Faults in simulated logs: false alarms, power, sets, wrong names.

    Writes diagnosis.jsonl with the result of every log (a log that is there is not repeated),
    diagnosis.json and diagnosis.png.
    """

    quick: bool = False  #: a few logs of each kind
    nulls: int = 300  #: logs without a fault
    whites: int = 60  #: of these, so many again with all noise taken for white
    seeds: int = 8  #: logs for each effect at twice its limit
    power_seeds: int = 8  #: logs for each effect at the other sizes
    pairs: int = 100  #: logs with two effects
    removed: int = 2  #: logs for each effect with a library that lacks it
    unmodelled_seeds: Annotated[int, arg(aliases=_FORMER)] = 8  #: logs for each fault outside the library
    same: int = 3  #: logs that are diagnosed again with everything in another order
    effects: tuple[str, ...] = tuple(FAULTS)  #: faults to inject
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then count, draw and print."""
        from agents.studies.fault_detection.figure import diagnosis_figure

        if self.quick:
            self.nulls, self.whites, self.seeds, self.power_seeds, self.pairs = 6, 2, 1, 0, 2
            self.removed, self.unmodelled_seeds, self.same = 0, 1, 1
        self.effects = tuple(name if name in FAULTS else FORMER_IDS.get(name, name) for name in self.effects)
        path = self.out / "diagnosis.jsonl"
        count = max(self.seeds, self.power_seeds, self.removed, self.same, self.pairs)
        seeds = range(_FIRST_SEED, _FIRST_SEED + count)
        limits = self._done(path, _limits_unit, [("limits", seed) for seed in seeds], "limits")
        known = {key[1]: result for key, result in limits.items() if "failed" not in result}
        results = self._done(path, partial(run_unit, known=known), self._keys(known), "faults")
        numbers = counted(results)
        _show(numbers)
        self.save_figure(
            diagnosis_figure(numbers),
            "diagnosis",
            "On the diagonal the true cause is named; rates lie in the green ranges where the "
            "requirement is met.",
        )
        self.save_numbers(numbers)

    def _done(
        self, path: Path, work: Callable[..., Numbers], keys: Sequence[Key], label: str
    ) -> dict[Key, Numbers]:
        stamp = stamp_of("agents.studies.fault_detection.one_log")
        return run_units(path, work, dict.fromkeys(keys, stamp), label=label, n_jobs=self.n_jobs)

    def _keys(self, known: Mapping[int, Numbers]) -> list[Key]:
        seeds = set(known)
        first = [seed for seed in sorted(seeds) if seed < _FIRST_SEED + self.seeds]
        powers = [seed for seed in sorted(seeds) if seed < _FIRST_SEED + self.power_seeds]
        keys: list[Key] = [("null", "", 0.0, _FIRST_SEED + i) for i in range(self.nulls)]
        keys += [("white", "", 0.0, _FIRST_SEED + i) for i in range(self.whites)]
        keys += [("single", name, 2.0, seed) for seed in first for name in self.effects]
        keys += [
            ("unmodelled", name, 1.0, _FIRST_SEED + i)
            for i in range(self.unmodelled_seeds)
            for name in UNMODELLED_FAULTS
        ]
        keys += [
            ("removed", name, 4.0, seed) for seed in sorted(seeds)[: self.removed] for name in self.effects
        ]
        keys += [
            ("pair", self._pair(seed, known[seed]["limits"]), 2.0, seed)
            for seed in sorted(seeds)[: self.pairs]
        ]
        keys += [("same", "payload", 2.0, seed) for seed in sorted(seeds)[: self.same]]
        others = [multiple for multiple in MULTIPLES if multiple != 2.0]
        keys += [
            ("single", name, multiple, seed)
            for multiple in others
            for seed in powers
            for name in self.effects
        ]
        limited = ("single", "removed")
        return [key for key in keys if key[0] not in limited or key[1] in known[key[3]]["limits"]]

    def _pair(self, seed: int, possible: Container[str] = FAULTS) -> str:
        """Two faults that can be combined in the log of this seed, drawn from it."""
        rng = np.random.default_rng([seed, 5])
        effects = [name for name in self.effects if name in possible]
        while True:
            pair = sorted(str(name) for name in rng.choice(effects, 2, replace=False))
            if not set(pair) <= set(_EXCLUSIVE):
                return "+".join(pair)


def _limits_unit(_kind: str, seed: int) -> Numbers:
    return limits_of(seed)


def _show(numbers: Numbers) -> None:
    rows: list[tuple[str, ...]] = []
    for name, entry in numbers.items():
        if isinstance(entry, dict) and "share" in entry:
            rows.append((name, share_text(entry), "", "", ""))
        elif isinstance(entry, dict) and "detected" in entry:
            size = entry["mean set size"]
            parts = [share_text(entry[k]) for k in ("detected", "truth in a set", "interval holds the truth")]
            rows.append((name, *parts, "-" if size is None else f"{size:.2f} ({entry['theory of it']:.2f})"))
    heading = (
        "logs",
        "alarm, wrong name, or detected",
        "truth in a set",
        "interval holds",
        "set size (theory)",
    )
    console().print(table("faults in simulated logs: share (95 % interval)", heading, rows))
    required = [
        (
            bar["what"],
            share_text(bar),
            _range(bar),
            {True: "met", False: "missed", None: "not run"}[bar["met"]],
        )
        for bar in numbers["bars"]
    ]
    console().print(
        table("requirements", ("share of logs", "share (95 % interval)", "required", ""), required)
    )
    if (power := numbers["power"])["ratio"] is not None:
        ratio, low, high = power["ratio"], power["low"], power["high"]
        say(f"power: it takes {ratio:.2f} times the sizes of the Fisher bound ({low:.2f} to {high:.2f})")
    seconds = numbers["core seconds"]
    if seconds["median"] is not None:
        say(f"core-seconds of a verdict: median {seconds['median']:.1f}, 95 % {seconds['95 %']:.1f}")
    if (gain := numbers["gain over oracle's"])["logs"]:
        say(f"gain: {gain['pooled']:.0%} of that with the true effect, over {gain['logs']} logs")
    if numbers["failed"]:
        say(f"{numbers['failed']} logs could not be driven or diagnosed")


def _range(bar: Numbers) -> str:
    least, most = bar["least"], bar["most"]
    if most == 1.0:
        return f">= {least:.0%}"
    return f"<= {most:.0%}" if least == 0.0 else f"{least:.0%} to {most:.0%}"


def share_text(entry: Numbers) -> str:
    """Hits, count and interval of a share."""
    return f"{entry['hits']}/{entry['count']} ({entry['low']:.1%} to {entry['high']:.1%})"
