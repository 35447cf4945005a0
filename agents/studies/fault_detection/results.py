"""Counts of the fault-detection study: shares with intervals, power, confusion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from agents.benchmark.statistics import wilson_interval
from agents.studies.fault_detection.one_log import Numbers
from agents.studies.runner import Key
from estimators.discrepancy.search.score_test import DETECTABLE

__all__ = ["MIMICRY", "MULTIPLES", "QUIET", "counted", "share_of"]

#: Sizes of the faults, in multiples of the smallest detectable one.
MULTIPLES = (0.5, 1.0, 2.0, 4.0)
#: Studies that are drawn from the logs, for the interval of the ratio to the bound.
_REDRAWN = 200
#: Causes that reproduce this share of the trace of the fault are no wrong names.
MIMICRY = 0.9
#: Verdicts without an alarm.
QUIET = ("NO EFFECT", "NOT TESTABLE")
#: Verdicts that claim to be complete.
_CONFIDENT = ("NAMED", "ONE OF")


def counted(results: Mapping[Key, Numbers]) -> Numbers:
    """Shares with intervals, from the results of all units."""
    done = {key: result for key, result in results.items() if "failed" not in result}
    numbers: Numbers = {"failed": len(results) - len(done)}
    for kind in ("null", "white"):
        own = [result for key, result in done.items() if key[0] == kind]
        numbers[kind] = _alarms(own) | {
            road: _alarms([r for r in own if r["road"] == road]) for road in ("flat", "known", "unknown")
        }
    singles = {key: result for key, result in done.items() if key[0] == "single"}
    for multiple in MULTIPLES:
        named = [(key[1], r) for key, r in singles.items() if key[2] == multiple]
        numbers[f"single at {multiple:g}"] = _found(named)
    numbers["pair"] = _found([(key[1], r) for key, r in done.items() if key[0] == "pair"])
    # The library lacks the true effect: no name is right.
    lacking: list[Numbers] = []
    for kind in ("removed", "unmodelled"):
        own = [result for key, result in done.items() if key[0] == kind]
        numbers[kind] = share_of(sum(map(_wrong_name, own)), len(own))
        lacking += own
    numbers["wrong name"] = share_of(sum(map(_wrong_name, lacking)), len(lacking))
    numbers["wrong name or set"] = share_of(sum(map(_wrong_model, lacking)), len(lacking))
    numbers["wrong name beside a rest"] = share_of(sum(map(_wrong_beside, lacking)), len(lacking))
    same = [r["same"] for key, r in done.items() if key[0] == "same"]
    numbers["same in another order"] = share_of(sum(same), len(same))
    seconds = [r["seconds"] for r in done.values() if "seconds" in r]
    numbers["core seconds"] = {"median": _quantile(seconds, 0.5), "95 %": _quantile(seconds, 0.95)}
    gains = [r["gain"] for r in singles.values() if "gain" in r]
    numbers["gain over oracle's"] = {
        "logs": len(gains),
        "pooled": sum(g[0] for g in gains) / max(sum(g[1] for g in gains), 1e-300),
        "median": _quantile([g[0] / g[1] for g in gains if g[1] > 0.0], 0.5),
    }
    numbers["power"] = _power(singles)
    numbers["confusion"] = _confusion(singles)
    numbers["bars"] = _bars(numbers)
    return numbers


def _bars(numbers: Numbers) -> list[Numbers]:
    """Required and reached shares, with their intervals."""
    single, pair = numbers["single at 2"], numbers["pair"]
    rows = [
        # A test with a false-alarm rate of 5 % would exceed it in half of all studies: its interval counts.
        ("false alarms, upper end", numbers["null"], 0.0, 0.07, numbers["null"]["high"]),
        ("one effect: detected", single["detected"], 0.95, 1.0, None),
        ("one effect: truth in a set", single["truth in a set"], 0.95, 1.0, None),
        ("one effect: interval holds the truth", single["interval holds the truth"], 0.9, 0.98, None),
        ("two effects: truths in the sets", pair["truth in a set"], 0.9, 1.0, None),
        ("true effect not in the library: wrong name", numbers["wrong name"], 0.0, 0.05, None),
        ("files in another order: same verdict", numbers["same in another order"], 1.0, 1.0, None),
    ]
    bars = []
    for what, share, least, most, judged in rows:
        judged = share["share"] if judged is None else judged
        met = least <= judged <= most if share["count"] else None
        bars.append({"what": what, "least": least, "most": most, "met": met} | share)
    return bars


def _quantile(values: Sequence[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


def share_of(hits: int, count: int) -> Numbers:
    """A share with its 95 % interval; of no log at all, anything."""
    interval = wilson_interval(hits, count) if count else None
    low, high = (interval.low, interval.high) if interval else (0.0, 1.0)
    return {"hits": hits, "count": count, "share": hits / max(count, 1), "low": low, "high": high}


def _alarms(own: Sequence[Numbers]) -> Numbers:
    return share_of(sum(r["verdict"] not in QUIET for r in own), len(own))


def _found(own: Sequence[tuple[str, Numbers]]) -> Numbers:
    """Counts over logs and the names of their faults, see `run_unit`."""
    truths = [
        (name, size, r)
        for names, r in own
        for name, size in zip(names.split("+"), r["sizes_true"], strict=True)
    ]
    inside = [(name, size, r) for name, size, r in truths if any(name in members for members in r["sets"])]
    sizes = [len(members) for name, _, r in inside for members in r["sets"] if name in members]
    causes = sum(len(r["sets"]) for _, r in own)
    theory = [sum(cosine**2 > 1.0 - _alike_below(r) for cosine in r["alike"].values()) for _, r in own]
    return {
        "detected": share_of(sum(r["verdict"] not in QUIET for _, r in own), len(own)),
        "truth in a set": share_of(len(inside), len(truths)),
        "interval holds the truth": share_of(sum(_covers(*truth) for truth in inside), len(inside)),
        "sets without a truth": share_of(causes - len(sizes), causes),
        "mean set size": float(np.mean(sizes)) if sizes else None,
        "theory of it": float(np.mean(theory)) if theory else None,
    }


def _alike_below(result: Numbers) -> float:
    """Least 1 - cos^2 that shows: there an alternative lacks 6.63 of twice the log-likelihood."""
    largest = max(abs(float(multiple)) for multiple in result["multiples"].values())
    return 6.63 / (DETECTABLE * largest) ** 2


def _covers(name: str, truth: float, result: Numbers) -> bool:
    for members, sizes in zip(result["sets"], result["sizes"], strict=True):
        if name in members:
            size, deviation = sizes[members.index(name)]
            return bool(abs(size - truth) <= 1.959964 * deviation)
    return False


def _wrong_name(result: Numbers) -> bool:
    """Whether the verdict is NAMED, and one name does not have the trace of the fault in this log."""
    if result["verdict"] != "NAMED":
        return False
    alike = result.get("alike", {})
    return not all(alike.get(members[0], 0.0) ** 2 >= MIMICRY for members in result["sets"])


def _wrong_beside(result: Numbers) -> bool:
    """The same for a verdict that names causes and states that a discrepancy remains."""
    if result["verdict"] != "NAMED + UNEXPLAINED REST":
        return False
    alike = result.get("alike", {})
    return not all(alike.get(name, 0.0) ** 2 >= MIMICRY for name in result["named"])


def _wrong_model(result: Numbers) -> bool:
    """Whether names or sets claim to be complete, and their best do not reproduce the fault."""
    return result["verdict"] in _CONFIDENT and result.get("mimicry", 0.0) < MIMICRY


def _power(singles: Mapping[Key, Numbers]) -> Numbers:
    """Share detected over the size in standard deviations, and how many times the bound's sizes it takes.

    With all information of the windows of the search a diagnosis detects with probability
    Phi(size - threshold). The simulated logs detect like Phi(size / ratio - threshold), with the ratio of
    the greatest likelihood.
    """
    rows = [
        (DETECTABLE * abs(r["multiples"][key[1]]), r["threshold"], r["verdict"] not in QUIET)
        for key, r in singles.items()
        if r["threshold"] is not None
    ]
    if not rows:
        return {"ratio": None, "points": []}
    table = np.array(rows, dtype=np.float64)
    size, threshold, seen = table.T
    # All found, or none: any ratio on that side is as good.
    found: Numbers = {"ratio": None, "low": None, "high": None}
    if 0.0 < seen.mean() < 1.0:
        rng = np.random.default_rng(0)
        draws = [_ratio(*table[rng.integers(len(table), size=len(table))].T) for _ in range(_REDRAWN)]
        found["ratio"] = _ratio(*table.T)
        found["low"], found["high"] = (float(value) for value in np.quantile(draws, (0.025, 0.975)))
    points = []
    for low, high in ((0.0, 3.3), (3.3, 6.6), (6.6, 13.0), (13.0, np.inf)):
        own = (size >= low) & (size < high)
        if own.any():
            points.append(
                {"size": float(np.mean(size[own]))} | share_of(int(seen[own].sum()), int(own.sum()))
            )
    return found | {"threshold": float(np.mean(threshold)), "points": points}


def _ratio(size: np.ndarray, threshold: np.ndarray, seen: np.ndarray) -> float:
    """How many times the bound's sizes logs with these thresholds take, by the greatest likelihood."""

    def loss(log_ratio: float) -> float:
        p = np.clip(norm.cdf(size * math.exp(-log_ratio) - threshold), 1e-3, 1.0 - 1e-3)
        return -float(np.sum(seen * np.log(p) + (1.0 - seen) * np.log(1.0 - p)))

    return math.exp(minimize_scalar(loss, bounds=(-1.5, 1.5), method="bounded").x)


def _confusion(singles: Mapping[Key, Numbers]) -> dict[str, dict[str, float]]:
    """Fault -> share of its logs at twice the limit whose best names contain each effect."""
    rows: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(key[1] for key in singles):
        own = [r for key, r in singles.items() if key[1] == name and key[2] == 2.0]
        for result in own:
            names = {members[0] for members in result["sets"]} or {"nothing"}
            for found in names:
                row = rows.setdefault(name, {})
                row[found] = row.get(found, 0.0) + 1.0 / len(own)
    return rows
