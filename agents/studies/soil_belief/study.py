"""``offroad reproduce soil_belief``: what a belief over whole soils states on soils nobody has seen.

Units are one drive of one case (`estimators.experiments.unknown_soils`). The filter was configured
on drives of the split "tuning"; by default the drives are of the split "test".
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, run_units, stamp_of
from estimators.experiments.soil_belief import (
    BeliefHistory,
    believe,
    believe_fitted,
    foreseen,
    limit_errors,
    stuck_at,
)
from estimators.experiments.soil_bound import limit_bounds
from estimators.experiments.unknown_soils import CASES, SPLITS, TEST_CASES, SoilRun, draw_run
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.simulation.soil_holds import SoilHolds

__all__ = ["AT", "BARS", "CaseLine", "LimitLine", "SoilBelief", "case_lines", "limit_lines", "run_unit"]

#: When the belief is looked at [s], the last time counts; how long the drive goes on.
AT, _ON = (2.0, 5.0, 10.0), 4.0
#: Latest time at which it counts [s].
_LONGEST = 120.0
#: How long the vehicle is watched after that where it may get stuck: an alarm shortly before the end of the
#: drive is not false because the drive ends [s].
_WATCHED = 8.0
#: Ends of the classes of probability in which the risk is compared with what happens.
_RISKS = (0.2, 0.8)
#: How long ahead an immobilisation must be announced, and who knows the soil must foresee it; how long that
#: foresight may last [s].
_AHEAD, _FORESEEN, _WITHIN = 2.0, 3.0, 4.0
#: Ends of the normal 95 % and 99 % intervals.
_Z95, _Z99 = 1.959964, 2.575829
#: A limit counts as used from this share on.
_USED = 0.6
#: Requirements: coverage of the limits, their median error where they were used, and for the other cases the
#: share of the flagged time outside of the 99 % interval and the share of the excited time with the flag up;
#: the latter is an upper limit where no structure of the filter is that of the truth.
BARS = {
    "coverage": (0.9, 0.98),
    "error": 0.1,
    "outside": 0.05,
    "flag": 0.7,
    "flag_grid": 0.1,
    "over_bound": 2.0,
    "announced": 0.9,
    "false_per_km": 1.0,
}
#: Cases of which the limits are tabled.
_DRAWN = ("nuisances", "level")
#: All limits but the best slip, which no drive needs to a few per cent, and n.
_NAMES = (*(name for name in SoilHolds._fields if name != "pull_slip"), "n")


class LimitLine(NamedTuple):
    """One limit, or n, over all drives with nuisances, 10 s after the start."""

    name: str
    runs: int
    coverage: float  #: of the 95 % interval
    error: float  #: median relative error; of n absolute
    width: float  #: median half width of the 95 % interval, relative; of n absolute
    error_used: float  #: median error where the drive used 60 % of the limit; NaN where nothing measures that
    runs_used: int


class StuckLine(NamedTuple):
    """Immobilisations on the soils of one case."""

    case: str
    stuck: int  #: drives that end stuck, later than `_FORESEEN` after the start, as the truth foresees
    announced: float  #: share of them that was announced `_AHEAD` before
    false: int  #: drives that were announced and did not get stuck, nor in the seconds after the drive
    kilometres: float  #: of the drives that did not get stuck
    risks: list[tuple[int, float]]  #: (drives, share that has no pull) after 5 s by classes of probability


class CaseLine(NamedTuple):
    """One case over all its drives."""

    case: str
    runs: int
    flag: float  #: share of the excited time with the flag up
    outside: float  #: share of the flagged time in which a 99 % interval fails, of the worst number
    worst: str  #: that number
    #: (2, 6) median standard deviation after 10 s over the bound of `limit_bounds`; NaN: other laws in truth
    over_bound: list[list[float]]


def _over_bound(run: SoilRun, history: BeliefHistory, after: float) -> list[list[float]]:
    """(2, 6) standard deviations ``after`` [s] over their bounds; NaN where the truth has other laws."""
    if not CASES[run.case].is_modelled:
        return np.full((2, len(_NAMES)), math.nan).tolist()
    kept = [i for i, name in enumerate(SoilHolds._fields) if name != "pull_slip"]
    row = int(np.searchsorted(history.t, after)) - 1
    own = np.append(history.sd[row][kept], history.n[row, 1])
    try:
        bound = limit_bounds(run, after)
    except SolverFailure:  # without scatter the soil stops the vehicle
        return np.full((2, len(_NAMES)), math.nan).tolist()
    # A limit beyond its range does not depend on the soil: no bound.
    ratios: list[list[float]] = np.divide(
        own, bound, out=np.full(bound.shape, math.nan), where=bound > 0.0
    ).tolist()
    return ratios


def _numbers(run: SoilRun, history: BeliefHistory, after: float) -> dict[str, Any]:
    """A drive in plain numbers."""
    errors = limit_errors(run, history)
    rows = np.searchsorted(history.t, (*AT[:-1], after)) - 1
    up, flags = history.valid, history.valid[history.excited]
    outside = np.abs(errors.z) > _Z99
    return {
        "z": errors.z[rows].tolist(),
        "error": errors.relative[rows].tolist(),
        "width": errors.width[rows].tolist(),
        "used": history.used[rows[-1]].tolist(),
        "valid": bool(history.valid[rows[-1]]),
        "flag": [int(flags.sum()), len(flags)],
        "outside": [outside[up].sum(axis=0).tolist(), int(up.sum())],
        "stuck": stuck_at(run),
        "over_bound": _over_bound(run, history, after),
        "foreseen": foreseen(run, _FORESEEN, _WITHIN),
        "risk": history.risk[rows].tolist(),
        "no_pull": bool(run.holds.pull <= 0.0),
        "announced": _first(history.t, history.announced),
        "distance": history.distance,
    }


def _first(t: np.ndarray, event: np.ndarray) -> float:
    """When an event came first [s]; infinite where it did not."""
    rows = np.flatnonzero(event)
    return float(t[rows[0]]) if rows.size else math.inf


def run_unit(case: str, seed: int, split: str, after: float = AT[-1]) -> dict[str, Any]:
    """One drive, see `_numbers`: errors in standard deviations, relative errors, half widths.

    Looked at as `AT` says, but for the last time, ``after`` [s].
    """
    run = _drive(case, seed, split, after)
    return _numbers(run, believe(run, until=after + _ON), after)


def run_fitted_unit(case: str, seed: int, split: str, after: float = AT[-1]) -> dict[str, Any]:
    """The same by the fitted belief."""
    run = _drive(case, seed, split, after)
    return _numbers(run, believe_fitted(run, until=after + _ON), after)


def _drive(case: str, seed: int, split: str, after: float = AT[-1]) -> SoilRun:
    watched = _WATCHED if CASES[case].soil is None else 0.0
    return draw_run(case, seed, split=split, duration=after + _ON + watched)


#: Name of the results, and what runs a drive, by method.
_METHODS = {"online": ("soil_belief", run_unit), "fitted": ("fitted_belief", run_fitted_unit)}


def limit_lines(results: Mapping[Key, Mapping[str, Any]], case: str = "nuisances") -> list[LimitLine]:
    """A line for every limit, from the results by (case, seed, split)."""
    found = [result for key, result in results.items() if key[0] == case]
    if not found:
        return []
    z, error, width = (np.array([result[name][-1] for result in found]) for name in ("z", "error", "width"))
    used = np.array([result["used"] for result in found]) >= _USED
    measured = {"lateral": used[:, 0], "pull": used[:, 1]}
    lines = []
    for i, name in enumerate(_NAMES):
        where = measured.get(name, np.zeros(len(found), dtype=bool))
        lines.append(
            LimitLine(
                name=name,
                runs=len(found),
                coverage=float(np.mean(np.abs(z[:, i]) < _Z95)),
                error=float(np.median(error[:, i])),
                width=float(np.median(width[:, i])),
                error_used=float(np.median(error[where, i])) if where.any() else float("nan"),
                runs_used=int(where.sum()),
            )
        )
    return lines


def widths_over_time(results: Mapping[Key, Mapping[str, Any]]) -> np.ndarray:
    """(times, numbers) median half widths at `AT` of the drives with nuisances."""
    found = [result["width"] for key, result in results.items() if key[0] == "nuisances"]
    widths: np.ndarray = np.median(np.array(found), axis=0)
    return widths


def case_lines(results: Mapping[Key, Mapping[str, Any]]) -> list[CaseLine]:
    """A line for every case, from the results by (case, seed, split)."""
    lines = []
    for case in dict.fromkeys(key[0] for key in results):
        found = [result for key, result in results.items() if key[0] == case]
        flag = np.sum([result["flag"] for result in found], axis=0)
        outside = np.sum([result["outside"][0] for result in found], axis=0)
        shares = outside / max(sum(result["outside"][1] for result in found), 1)
        i = int(np.argmax(shares))
        acting = float(flag[0] / flag[1]) if flag[1] else float("nan")
        ratios = np.array([result["over_bound"] for result in found])
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "All-NaN slice")
            over = np.nanmedian(ratios, axis=0).tolist()
        lines.append(CaseLine(case, len(found), acting, float(shares[i]), _NAMES[i], over))
    return lines


def stuck_lines(results: Mapping[Key, Mapping[str, Any]], after: float = AT[-1]) -> list[StuckLine]:
    """A line for each case whose soils are drawn, from the results by (case, seed, split)."""
    lines = []
    for case in dict.fromkeys(key[0] for key in results if CASES[key[0]].soil is None):
        found = [result for key, result in results.items() if key[0] == case]
        end = after + _ON
        late = [result for result in found if result["foreseen"] and _FORESEEN < result["stuck"] <= end]
        free = [result for result in found if result["stuck"] == math.inf]
        ahead = [result["stuck"] - result["announced"] >= _AHEAD for result in late]
        lines.append(
            StuckLine(
                case=case,
                stuck=len(late),
                announced=float(np.mean(ahead)) if ahead else math.nan,
                false=sum(result["announced"] < math.inf for result in free),
                kilometres=1e-3 * sum(result["distance"] for result in free),
                risks=_reliability(found),
            )
        )
    return lines


def _reliability(found: Sequence[Mapping[str, Any]]) -> list[tuple[int, float]]:
    """(drives, share without pull) after 5 s by classes of the probability that was stated."""
    moving = [result for result in found if result["stuck"] > AT[1]]
    stated = np.array([result["risk"][1] for result in moving])
    happens = np.array([result["no_pull"] for result in moving], dtype=bool)
    classes = np.searchsorted(_RISKS, stated)
    return [
        (int((classes == i).sum()), float(happens[classes == i].mean()) if (classes == i).any() else math.nan)
        for i in range(len(_RISKS) + 1)
    ]


@dataclass(kw_only=True)
class SoilBelief(Results):
    """A belief over whole soils: what the soil holds, n, and the flag.

    Coverage, error and width of the limits on soils drawn from the population, with all nuisances; flag and
    99 % interval where one thing differs. Writes soil_belief.png, and soil_belief.jsonl with the result of
    every drive (fitted_belief.png and .jsonl for the fits): a drive that is there is not repeated.
    """

    quick: bool = False  #: 8 drives with nuisances and 2 of each other case
    seeds: int = 240  #: drives with nuisances; half as many on soft soils
    case_seeds: int = 20  #: drives of each other case
    first_seed: int = 0  #: of every case
    under: tuple[str, ...] = ()  #: these cases
    method: Literal["online", "fitted"] = "online"  #: filter, or fits to the drive so far
    after: float = AT[-1]  #: driving after which the intervals count, more than 5 [s]
    tuning: bool = False  #: drives on which the settings were chosen
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.soil_belief.figure import soil_belief_figure

        if self.quick:
            self.seeds, self.case_seeds = 8, 2
        name, unit = _METHODS[self.method]
        at = (*AT[:-1], self.after)
        results = run_units(
            self.out / f"{name}.jsonl", unit, self._units(), label="soil belief", n_jobs=self.n_jobs
        )
        found = {case: limit_lines(results, case) for case in _DRAWN}
        limits, cases = found[_DRAWN[0]], case_lines(results)
        risks = stuck_lines(results, self.after)
        for case, lines in found.items():
            _show_limits(case, lines, self.after)
        _show_cases(cases, self.after)
        if self.method == "online":
            _show_risks(risks)
        if limits:
            self.save_figure(
                soil_belief_figure(limits, widths_over_time(results), at, BARS),
                name,
                "Left: intervals should hold the truth as often as the grey range demands. Right: how "
                "they shrink with time.",
            )
        self.save_numbers({"limits": found, "cases": cases, "stuck": risks, "bars": BARS, "at": at})

    def _drives(self, case: str) -> int:
        """How many drives of a case."""
        if CASES[case].soft:
            return max(self.seeds // 2, 1)
        return self.seeds if case in _DRAWN else self.case_seeds

    def _units(self) -> dict[Key, str]:
        unknown = [case for case in self.under if case not in CASES]
        if unknown:
            raise InvalidParameter(f"under must name some of {', '.join(CASES)}, got {unknown[0]!r}")
        if min(self.seeds, self.case_seeds) < 1 or self.first_seed < 0:
            raise InvalidParameter("seeds and case_seeds must be 1 or more, first_seed 0 or more")
        if not AT[1] < self.after <= _LONGEST:
            raise InvalidParameter(
                f"after must be above {AT[1]:g} and at most {_LONGEST:g} s, got {self.after:g}"
            )
        stamp = stamp_of("estimators.experiments.soil_belief", "estimators.experiments.soil_bound")
        split = SPLITS[0 if self.tuning else 1]
        later = () if self.after == AT[-1] else (self.after,)
        return {
            (case, seed, split, *later): stamp
            for case in self.under
            or tuple(case for case in CASES if split == "test" or case not in TEST_CASES)
            for seed in range(self.first_seed, self.first_seed + self._drives(case))
        }


def _show_risks(risks: Sequence[StuckLine]) -> None:
    body = [
        (
            CASES[line.case].title,
            str(line.stuck),
            _percent(line.announced),
            str(line.false),
            f"{line.kilometres:.1f}",
            *(f"{_percent(share)} ({drives})" for drives, share in line.risks),
        )
        for line in risks
    ]
    low, high = (f"{100.0 * end:.0f}" for end in _RISKS)
    classes = (f"no pull [%] (drives), risk < {low} %", f"{low} to {high} %", f"> {high} %")
    heading = ("case", "drives stuck", "announced 2 s ahead [%]", "false alarms", "in km", *classes)
    console().print(table("immobilisation", heading, body))


def _percent(value: float, digits: int = 0) -> str:
    return "-" if value != value else f"{100.0 * value:.{digits}f}"


def _show_limits(case: str, limits: Sequence[LimitLine], after: float) -> None:
    """One table of the limits."""
    if not limits:
        return
    body = [
        (
            line.name,
            str(line.runs),
            _percent(line.coverage, 1),
            _percent(line.error),
            _percent(line.width),
            _percent(line.error_used, 1),
            str(line.runs_used),
        )
        for line in limits
    ]
    heading = ("limit", "drives", "covers", "error", "half width", "error where used", "drives that used it")
    title = f"{CASES[case].title}, after {after:g} s: in per cent of the limit; n: in hundredths"
    console().print(table(title, heading, body))


def _show_cases(cases: Sequence[CaseLine], after: float) -> None:
    """Flags, intervals and widths over their bounds, case by case."""
    rows = [
        (CASES[line.case].title, str(line.runs), _percent(line.flag), _percent(line.outside, 1), line.worst)
        for line in cases
    ]
    console().print(
        table(
            "flag and 99 % intervals: in per cent",
            ("case", "drives", "flag up", "outside, flag up", "worst number"),
            rows,
        )
    )
    bounds = [
        (CASES[line.case].title, what, *(f"{ratio:.1f}" for ratio in ratios))
        for line in cases
        for what, ratios in zip(("exact", "unknown road"), line.over_bound, strict=True)
        if not math.isnan(ratios[0])
    ]
    title = f"standard deviation after {after:g} s over the bound, by what the bound takes for the model"
    console().print(table(title, ("case", "model", *_NAMES), bounds, texts=2))
    say("flag up: of the time in which steering or roughness acts; outside: of the time with the flag up")
