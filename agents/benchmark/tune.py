"""Tune the knobs of every arm with one budget: ``python -m agents.benchmark.tune``.

The same search for each arm, over the same training episodes (never those of a benchmark): the
middle of the box of its knobs, the find of the search before and a low-discrepancy sample, then rounds
in which the best survive, change a little, and drive more episodes. In the final every arm drives the
best knobs that any arm has found (with its own n or z), and its own from the search before, so that no
arm is better or worse by the luck of its search. The lowest mean score wins (`agents.benchmark.runner`).
The result is the module `agents.controllers.tuned`. ``--knobs common`` searches nothing but where in the
prior nominal does best with the knobs that the oracle has there.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import qmc

from agents.benchmark.runner import draw_episodes, run_jobs
from agents.controllers import tuned as shipped
from agents.controllers.arms import ARMS, ArmSettings, make_arm
from agents.controllers.tuned import SETTINGS

__all__ = [
    "COMMON",
    "HERE",
    "OWN",
    "PLACES",
    "Round",
    "TuneArgs",
    "Tuned",
    "knobs",
    "own_knobs",
    "search_arm",
    "tune_place",
    "tune_scenario",
    "write_settings",
]

_CORNERS = {"margin": (0.5, 1.1), "slip_angle": (0.15, 0.52), "feed_forward": (0.3, 1.0)}

#: Knobs of a task's controller with the ranges that are searched, the same for all arms.
#: ``slip_angle`` ends where the table of `agents.controllers.traction_limits` does.
COMMON: dict[str, dict[str, tuple[float, float]]] = {
    "track": {"distance": (0.01, 0.05), "unknown": (0.2, 2.0), "feed_forward": (0.0, 1.3)},
    "speed": _CORNERS,
    "climb": {"slip_share": (0.5, 4.0)},
    "brake": {"brake_share": (0.4, 2.0)},
    "ride": {"ride_speed": (4.0, 8.0), "ride_change": (0.0, 3.0), "ride_feel": (0.0, 1.0)}
    | {"ride_share": (0.45, 0.9)},
    "patches": _CORNERS | {"integral": (0.0, 1.5)},
}

#: Knobs that only one arm has. ``n`` is a place in the prior. ``z`` starts above 0: an arm that ignores the
#: standard deviation is not the aware arm.
OWN: dict[str, dict[str, tuple[float, float]]] = {"nominal": {"n": (0.0, 1.0)}, "aware": {"z": (0.25, 2.0)}}

#: Places in the prior, 0 the lowest n, of which nominal gets the best where the other knobs are the oracle's.
PLACES = np.linspace(0.0, 1.0, 9)

#: The same where a task asks for other ones: at the given speed of `track` there is nothing to insure.
HERE: dict[tuple[str, str], dict[str, tuple[float, float]]] = {("track", "aware"): {}}


def own_knobs(scenario: str, name: str) -> dict[str, tuple[float, float]]:
    """Knobs that no other arm of the task has, with their ranges."""
    return HERE.get((scenario, name), OWN.get(name, {}))


def knobs(scenario: str, name: str) -> dict[str, tuple[float, float]]:
    """Knobs of an arm in a task: name -> (lowest, highest) value of the search."""
    return COMMON[scenario] | own_knobs(scenario, name)


@dataclass(frozen=True)
class Round:
    """One round of the search."""

    parents: int  #: best candidates of the last round that stay in
    children: int  #: changed copies of each; in the first round: candidates in all
    episodes: int  #: training episodes of each candidate


@dataclass(frozen=True, kw_only=True)
class TuneArgs:
    """Arguments of the search; the budget is the same for every arm."""

    scenario: str = "speed"  #: scenario to tune for
    knobs: Literal["own", "common"] = "own"  #: a search for each arm, or the oracle's knobs for all
    seed: int = 0  #: of the candidates and the training episodes
    n_jobs: int = 2  #: local processes
    rounds: tuple[Round, ...] = (Round(0, 10, 6), Round(3, 2, 10))  #: the search of each arm
    finalists: int = 1  #: candidates that each arm sends to the final
    final_episodes: int = 30  #: training episodes of each candidate in the final
    spread: float = 0.1  #: standard deviation of a change, as a share of the knob's range [-]


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """The winner of a search."""

    settings: ArmSettings
    score: float  #: mean score on the training episodes of the final
    episodes: int  #: episodes driven for this arm


def search_arm(
    name: str, args: TuneArgs, *, progress: Callable[[str, int, int], None] | None = None
) -> tuple[list[ArmSettings], int]:
    """Search the knobs of one arm.

    Parameters
    ----------
    name
        In `ARMS`.
    args
    progress
        Called with (arm, episodes done, episodes in all of this round).

    Returns
    -------
    (finalists, episodes): the best candidates, best first, and the number of episodes driven.
    """
    box = knobs(args.scenario, name)
    low, high = (np.array([limits[i] for limits in box.values()]) for i in (0, 1))
    rng = np.random.default_rng(args.seed)
    population = qmc.Halton(len(box), rng=rng).random(args.rounds[0].children)
    held = asdict(ArmSettings(**SETTINGS[args.scenario, name]))
    population[0] = 0.5
    population[1:2] = np.clip((np.array([held[knob] for knob in box]) - low) / (high - low), 0.0, 1.0)
    driven = 0
    for index, stage in enumerate(args.rounds):
        if index > 0:
            parents = population[: stage.parents]
            noise = rng.standard_normal((stage.children, *parents.shape))
            children = np.clip(parents + args.spread * noise, 0.0, 1.0)
            population = np.concatenate((parents, children.reshape(-1, len(box))))
        candidates = [_settings(box, low + row * (high - low)) for row in population]
        scores = _scores(name, candidates, args, stage.episodes, progress)
        driven += stage.episodes * len(candidates)
        population = population[np.argsort(scores, kind="stable")]
    best = population[: args.finalists]
    return [_settings(box, low + row * (high - low)) for row in best], driven


def _settings(box: dict[str, tuple[float, float]], values: np.ndarray) -> ArmSettings:
    return ArmSettings(**{name: round(float(value), 4) for name, value in zip(box, values, strict=True)})


def _scores(
    name: str,
    candidates: list[ArmSettings],
    args: TuneArgs,
    episodes: int,
    progress: Callable[[str, int, int], None] | None,
) -> np.ndarray:
    jobs = {
        i: make_arm(name, scenario=args.scenario, settings=settings) for i, settings in enumerate(candidates)
    }

    def report(done: int, total: int) -> None:
        if progress is not None:
            progress(name, done, total)

    results: dict[Any, Any] = run_jobs(
        args.scenario,
        jobs,
        draw_episodes(args.scenario, episodes, args.seed, training=True),
        n_jobs=args.n_jobs,
        progress=report,
    )
    return np.array([results[i].scores.mean() for i in range(len(candidates))])


def tune_scenario(
    args: TuneArgs, *, progress: Callable[[str, int, int], None] | None = None
) -> dict[str, Tuned]:
    """Tune all arms of a scenario with the same budget: a search each, and one final for all."""
    found = {name: search_arm(name, args, progress=progress) for name in ARMS}
    pool = [settings for finalists, _ in found.values() for settings in finalists]
    tuned = {}
    for name, (finalists, driven) in found.items():
        own = {knob: getattr(finalists[0], knob) for knob in own_knobs(args.scenario, name)}
        held = ArmSettings(**SETTINGS[args.scenario, name])
        candidates = [s if s in finalists else replace(s, **own) for s in pool] + [held]
        scores = _scores(name, candidates, args, args.final_episodes, progress)
        best = int(np.argmin(scores))
        driven += args.final_episodes * len(candidates)
        tuned[name] = Tuned(settings=candidates[best], score=float(scores[best]), episodes=driven)
    return tuned


def tune_place(
    args: TuneArgs, *, progress: Callable[[str, int, int], None] | None = None
) -> tuple[float, float]:
    """Place in the prior where nominal scores best with the knobs of the oracle, and its mean score there."""
    common = SETTINGS[args.scenario, "oracle"]
    candidates = [ArmSettings(**common, n=float(place)) for place in PLACES]
    scores = _scores("nominal", candidates, args, args.final_episodes, progress)
    best = int(np.argmin(scores))
    return float(PLACES[best]), float(scores[best])


def write_settings(
    path: Path, args: TuneArgs, tuned: dict[str, Tuned], place: tuple[float, float] | None = None
) -> None:
    """Write the module of tuned settings; other scenarios in it are kept, and what was not searched."""
    # Read anew: another search may have written since this one began.
    held = runpy.run_path(str(path)) if path.exists() else vars(shipped)
    runs, places = dict(held["RUNS"]), dict(held["COMMON_PLACES"])
    if place is not None:
        places[args.scenario] = place[0]
        driven = f"{len(PLACES)} x {args.final_episodes} episodes"
        runs[f"{args.scenario} common"] = f"seed {args.seed}, {driven}: nominal {place[1]:.3g}"
    table = {key: dict(value) for key, value in held["SETTINGS"].items()}
    for name, result in tuned.items():
        own = set(knobs(args.scenario, name))
        table[args.scenario, name] = {
            key: value for key, value in asdict(result.settings).items() if key in own
        }
    if tuned:
        budget = next(iter(tuned.values())).episodes
        scores = ", ".join(f"{name} {result.score:.3g}" for name, result in tuned.items())
        runs[args.scenario] = f"seed {args.seed}, {budget} episodes an arm: {scores}"
    path.write_text(_module(runs, table, places), encoding="utf-8")


def _module(
    runs: dict[str, str], table: dict[tuple[str, str], dict[str, float]], places: dict[str, float]
) -> str:
    """Text of the module."""
    lines = [
        '"""Tuned knobs of the arms. Written by ``python -m agents.benchmark.tune``; do not edit by hand."""',
        "",
        "from __future__ import annotations",
        "",
        '__all__ = ["COMMON_PLACES", "RUNS", "SETTINGS"]',
        "",
        "#: Scenario -> the search that its settings come from, with the mean scores in training.",
        "RUNS: dict[str, str] = {",
        *(f'    "{key}": "{value}",' for key, value in sorted(runs.items())),
        "}",
        "",
        "#: Scenario -> place in the prior where nominal does best with the knobs of the oracle.",
        "COMMON_PLACES: dict[str, float] = {",
        *(f'    "{key}": {value:g},' for key, value in sorted(places.items())),
        "}",
        "",
        "#: (scenario, arm) -> fields of `agents.controllers.arms.ArmSettings`.",
        "SETTINGS: dict[tuple[str, str], dict[str, float]] = {",
        *(line for key, value in sorted(table.items()) for line in _literal(key, value)),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _literal(key: tuple[str, str], values: dict[str, float]) -> list[str]:
    rows = [f'        "{name}": {value:g},' for name, value in values.items()]
    return [f'    ("{key[0]}", "{key[1]}"): {{', *rows, "    },"]


def main() -> None:
    """Tune one scenario and rewrite `agents.controllers.tuned`."""
    import tyro
    from rich.progress import Progress

    args = tyro.cli(TuneArgs, description=__doc__)
    with Progress() as bar:
        task = bar.add_task("tuning", total=None)

        def report(name: str, done: int, total: int) -> None:
            bar.update(task, description=f"tuning {name}", completed=done, total=total)

        place = tune_place(args, progress=report) if args.knobs == "common" else None
        tuned = tune_scenario(args, progress=report) if args.knobs == "own" else {}
    write_settings(Path(str(shipped.__file__)), args, tuned, place)


if __name__ == "__main__":
    main()
