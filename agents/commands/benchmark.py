"""``offroad benchmark``: does knowing the soil pay? Arms and other agents on the same episodes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from agents.commands.options import Jobs, Scenarios
from agents.driving.world_options import WorldOptions, known_scenarios
from agents.reports.output import console, say, table, write_bytes, write_json
from offroad_env.environment.scenarios import BUILT_IN
from offroad_env.errors import InvalidParameter

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from agents.benchmark.learned import LearnedArm
    from agents.benchmark.study import BenchmarkArgs
    from agents.benchmark.summary import Benchmark

__all__ = ["BenchmarkRun"]

Form = Literal["matched", "mismatch", "natural", "natural_unusual", "natural_gnss", "twin"]  # alias
Forms = Annotated[tuple[Form, ...], tyro.conf.arg(aliases=["--form"])]

#: Former names of forms.
_FORMER: dict[str, str] = {"twin": "matched"}  # alias


def known_forms(forms: Iterable[str]) -> tuple[str, ...]:
    """Forms by their present names."""
    return tuple(_FORMER.get(form, form) for form in forms)


#: Episodes of the quick form: one in each twentieth of the prior.
_QUICK_EPISODES = 20
#: Episodes and tasks of model-predictive control there, which takes seconds an episode, and beside whom.
_PREDICTIVE_EPISODES, _PREDICTIVE_TASKS, _PREDICTIVE = 3, ("speed", "patches"), ("oracle", "nmpc_truth")


@dataclass(kw_only=True)
class BenchmarkRun:
    """Compare agents that know more or less of the soil on the same episodes.

    Writes benchmark.html (self-contained), benchmark.json and the episodes into --out. An interrupted
    run goes on where it stopped. The quick form takes minutes on two cores, the full one about an hour.
    """

    out: Path = Path("out/benchmark")  #: folder for the page, the numbers and the episodes
    quick: bool = False  #: 20 episodes each instead of 100, matched model only
    tasks: Scenarios = BUILT_IN  #: what is driven: names, or files of your own
    agents: tuple[str, ...] = ("pure_pursuit", "nominal", "conservative", "aware", "oracle")  #: who drives
    policies: bool = True  #: leave out the shipped policies, which are trained with several seeds each
    forms: Forms = ("matched", "mismatch")  #: vehicle as modelled, unlike it, or on whole measured soils
    knobs: Literal["common", "own"] | None = None  #: of the arms; default: common in natural forms, else own
    episodes: int = 100  #: paired episodes of each agent
    seed: int = 0  #: of the episodes
    n_jobs: Jobs = 2  #: local processes; the results do not depend on it
    json: Path | None = None  #: write the numbers to this file instead of benchmark.json
    world: WorldOptions = field(default_factory=WorldOptions)  #: what is driven on and with

    def run(self) -> None:
        """Drive what is missing, compare, write and print."""
        from agents.benchmark.study import run_learned, run_study

        start = time.perf_counter()
        args = self.arguments()
        results = run_study(args, self.out)
        trained = run_learned(args, self.out) if self.policies else {}
        seconds = time.perf_counter() - start
        command = (
            f"offroad benchmark --agents {' '.join(self.agents)}{'' if self.policies else ' --no-policies'}"
            f"{'' if self.knobs is None else f' --knobs {self.knobs}'}{self.world.words()}"
        )
        write_results(results, args, self.out, self.json, command=command, trained=trained, seconds=seconds)
        if self.quick:
            self._show_predictive(args)

    def _show_predictive(self, args: BenchmarkArgs) -> None:
        """Model-predictive control on few episodes: that it runs, and what it does."""
        from importlib.util import find_spec

        from agents.benchmark.study import run_study

        tasks = tuple(task for task in args.tasks if task in _PREDICTIVE_TASKS)
        if not tasks or "matched" not in args.forms:
            return
        if find_spec("casadi") is None:
            say("Model-predictive control is left out: pip install offroad-bekker[mpc]")
            return
        few = replace(
            args, tasks=tasks, forms=("matched",), agents=_PREDICTIVE, episodes=_PREDICTIVE_EPISODES
        )
        show_results(run_study(few, self.out))

    def arguments(self) -> BenchmarkArgs:
        """What is compared on what."""
        from agents.benchmark.study import BenchmarkArgs

        for option, given in (("scenario", self.tasks), ("agents", self.agents), ("forms", self.forms)):
            if not given:
                raise InvalidParameter(
                    f"{option} must name at least one, got none - an option without a value?"
                )
        args = BenchmarkArgs(
            tasks=known_scenarios(self.tasks),
            agents=self.agents,
            forms=known_forms(self.forms),
            episodes=self.episodes,
            seed=self.seed,
            n_jobs=self.n_jobs,
            world=self.world.digest(),
            knobs=self.knobs,
        )
        if not self.quick:
            return args
        natural = tuple(form for form in args.forms if form not in ("matched", "mismatch"))
        return replace(args, episodes=_QUICK_EPISODES, forms=natural or ("matched",))


def write_results(
    results: Mapping[tuple[str, str], Benchmark],
    args: BenchmarkArgs,
    out: Path,
    numbers: Path | None,
    *,
    command: str,
    seconds: float,
    trained: Mapping[tuple[str, str], list[LearnedArm]] | None = None,
    terrain_info: str | None = None,
) -> None:
    """Page and numbers into ``out``, and the verdicts on the screen.

    ``command`` made them, but for tasks, forms, episodes and seed. ``terrain_info`` is what agents that are
    given as ``module:Class`` observe of the soil.
    """
    from agents.benchmark.drive import drive_section
    from agents.benchmark.learned import learned_verdict
    from agents.benchmark.page import benchmark_sections, page_verdict
    from agents.benchmark.runner import FORM_TITLES
    from agents.reports.page import figure_picture, render_page
    from agents.studies.tasks.figure import tasks_figure
    from agents.studies.tasks.study import task_curves
    from offroad_env import __version__

    command = f"{command} --episodes {args.episodes} --seed {args.seed}"
    caption = (
        "The steeper a curve, the more its task depends on n. Curves from the forces of a wheel, runs of the "
        "vehicle's model, and two drives."
    )
    physics = figure_picture(tasks_figure(task_curves()), caption)
    write_bytes(out / "tasks.png", physics.png)
    overview, *others = benchmark_sections(results, physics, trained or {}, command=command, seconds=seconds)
    page = render_page(
        [overview, drive_section(args, terrain_info=terrain_info), *others],
        title="OffroadBekker: does knowing the soil pay?",
        intro="Controllers that know more or less of the soil drive the same episodes. First what perfect "
        "knowledge is worth, then how much of it an estimate from the vehicle's sensors recovers.",
        footer=f"OffroadBekker {__version__}, {args.episodes} episodes of each agent, seed {args.seed}",
        verdict=page_verdict(results),
    )
    content = {
        "version": __version__,
        "arguments": args,
        "results": {f"{task}.{form}": result.to_dict() for (task, form), result in results.items()},
        "policies": {f"{task}.{form}": arms for (task, form), arms in (trained or {}).items()},
    }
    path = write_bytes(out / "benchmark.html", page.encode())
    numbers = write_json(numbers or out / "benchmark.json", content)
    show_results(results)
    for (task, form), arms in (trained or {}).items():
        unit = results[task, form].unit
        _print_learned(f"{task}, {FORM_TITLES[form]}, trained policies", arms, unit)
        say(f"{learned_verdict(arms, unit)}\n")
    say(f"page: {path}\nnumbers: {numbers}")


def _print_learned(title: str, arms: list[LearnedArm], unit: str) -> None:
    rows: list[Any] = [
        (arm.arm, f"{len(arm.seeds)}", f"{arm.score:.3g}", f"{100.0 * arm.failed:.0f} %") for arm in arms
    ]
    console().print(table(title, ("policy", "seeds", f"score [{unit}]", "failures"), rows))


def show_results(results: Mapping[tuple[str, str], Benchmark]) -> None:
    """Scores, failures and the verdict of every task and form on the screen."""
    from agents.benchmark.page import verdict
    from agents.benchmark.runner import FORM_TITLES

    for result in results.values():
        rows = [
            (s.name, f"{s.score:.3g}", f"{100.0 * (1.0 - s.success.value):.0f} %") for s in result.summaries
        ]
        title = f"{result.scenario}, {FORM_TITLES[result.form]}, {result.episodes} episodes"
        console().print(table(title, ("agent", f"score [{result.unit}]", "failures"), rows))
        say(f"{verdict(result)}\n")
