"""``offroad reproduce diagnosis``: effects are hidden in simulated logs, and the finder must find them.

Null logs hide nothing: how often does the finder cry wolf, and how often if it took all noise for white?
Effects alone at multiples of the smallest size that the log could show, and in pairs; forces that the library
does not hold; a library from which the true effect was taken. Nothing that hides uses the finder's own laws.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from agents.commands.output import Results, console, say, table
from agents.studies.units import Key, run_units, stamp_of
from estimators.discrepancy.diagnosis import Diagnosis, diagnose
from estimators.discrepancy.fit import fit_runs
from estimators.discrepancy.gain import held_out
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
from estimators.discrepancy.screen import DETECTABLE, Screen, candidates_for, screen
from estimators.discrepancy.windows import FIT, REPORT
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS, apply
from offroad_env.errors import OffroadError
from offroad_env.soils import SOILS

__all__ = ["DiagnosisStudy", "counted", "run_unit", "together", "wilson"]

#: Seeds of the report; tuning used those below 1000.
_FIRST_SEED = 1000
MULTIPLES = (0.5, 1.0, 2.0, 4.0)
#: Effects that cannot be negative.
_ONE_SIDED = (*ONE_SIDED, "aero_drag")
#: The hider acts in ticks of this length: a delay is a whole number of them [s].
_TICK = 0.005
#: Effects that are hidden in the one map of the soil, and cannot be hidden together.
_EXCLUSIVE = ("slip_sinkage", "n_step", "n_trend")
#: Where the hider's soil changes, as the finder's parameters.
_PLACES = {"n_step": {"place": 35.0, "direction": 0.0}, "n_trend": {"place": 80.0, "direction": 0.0}}
#: Size of the forces without a name [share of the weight].
_STRANGE = 0.03
#: Studies that are drawn from the logs, for the interval of the ratio to the bound.
_REDRAWN = 200
#: Causes that copy this share of the removed effect's trace are no wrong names.
MIMICRY = 0.9
_QUIET = ("NO EFFECT", "NOT TESTABLE")
#: Verdicts that claim to be all.
_CONFIDENT = ("NAMED", "ONE OF")


def wilson(hits: int, count: int, z: float = 1.959964) -> tuple[float, float]:
    """95 % interval of a share (Wilson, JASA 22, 1927)."""
    if count == 0:
        return 0.0, 1.0
    p, centre = hits / count, hits / count + z * z / (2.0 * count)
    half = z * math.sqrt(p * (1.0 - p) / count + z * z / (4.0 * count * count))
    scale = 1.0 + z * z / count
    return max((centre - half) / scale, 0.0), min((centre + half) / scale, 1.0)


# ------------------------------------------------------------------ one log


def limits_of(seed: int) -> dict:
    """Smallest sizes that the log of this seed would show, and which effects look alike to it.

    From the same run with nothing hidden.
    """
    try:
        fit = fit_runs([RunModel(hidden_log(draw_case(seed)), use=FIT)])
        result = screen(fit, candidates_for(fit, tuple(EFFECTS)))
    except OffroadError as error:
        return {"failed": str(error)}
    names, cosines = result.by_effect()
    limits = result.limits()
    return {
        "limits": limits,
        # Without a receiver nothing of it can be hidden.
        "alike": {name: _alike(result, name) for name in HIDERS if name in limits},
        "names": names,
        "cosines": cosines.round(4).tolist(),
    }


def _mimicry(known: Mapping, gone: str, named: Sequence[str]) -> float:
    """Share of an effect's trace that others copy together (R^2), in a run with nothing hidden."""
    places = {name: i for i, name in enumerate(known["names"])}
    inside = [places[name] for name in named if name in places]
    if gone not in places or not inside:
        return 0.0
    cosines = np.array(known["cosines"])
    cross = cosines[inside, places[gone]]
    return float(cross @ np.linalg.lstsq(cosines[np.ix_(inside, inside)], cross, rcond=None)[0])


def _alike(result: Screen, name: str) -> dict[str, float]:
    own = [i for i, candidate in enumerate(result.candidates) if candidate.effect == name]
    best = own[int(np.argmax(np.diag(result.information)[own]))]
    cosines = np.abs(result.cosines()[best])
    found: dict[str, float] = {}
    for candidate, cosine in zip(result.candidates, cosines, strict=True):
        found[candidate.effect] = max(found.get(candidate.effect, 0.0), float(cosine))
    return {effect: cosine for effect, cosine in found.items() if cosine > 0.5}


def run_unit(kind: str, name: str, multiple: float, seed: int, *, known: Mapping[int, dict]) -> dict:
    """One log hidden and diagnosed; the answer is compared only afterwards.

    Parameters
    ----------
    kind
        "null", "white", "single", "pair", "removed", "stranger" or "same".
    name
        What is hidden; two names with + between for a pair.
    multiple
        Size in limits.
    known
        Seed -> `limits_of` it.
    """
    case = draw_case(seed)
    try:
        if kind in ("null", "white"):
            return _diagnosed(hidden_log(case), case, white=kind == "white")
        if kind == "stranger":
            return _diagnosed(hidden_log(case, STRANGERS[name](_STRANGE)), case)
        names, limits = name.split("+"), known[seed]["limits"]
        sizes = [_size(one, multiple * limits[one], seed) for one in names]
        log = hidden_log(case, together([_hidden(one, x) for one, x in zip(names, sizes, strict=True)]))
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


def _size(name: str, size: float, seed: int) -> float:
    """Size with its sign drawn; a delay in whole ticks."""
    if name == "steer_delay":
        return max(round(size / _TICK), 1) * _TICK
    if name in _ONE_SIDED:
        return size
    return size * float(np.random.default_rng([seed, 3]).choice((-1.0, 1.0)))


def _hidden(name: str, size: float) -> Hidden:
    """The hider's lag answers at the beginning of its ticks: its time constant for the lag's mean delay."""
    if name == "steer_lag":
        size = _TICK / math.log1p(_TICK / size)
    return HIDERS[name](size)


def together(parts: Sequence[Hidden]) -> Hidden:
    """Several things hidden in one run: each acts on what the ones before it have made."""
    if len(parts) == 1:
        return parts[0]
    # What every part would have sent on, one a tick: the next one's past.
    sent: list[list[tuple[float, float, float]]] = [[] for _ in parts]

    def plant(plant):
        for part in parts:
            plant = part.plant(plant)
        return plant

    def command(past):
        for part, own in zip(parts, sent, strict=True):
            own.append(part.command(past))
            past = own
        return past[-1]

    def step(x, readings, plant):
        for part in parts:
            plant = part.step(x, readings, plant) if part.step is not None else plant
        return plant

    def kick(x, readings, plant, span):
        for part in parts:
            if part.kick is not None:
                part.kick(x, readings, plant, span)

    def feel(x, readings, plant):
        for part in parts:
            if part.feel is not None:
                part.feel(x, readings, plant)

    def sample(sample):
        for part in parts:
            part.sample(sample)

    kicks = any(part.kick is not None for part in parts)
    return Hidden(
        plant=plant, command=command, step=step, kick=kick if kicks else None, feel=feel, sample=sample
    )


def _diagnosed(
    log: Log,
    case: Case,
    *,
    white: bool = False,
    gone: str | None = None,
    truth: tuple[str, float] | None = None,
) -> dict:
    start = time.process_time()
    diagnosis = diagnose([log], white=white, library=[name for name in EFFECTS if name != gone])
    result = _summary(diagnosis, case) | {"seconds": time.process_time() - start}
    if truth is not None and diagnosis.report is not None:
        result["gain"] = _share_of_oracle(diagnosis, log, *truth)
    return result


def _summary(diagnosis: Diagnosis, case: Case) -> dict:
    found = diagnosis.search
    return {
        "verdict": diagnosis.verdict,
        "road": case.road,
        "sets": [[rival.candidate.effect for rival in cause.rivals] for cause in diagnosis.causes],
        "sizes": [[(rival.size, rival.deviation) for rival in cause.rivals] for cause in diagnosis.causes],
        "named": [cause.best.candidate.effect for cause in diagnosis.named],
        "strongest": float(np.abs(found.first.z).max()) if found else None,
        "threshold": found.threshold if found else None,
        "gate": list(found.gate) if found else [],
        "rest": {rest.equation: rest.chance for rest in diagnosis.rest},
        "converged": diagnosis.checks.get("converged"),
        "solver": diagnosis.checks.get("solver"),
        "overlap": diagnosis.checks.get("overlap"),
        "refused": found.refused if found else None,
        "n_true": case.n,
        "n_fit": SOILS[case.soil].n + float(found.extended.nuisances[0]) if found else None,
    }


def _share_of_oracle(diagnosis: Diagnosis, log: Log, name: str, size: float) -> tuple[float, float]:
    """Gains on the report's windows, of the extended model and of one that knows the truth."""
    run = copy.copy(diagnosis.search.nominal.runs[0])
    run.setup = apply(run.setup, [(name, {EFFECTS[name].size.name: size, **_PLACES.get(name, {})})])
    oracle = fit_runs([run])
    # The finder's noise for both: a likelihood is compared under one law.
    oracle.whitener.noise = dict(diagnosis.search.extended.whitener.noise)
    apart = RunModel(log, use=REPORT)
    apart.setup = run.setup
    nominal, extended = diagnosis.report
    weighed = copy.copy(diagnosis.search.nominal)
    weighed.whitener = oracle.whitener
    before = held_out(weighed, nominal.fit.runs).cost
    return before - extended.cost, before - held_out(oracle, [apart]).cost


def _same(log: Log, case: Case) -> dict:
    """Whether another order of the library and another name of the log change a diagnosis."""
    first = _summary(diagnose([log]), case)
    again = _summary(diagnose([replace(log, name="another")], library=list(EFFECTS)[::-1]), case)
    return first | {"same": first == again}


# ------------------------------------------------------------------ the study


@dataclass(kw_only=True)
class DiagnosisStudy(Results):
    """Hide and find: false alarms, power, sets, wrong names.

    Writes diagnosis.jsonl with the result of every log (a log that is there is not repeated),
    diagnosis.json and diagnosis.png.
    """

    quick: bool = False  #: a few logs of each kind
    nulls: int = 300  #: logs with nothing wrong
    whites: int = 60  #: of these, so many again with all noise taken for white
    seeds: int = 8  #: logs for each effect at twice its limit
    power_seeds: int = 8  #: logs for each effect at the other sizes
    pairs: int = 100  #: logs with two effects
    removed: int = 2  #: logs for each effect with a library that lacks it
    stranger_seeds: int = 8  #: logs for each force that no library holds
    same: int = 3  #: logs that are diagnosed again with everything in another order
    effects: tuple[str, ...] = tuple(HIDERS)  #: effects to hide
    n_jobs: int = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then count, draw and print."""
        from agents.figures.diagnosis import diagnosis_figure

        if self.quick:
            self.nulls, self.whites, self.seeds, self.power_seeds, self.pairs = 6, 2, 1, 0, 2
            self.removed, self.stranger_seeds, self.same = 0, 1, 1
        path = self.out / "diagnosis.jsonl"
        count = max(self.seeds, self.power_seeds, self.removed, self.same, self.pairs)
        seeds = range(_FIRST_SEED, _FIRST_SEED + count)
        limits = self._done(path, _limits_unit, [("limits", seed) for seed in seeds], "limits")
        known = {key[1]: result for key, result in limits.items() if "failed" not in result}
        results = self._done(path, partial(run_unit, known=known), self._keys(known), "hide and find")
        numbers = counted(results)
        _show(numbers)
        self.save_figure(diagnosis_figure(numbers), "diagnosis")
        self.save_numbers(numbers)

    def _done(self, path, work: Callable[..., dict], keys: Sequence[Key], label: str) -> dict[Key, dict]:
        stamp = stamp_of("estimators.discrepancy.diagnosis", "estimators.discrepancy.hide")
        return run_units(path, work, dict.fromkeys(keys, stamp), label=label, n_jobs=self.n_jobs)

    def _keys(self, known: Mapping[int, dict]) -> list[Key]:
        seeds = set(known)
        first = [seed for seed in sorted(seeds) if seed < _FIRST_SEED + self.seeds]
        powers = [seed for seed in sorted(seeds) if seed < _FIRST_SEED + self.power_seeds]
        keys: list[Key] = [("null", "", 0.0, _FIRST_SEED + i) for i in range(self.nulls)]
        keys += [("white", "", 0.0, _FIRST_SEED + i) for i in range(self.whites)]
        keys += [("single", name, 2.0, seed) for seed in first for name in self.effects]
        keys += [
            ("stranger", name, 1.0, _FIRST_SEED + i) for i in range(self.stranger_seeds) for name in STRANGERS
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
        hiding = ("single", "removed")
        return [key for key in keys if key[0] not in hiding or key[1] in known[key[3]]["limits"]]

    def _pair(self, seed: int, possible: Container[str] = HIDERS) -> str:
        """Two effects that can be hidden together in the log of this seed, drawn from it."""
        rng = np.random.default_rng([seed, 5])
        effects = [name for name in self.effects if name in possible]
        while True:
            pair = sorted(str(name) for name in rng.choice(effects, 2, replace=False))
            if not set(pair) <= set(_EXCLUSIVE):
                return "+".join(pair)


def _limits_unit(_kind: str, seed: int) -> dict:
    return limits_of(seed)


# ------------------------------------------------------------------ counting


def counted(results: Mapping[Key, dict]) -> dict:
    """Shares with intervals, from the results of all units."""
    done = {key: result for key, result in results.items() if "failed" not in result}
    numbers: dict = {"failed": len(results) - len(done)}
    for kind in ("null", "white"):
        own = [result for key, result in done.items() if key[0] == kind]
        numbers[kind] = _alarms(own) | {
            road: _alarms([r for r in own if r["road"] == road]) for road in ("flat", "known", "unknown")
        }
    singles = {key: result for key, result in done.items() if key[0] == "single"}
    for multiple in MULTIPLES:
        own = [(key[1], r) for key, r in singles.items() if key[2] == multiple]
        numbers[f"single at {multiple:g}"] = _found(own)
    numbers["pair"] = _found([(key[1], r) for key, r in done.items() if key[0] == "pair"])
    hopeless = {kind: [r for key, r in done.items() if key[0] == kind] for kind in ("removed", "stranger")}
    for kind, own in hopeless.items():
        numbers[kind] = _share(sum(map(_wrong_name, own)), len(own))
    hopeless_all = [*hopeless["removed"], *hopeless["stranger"]]
    numbers["wrong name"] = _share(sum(map(_wrong_name, hopeless_all)), len(hopeless_all))
    numbers["wrong name or set"] = _share(sum(map(_wrong_model, hopeless_all)), len(hopeless_all))
    numbers["wrong name beside a rest"] = _share(sum(map(_wrong_beside, hopeless_all)), len(hopeless_all))
    same = [r["same"] for key, r in done.items() if key[0] == "same"]
    numbers["same in another order"] = _share(sum(same), len(same))
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


def _bars(numbers: Mapping) -> list[dict]:
    """What must be reached, beside what was: shares with their interval, and the ratio of sizes."""
    single, pair = numbers["single at 2"], numbers["pair"]
    rows = [
        # Of a test that is right in 95 % of cases, half the studies would lie above: its interval counts.
        ("false alarms, upper end", numbers["null"], 0.0, 0.07, numbers["null"]["high"]),
        ("one effect: detected", single["detected"], 0.95, 1.0, None),
        ("one effect: truth in a set", single["truth in a set"], 0.95, 1.0, None),
        ("one effect: interval holds the truth", single["interval holds the truth"], 0.9, 0.98, None),
        ("two effects: truths in the sets", pair["truth in a set"], 0.9, 1.0, None),
        ("true name out of reach: wrong name", numbers["wrong name"], 0.0, 0.05, None),
        ("another order: the same", numbers["same in another order"], 1.0, 1.0, None),
    ]
    bars = []
    for what, share, least, most, judged in rows:
        judged = share["share"] if judged is None else judged
        met = least <= judged <= most if share["count"] else None
        bars.append({"what": what, "least": least, "most": most, "met": met} | share)
    return bars


def _quantile(values: Sequence[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


def _share(hits: int, count: int) -> dict:
    low, high = wilson(hits, count)
    return {"hits": hits, "count": count, "share": hits / max(count, 1), "low": low, "high": high}


def _alarms(own: Sequence[dict]) -> dict:
    return _share(sum(r["verdict"] not in _QUIET for r in own), len(own))


def _found(own: Sequence[tuple[str, dict]]) -> dict:
    """Of logs and the names that are hidden in them, see `run_unit`."""
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
        "detected": _share(sum(r["verdict"] not in _QUIET for _, r in own), len(own)),
        "truth in a set": _share(len(inside), len(truths)),
        "interval holds the truth": _share(sum(_covers(*truth) for truth in inside), len(inside)),
        "sets without a truth": _share(causes - len(sizes), causes),
        "mean set size": float(np.mean(sizes)) if sizes else None,
        "theory of it": float(np.mean(theory)) if theory else None,
    }


def _alike_below(result: dict) -> float:
    """Least 1 - cos^2 that shows: where a rival would lack 6.63 of twice the log-likelihood."""
    return 6.63 / (DETECTABLE * max(abs(multiple) for multiple in result["multiples"].values())) ** 2


def _covers(name: str, truth: float, result: dict) -> bool:
    for members, sizes in zip(result["sets"], result["sizes"], strict=True):
        if name in members:
            size, deviation = sizes[members.index(name)]
            return abs(size - truth) <= 1.959964 * deviation
    return False


def _wrong_name(result: dict) -> bool:
    """Names without a doubt, one of which does not look the same to this log as what is hidden."""
    if result["verdict"] != "NAMED":
        return False
    alike = result.get("alike", {})
    return not all(alike.get(members[0], 0.0) ** 2 >= MIMICRY for members in result["sets"])


def _wrong_beside(result: dict) -> bool:
    """Names beside which something is said to be left, one of which does not look like what is hidden."""
    if result["verdict"] != "NAMED + UNEXPLAINED REST":
        return False
    alike = result.get("alike", {})
    return not all(alike.get(name, 0.0) ** 2 >= MIMICRY for name in result["named"])


def _wrong_model(result: dict) -> bool:
    """Names or sets that claim to be all, and whose best together do not copy what is hidden."""
    return result["verdict"] in _CONFIDENT and result.get("mimicry", 0.0) < MIMICRY


def _power(singles: Mapping[Key, dict]) -> dict:
    """Share detected over the size in standard deviations, and how many times the bound's sizes it takes.

    A finder with all information of the search's windows detects with probability Phi(size - threshold). The
    measured logs detect like Phi(size / ratio - threshold), with the ratio of the greatest likelihood.
    """
    rows = [
        (DETECTABLE * abs(r["multiples"][key[1]]), r["threshold"], r["verdict"] not in _QUIET)
        for key, r in singles.items()
        if r["threshold"] is not None
    ]
    if not rows:
        return {"ratio": None, "points": []}
    table = np.array(rows, dtype=np.float64)
    size, threshold, seen = table.T
    # All found, or none: any ratio on that side is as good.
    found = {"ratio": None, "low": None, "high": None}
    if 0.0 < seen.mean() < 1.0:
        rng = np.random.default_rng(0)
        draws = [_ratio(*table[rng.integers(len(table), size=len(table))].T) for _ in range(_REDRAWN)]
        found["ratio"] = _ratio(*table.T)
        found["low"], found["high"] = (float(value) for value in np.quantile(draws, (0.025, 0.975)))
    points = []
    for low, high in ((0.0, 3.3), (3.3, 6.6), (6.6, 13.0), (13.0, np.inf)):
        own = (size >= low) & (size < high)
        if own.any():
            points.append({"size": float(np.mean(size[own]))} | _share(int(seen[own].sum()), int(own.sum())))
    return found | {"threshold": float(np.mean(threshold)), "points": points}


def _ratio(size: np.ndarray, threshold: np.ndarray, seen: np.ndarray) -> float:
    """How many times the bound's sizes logs with these thresholds take, by the greatest likelihood."""

    def loss(log_ratio: float) -> float:
        p = np.clip(norm.cdf(size * math.exp(-log_ratio) - threshold), 1e-3, 1.0 - 1e-3)
        return -float(np.sum(seen * np.log(p) + (1.0 - seen) * np.log(1.0 - p)))

    return math.exp(minimize_scalar(loss, bounds=(-1.5, 1.5), method="bounded").x)


def _confusion(singles: Mapping[Key, dict]) -> dict[str, dict[str, float]]:
    """Hidden effect -> share of its logs at twice the limit in whose best names each effect stands."""
    rows: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(key[1] for key in singles):
        own = [r for key, r in singles.items() if key[1] == name and key[2] == 2.0]
        for result in own:
            names = {members[0] for members in result["sets"]} or {"nothing"}
            for found in names:
                row = rows.setdefault(name, {})
                row[found] = row.get(found, 0.0) + 1.0 / len(own)
    return rows


def _show(numbers: dict) -> None:
    rows = []
    for name, entry in numbers.items():
        if isinstance(entry, dict) and "share" in entry:
            rows.append((name, _text(entry), "", "", ""))
        elif isinstance(entry, dict) and "detected" in entry:
            size = entry["mean set size"]
            parts = [_text(entry[k]) for k in ("detected", "truth in a set", "interval holds the truth")]
            rows.append((name, *parts, "-" if size is None else f"{size:.2f} ({entry['theory of it']:.2f})"))
    heading = (
        "logs",
        "alarm, wrong name, or detected",
        "truth in a set",
        "interval holds",
        "set size (theory)",
    )
    console().print(table("hide and find: share (95 % interval) of logs", heading, rows))
    rows = [
        (bar["what"], _text(bar), _range(bar), {True: "met", False: "missed", None: "not run"}[bar["met"]])
        for bar in numbers["bars"]
    ]
    console().print(table("bars", ("share of logs", "share (95 % interval)", "bar", ""), rows))
    if (power := numbers["power"])["ratio"] is not None:
        ratio, low, high = power["ratio"], power["low"], power["high"]
        say(f"power: it takes {ratio:.2f} times the sizes of the Fisher bound ({low:.2f} to {high:.2f})")
    seconds = numbers["core seconds"]
    if seconds["median"] is not None:
        say(f"core-seconds of a verdict: median {seconds['median']:.1f}, 95 % {seconds['95 %']:.1f}")
    if (gain := numbers["gain over oracle's"])["logs"]:
        say(f"gain: {gain['pooled']:.0%} of the oracle's, over {gain['logs']} logs")
    if numbers["failed"]:
        say(f"{numbers['failed']} logs could not be driven or diagnosed")


def _range(bar: dict) -> str:
    least, most = bar["least"], bar["most"]
    if most == 1.0:
        return f">= {least:.0%}"
    return f"<= {most:.0%}" if least == 0.0 else f"{least:.0%} to {most:.0%}"


def _text(entry: dict) -> str:
    return f"{entry['hits']}/{entry['count']} ({entry['low']:.1%} to {entry['high']:.1%})"
