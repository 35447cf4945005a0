"""Controllers: arms that know more or less about the soil, and a policy that learns."""

from __future__ import annotations

import numpy as np

from agents.benchmark.figure import arms_figure
from agents.benchmark.runner import run_arms
from agents.benchmark.summary import Benchmark
from agents.demo.context import Run
from agents.learning.policies import MissingExtraError
from agents.learning.train import TrainArgs, TrainResult, train
from agents.reports.page import Section, Table, figure_picture
from offroad_env.environment.vector_env import make_vec

__all__ = ["arms_section", "arms_sentence", "learning_section"]


def arms_section(run: Run) -> Section:
    """All arms on the same episodes."""
    settings = run.settings
    result = run_arms(
        settings.scenario,
        settings.episodes,
        seed=settings.seed,
        n_jobs=settings.n_jobs,
        progress=lambda done, total: run.tick(done / total),
    )
    difference = result.oracle_minus_uninformed
    key: tuple[tuple[str, str], ...] = ()
    if difference is not None:
        what = f"Oracle minus {result.better_uninformed}, the better uninformed arm"
        key = ((what, f"{difference:+.3g} {result.unit}, {result.episodes} episodes"),)
    return Section(
        name="arms",
        title="What knowing the soil is worth",
        sees=arms_sentence(result),
        command="offroad demo --only arms",
        pictures=(figure_picture(arms_figure(result), "Every episode, and means with 95 % intervals."),),
        tables=(_arms_table(result),),
        notes=(
            f"Score: {result.measure}. Brackets: 95 % "
            "intervals by bootstrap over episodes. The arms are one controller on the same episodes and "
            "differ in what they hold n to be: nominal the one value that does best over all soils, "
            "conservative the worst case, aware the estimate on board, oracle the truth.",
        ),
        key=key,
        data=result.to_dict(),
    )


def _arms_table(result: Benchmark) -> Table:
    rows = tuple(
        (
            summary.name,
            f"{summary.score:.3g}",
            "-" if summary.paired_time is None else f"{summary.paired_time:.1f}",
            f"{len(arm.episodes) - int(arm.success.sum())} of {len(arm.episodes)}",
            ", ".join(f"{cause.replace('_', ' ')} {n}" for cause, n in summary.failures.items()) or "-",
        )
        for summary, arm in zip(result.summaries, result.arms, strict=True)
    )
    finished = f"time [s] over the {result.finished_by_all} episodes that all finished"
    return Table(heading=("arm", f"score [{result.unit}]", finished, "failures", "causes"), rows=rows)


def arms_sentence(result: Benchmark) -> str:
    """The benchmark's result on knowing n, judged by the interval and not by the mean."""
    episodes, difference = len(result.arms[0].episodes), result.oracle_minus_uninformed
    if difference is None:
        return f"The arms drive the same {episodes} episodes."
    low, high = sorted((abs(difference.low), abs(difference.high)))
    size, interval = f"{abs(difference.value):.2g} {result.unit}", f"[{low:.2g}, {high:.2g}]"
    without = f"{result.summary(result.better_uninformed).score.value:.0f} {result.unit}"
    if difference.high < 0.0:
        verdict = f"Knowing the soil saves {size} of {without} {interval}"
    elif difference.low > 0.0:
        verdict = f"Knowing the soil adds {size} to {without} {interval}"
    else:
        verdict = f"No difference shows between knowing the soil and not: {difference:+.2g} {result.unit}"
    who = f"the arm that knows the true n against {result.better_uninformed}, the better of two that do not"
    sentence = f"{verdict} (all but n known; {episodes} paired episodes; {who})"
    if result.recovered is not None:
        share = 100.0 * result.recovered.value
        sentence += f"; the arm with the estimate recovers {share:.0f} % of the difference"
    return f"{sentence}."


def learning_section(run: Run) -> Section:
    """A short run of PPO: that trainer, environment, saving and loading fit together."""
    settings, title = run.settings, "Learning to drive"
    command = (
        f"offroad train --scenario {settings.scenario} --seed {settings.seed} "
        f"--time-budget {settings.learning_time:g} --check-episodes 0"
    )
    args = TrainArgs(
        scenario=settings.scenario,
        seed=settings.seed,
        time_budget=settings.learning_time,
        out=settings.out / "policy",
        check_episodes=0,
        checkpoint_steps=0,
        eval_episodes=settings.test_episodes,
    )
    _compile_before(args)
    try:
        result = train(args, progress=lambda _, seconds: run.tick(seconds / settings.learning_time))
    except MissingExtraError as error:
        return Section(name="learning", title=title, sees=f"Left out: {error}.", command=command)
    arrived = sum(episode.success for episode in result.evaluation)
    sees = (
        f"PPO ran for {result.wall_time:.0f} s ({result.periods} environment steps, "
        f"{result.periods_per_second:.0f} a second) and its policy, saved and loaded again, reaches the goal "
        f"in {arrived} of {len(result.evaluation)} test episodes: so short a run shows that environment and "
        "trainer fit together, not what learning can do."
    )
    return Section(
        name="learning",
        title=title,
        sees=sees,
        command=command,
        tables=(_learning_table(result),),
        notes=("A longer run: the same command with another --time-budget [s], or with --total-steps.",),
        key=(("Short run of PPO", f"{result.periods} steps in {result.wall_time:.0f} s"),),
        data={"result": result},
    )


def _compile_before(args: TrainArgs) -> None:
    """Drive a period of what will learn: compiling it must not take from the time of learning."""
    envs = make_vec(args.n_envs, threads=args.threads, scenario=args.scenario, terrain_info=args.terrain_info)
    envs.reset(seed=args.seed)
    envs.step(np.zeros(envs.action_space.shape or ()))
    envs.close()


def _learning_table(result: TrainResult) -> Table:
    rewards = [point.reward for point in result.curve if point.reward is not None]
    course = ", ".join(f"{episode.progress:.0f}" for episode in result.evaluation)
    rows = (
        ("updates", f"{len(result.curve)}"),
        ("mean reward of an episode, first", f"{rewards[0]:.1f}" if rewards else "no episode ended"),
        ("mean reward of an episode, last", f"{rewards[-1]:.1f}" if rewards else "no episode ended"),
        ("way along the course in the test episodes [m]", course),
    )
    return Table(heading=("", ""), rows=rows)
