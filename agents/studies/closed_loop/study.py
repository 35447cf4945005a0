"""``offroad reproduce closed_loop``: what a diagnosis is worth to the one who drives.

A vehicle has a hidden cause. It is driven once, carefully, by the plan for the nominal model; the log is
diagnosed; the plan is made again for the extended model; and both plans drive other courses, beside the plan
for the true model. n is known to all three, so that nothing but the cause makes the difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.benchmark.statistics import Interval, mean_interval, recovered_share
from agents.commands.options import Jobs
from agents.driving.recording import MeasuredRun
from agents.driving.unwrapped import bekker_env
from agents.reports.output import Results, console, table
from agents.studies.closed_loop.planning import TASK, careful, driver, make_world, plan_for, scores_in
from agents.studies.closed_loop.results import CauseLine
from agents.studies.runner import Key, Result, run_units, stamp_of
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.summarise import summarise
from offroad_env.effects import EFFECTS, Extension
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter, OffroadError
from offroad_env.world.vehicles import VEHICLES

__all__ = ["CAUSES", "ClosedLoop", "cause_lines", "run_unit", "true_model"]

#: Vehicle of the task.
VEHICLE = "mrzr"
#: Hidden causes, and their size as a share of the largest believable one.
CAUSES: Mapping[str, float] = {
    "steer_delay": 0.8,
    "steer_lag": 0.8,
    "payload": 0.8,
    "torque_scale": -0.8,
    "rut_drag": 0.8,
    "friction_angle": -0.8,
    "cg_shift": 0.8,
}
#: Share of the planned lateral limit in the drive that is logged, and its longest time [s].
_CAREFUL, _LOGGED = 0.5, 60.0
#: Episodes in which a plan is chosen, and rounds of the search; the same for every model.
_CHOSEN_ON, _GENERATIONS = 4, 3
_QUICK = 2
_SOURCES = (
    "agents.studies.closed_loop.planning",
    "estimators.discrepancy.diagnosis",
    "offroad_env.environment.env",
)


def true_model(cause: str) -> Extension:
    """The vehicle with the hidden cause."""
    effect = EFFECTS[cause]
    size = CAUSES[cause] * effect.plausible(VEHICLES[VEHICLE])
    return Extension(model="full", effects=((cause, {effect.parameters[0].name: size}),))


class _Drawn(NamedTuple):
    """Soil and episodes of a seed."""

    n: float
    chosen_on: list[int]
    tested_on: list[int]
    logged: int


def _drawn(seed: int, tests: int) -> _Drawn:
    rng = np.random.default_rng([seed, 11])
    n = float(rng.uniform(*find_scenario(TASK).n_range))
    drawn = rng.integers(0, 2**31, _CHOSEN_ON + tests + 1).tolist()
    return _Drawn(n, drawn[:_CHOSEN_ON], drawn[_CHOSEN_ON:-1], drawn[-1])


def planned(seed: int, tests: int, model: Extension | None = None) -> dict[str, float]:
    """The plan on the soil of a seed for a model; None: the nominal one, for which all causes share it."""
    drawn = _drawn(seed, tests)
    return plan_for(model, drawn.n, drawn.chosen_on, generations=_GENERATIONS, seed=seed)


def run_unit(
    cause: str, seed: int, tests: int, *, nominal: Mapping[int, Mapping[str, float]]
) -> dict[str, Any]:
    """One vehicle on one soil: the scores [s] of the three plans on the same test episodes.

    ``nominal`` : seed -> its plan for the nominal model, see `planned`.
    """
    n, _, tested_on, logged = _drawn(seed, tests)
    truth = true_model(cause)
    plans = {"nominal": dict(nominal[seed])}
    world = make_world(truth)
    extended, verdict = _diagnosed(world, careful(plans["nominal"], _CAREFUL), logged, n)
    plans["extended"] = plans["nominal"] if extended is None else planned(seed, tests, extended)
    plans["true"] = planned(seed, tests, truth)
    found = [] if extended is None else [name for name, _ in extended.effects]
    scores = {name: scores_in(world, knobs, tested_on, n) for name, knobs in plans.items()}
    world.close()
    return {"n": n, "verdict": verdict, "found": found, "plans": plans, "scores": scores}


def _nominal_plan(_kind: str, seed: int, tests: int) -> dict[str, float]:
    return planned(seed, tests)


def _diagnosed(
    world: gym.Env, knobs: Mapping[str, float], seed: int, n: float
) -> tuple[Extension | None, str]:
    """(extended model, verdict) after one drive; no model where nothing is named."""
    agent = driver(knobs)
    observation, _ = world.reset(seed=seed, options={"n": n})
    agent.reset(bekker_env(world).briefing)
    run, over, info = MeasuredRun(world), False, {"time": 0.0}
    while not over and info["time"] < _LOGGED:
        observation, _, terminated, truncated, info = world.step(agent.act(observation))
        run.add(world)
        over = terminated or truncated
    try:
        summary = summarise(diagnose([run.log("first drive")]))
    except OffroadError as error:
        return None, f"{type(error).__name__}: {error}"
    return summary.extended_model, str(summary.verdict)


def cause_lines(results: Mapping[Key, Result]) -> list[CauseLine]:
    """A line for every cause from the results by (cause, seed, ...)."""
    lines = []
    for cause in dict.fromkeys(key[0] for key in results):
        units = [result for key, result in results.items() if key[0] == cause]
        nominal, extended, true = (
            np.array([np.mean(unit["scores"][name]) for unit in units])
            for name in ("nominal", "extended", "true")
        )
        loss = mean_interval(nominal - true)
        lines.append(
            CauseLine(
                cause=cause,
                named=sum(cause in unit["found"] for unit in units),
                units=len(units),
                nominal=mean_interval(nominal),
                extended=mean_interval(extended),
                true=mean_interval(true),
                loss=loss,
                gain=mean_interval(nominal - extended),
                recovered=recovered_share(extended, true, (nominal,)) if loss.low > 0.0 else None,
            )
        )
    return lines


def recovered_together(results: Mapping[Key, Result], lines: Sequence[CauseLine]) -> Interval | None:
    """Share of the loss that is recovered over all causes with a loss above zero; None without any.

    Resampled over soils, since the causes share these.
    """
    causes = [line.cause for line in lines if line.recovered is not None]
    means: dict[int, dict[str, dict[str, float]]] = {}
    for key, result in results.items():
        if key[0] in causes:
            scores = {name: float(np.mean(own)) for name, own in result["scores"].items()}
            means.setdefault(int(key[1]), {})[str(key[0])] = scores
    whole = [own for own in means.values() if len(own) == len(causes)]
    if not causes or len(whole) < 2:
        return None
    nominal, extended, true = (
        np.array([np.mean([one[name] for one in own.values()]) for own in whole])
        for name in ("nominal", "extended", "true")
    )
    return recovered_share(extended, true, (nominal,))


@dataclass(kw_only=True)
class ClosedLoop(Results):
    """What a diagnosis is worth to the one who drives, over hidden causes and soils.

    Every vehicle with a hidden cause is driven once by the plan for the nominal model; its log is diagnosed,
    the plan is made again for the extended model, and both plans drive test courses beside the plan for the
    true model. Writes closed_loop.png, and closed_loop.jsonl with every vehicle: one that is there is not
    driven again.
    """

    quick: bool = False  #: two soils
    seeds: int = 10  #: soils for every cause
    tests: int = 6  #: test courses of every plan on every soil
    seed: int = 0  #: first one
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Drive what is missing, then print, draw and write."""
        from agents.studies.closed_loop.figure import closed_loop_figure

        count = _QUICK if self.quick else self.seeds
        if count < 2 or self.tests < 1:
            raise InvalidParameter("seeds must be at least 2 (one has no interval) and tests at least 1")
        stamp = f"{stamp_of(*_SOURCES)}-{CAUSES}"
        seeds = [self.seed + k for k in range(count)]
        path = self.out / "closed_loop.jsonl"
        units: dict[Key, str] = dict.fromkeys([("nominal plan", seed, self.tests) for seed in seeds], stamp)
        plans = run_units(path, _nominal_plan, units, label="nominal plans", n_jobs=self.n_jobs)
        work = partial(run_unit, nominal={int(key[1]): plan for key, plan in plans.items()})
        units = dict.fromkeys([(cause, seed, self.tests) for seed in seeds for cause in CAUSES], stamp)
        results = run_units(path, work, units, label="closed loop", n_jobs=self.n_jobs)
        lines = cause_lines(results)
        together = recovered_together(results, lines)
        _show(lines, together)
        self.save_figure(
            closed_loop_figure(lines),
            "closed_loop",
            "A row is a cause; where the plan for the extended model is as good as that for the truth, the "
            "diagnosis is worth what the cause costs.",
        )
        self.save_numbers({"causes": lines, "together": together, "seed": self.seed, "tests": self.tests})


def _show(lines: list[CauseLine], together: Interval | None) -> None:
    body = [
        (
            line.cause,
            f"{line.named} of {line.units}",
            f"{line.nominal.value:.1f}",
            f"{line.extended.value:.1f}",
            f"{line.true.value:.1f}",
            f"{line.loss:.1f}",
            f"{line.gain:.1f}",
            "-" if line.recovered is None else _share_text(line.recovered),
        )
        for line in lines
    ]
    heading = (
        "hidden cause",
        "named",
        "nominal plan [s]",
        "extended [s]",
        "true [s]",
        "loss [s]",
        "gain [s]",
        "recovered",
    )
    console().print(table(f"{TASK}: plans by what the vehicle is held to be, n known", heading, body))
    if together is not None:
        console().print(f"recovered over all causes with a loss: {_share_text(together)}")


def _share_text(share: Interval) -> str:
    return f"{100.0 * share.value:.0f} % [{100.0 * share.low:.0f}, {100.0 * share.high:.0f}]"
