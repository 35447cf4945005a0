"""Everything once: each part of the project runs, draws what it did, and says it in one sentence.

`run_demo` yields the sections of the page in order. Sentences are written from the results, so that
they say what happened and not what was hoped for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.arms import make_arm
from agents.benchmark.runner import ENV_ID, Benchmark, run_arms
from agents.benchmark.statistics import Interval
from agents.commands.wheel_data import score_rows
from agents.figures.arms import arms_figure
from agents.figures.estimate import EstimateLine, EstimatePanel, estimate_figure
from agents.figures.forward import exponent_figure, forces_figure, motion_figure
from agents.figures.soil import soil_figure
from agents.figures.wheel_rig import wheel_rig_figure
from agents.report import Picture, Section, Table, figure_picture, frame_picture
from agents.soil_curves import soil_curves
from agents.train import MissingExtraError, TrainArgs, train
from estimators.paper import ROWS, RowRun, exponent_sweep, forward_comparison, row_truth, run_row
from estimators.wheel_rig import CMU_WHEEL, RigComparison, compare, load_cmu_single_wheel
from offroad_env.datasets import DATASETS, fetch, locate
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics import state as at
from offroad_env.soils import SOILS
from offroad_env.vehicles import VEHICLES, make_wheel

__all__ = ["SECTIONS", "DemoSettings", "run_demo"]

#: What the paper reports for its forward comparison (Buzhardt & Tallapragada, ACC 2021, section II-C).
PAPER_DIFFERENCE = 15.0

Tick = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How much of everything runs."""

    out: Path  #: folder for the trained policy
    seed: int = 0  #: of noise, episodes and learning
    duration: float = 50.0  #: forward comparison [s]
    row: int = 4  #: row of the paper's table of results, 1 ... 8
    row_duration: float = 100.0  #: [s]
    scenario: str = "speed"  #: of the arms, the episode and learning
    episodes: int = 30  #: paired episodes an arm
    n_jobs: int = 2  #: local processes of the arms
    learning_time: float = 30.0  #: wall time of learning [s]
    test_episodes: int = 3  #: episodes that the trained policy drives

    def quick(self) -> DemoSettings:
        """The same in a fraction of the time, to see that it works."""
        return replace(
            self, duration=20.0, row_duration=30.0, episodes=6, learning_time=2.0, test_episodes=1
        )


@dataclass(frozen=True, kw_only=True)
class _Episode:
    """One episode of the arm that lives on its estimate."""

    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,) true exponent under the front axle [-]
    mean: np.ndarray  #: (T,) estimate [-]
    sd: np.ndarray  #: (T,) its standard deviation [-]
    speed: np.ndarray  #: (T,) [m/s]
    last: dict[str, Any]  #: info of the last step
    frame: np.ndarray | None  #: picture half way, None without the extra view


@dataclass
class _Run:
    """Settings and what several sections share."""

    settings: DemoSettings
    tick: Tick = field(default=lambda share: None)

    @cached_property
    def episode(self) -> _Episode:
        return _drive(self.settings, self.tick)


# ---------------------------------------------------------------------- the parts


def _soil(run: _Run) -> Section:
    name, vehicle = "dry_sand", VEHICLES["mrzr"]
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    curves = soil_curves(SOILS[name], wheel, loads=(1000.0, 2000.0, 3500.0))
    sinkage, pull = 1e3 * curves.over_slip["sinkage"][-1], curves.over_slip["drawbar"][-1] / 1e3
    rolling = int(np.argmin(np.abs(curves.slip_axis)))
    best = int(np.nanargmax(pull))
    sees = (
        f"A wheel of {vehicle.r:g} m radius under {curves.loads[-1] / 1e3:g} kN sinks {sinkage[rolling]:.0f} mm "
        f"into dry sand when it rolls without slip, {sinkage[-1]:.0f} mm when it spins on the spot, and pulls "
        f"most, {pull[best]:.2f} kN, at slip {curves.slip_axis[best]:.2f}."
    )
    figure = soil_figure(curves, title=f"{SOILS.entry(name).title}, n = {SOILS[name].n:g}")
    return Section(
        name="soil",
        title="One wheel on soil",
        sees=sees,
        command=f"offroad soil {name}",
        pictures=(figure_picture(figure, "Sinkage, drawbar pull and side force, over slip and over load."),),
        data={"source": SOILS.entry(name).source, "curves": curves},
    )


def _forward(run: _Run) -> Section:
    duration = run.settings.duration
    result = forward_comparison(duration=duration)
    half_car, bicycle = result.half_car, result.bicycle
    load = half_car.readings[:, at.N] / 1e3
    speed = half_car.states[:, at.V_X]
    largest, end = result.largest_distance, float(result.distance[-1])
    sees = (
        f"Under the same force and steering the front axle load of the half-car swings between {load.min():.1f} "
        f"and {load.max():.1f} kN around the bicycle's constant {bicycle.readings[0, at.N] / 1e3:.1f} kN, and "
        f"within {duration:g} s the two vehicles come up to {largest:.2f} m apart; the paper reports up to "
        f"{PAPER_DIFFERENCE:g} m."
    )
    rows = (
        (f"largest distance in {duration:g} s", f"{largest:.3f} m", f"up to {PAPER_DIFFERENCE:g} m (50 s)"),
        ("distance at the end", f"{end:.3f} m", "-"),
        ("speed of the half-car", f"{speed.min():.1f} ... {speed.max():.1f} m/s", "not given"),
        ("front axle load of the half-car", f"{load.min():.2f} ... {load.max():.2f} kN", "not given"),
    )
    return Section(
        name="forward",
        title="Half-car against bicycle",
        sees=sees,
        command="offroad demo --only forward",
        pictures=(
            figure_picture(forces_figure(result), "Wheel forces of both models on clay, per axle."),
            figure_picture(motion_figure(result), "Ground, heave and pitch; paths and the distance between."),
        ),
        tables=(Table(heading=("", "here", "paper"), rows=rows),),
        notes=(
            "The paper gives neither the vehicle's numbers nor its speed or slip; what was chosen instead, with "
            "reasons, stands in estimators/paper.py, and the difference depends on it.",
        ),
        key=(
            (
                f"Largest half-car/bicycle difference in {duration:g} s",
                f"{largest:.2f} m (paper: up to {PAPER_DIFFERENCE:g} m)",
            ),
        ),
        data={"largest_distance": largest, "end_distance": end, "speed": [speed.min(), speed.max()]},
    )


def _exponent(run: _Run) -> Section:
    sweeps = {mode: exponent_sweep(mode=mode, duration=run.settings.duration) for mode in ("speed", "force")}
    speed, force = sweeps["speed"], sweeps["force"]
    spread = {mode: sweep.spread for mode, sweep in sweeps.items()}
    span = f"n = {speed.n[0]:g} ... {speed.n[-1]:g}"
    sees = (
        f"Vehicles that differ in the soil's exponent alone, {span}, end up to {spread['speed']:.1f} m apart "
        f"after {run.settings.duration:g} s at the same speed, and {spread['force']:.1f} m under the same force."
    )
    ends = {mode: sweep.paths[:, -1] for mode, sweep in sweeps.items()}
    rows = tuple(
        (f"{n:g}", *(f"{value:.1f}" for mode in ends for value in ends[mode][i])) for i, n in enumerate(speed.n)
    )
    heading = ("n [-]", "X, same speed [m]", "Y, same speed [m]", "X, same force [m]", "Y, same force [m]")
    return Section(
        name="exponent",
        title="What the exponent n does to a path",
        sees=sees,
        command="offroad demo --only exponent",
        pictures=(figure_picture(exponent_figure(speed, force), "Half-car on clay; dots are the end points."),),
        tables=(Table(heading=heading, rows=rows),),
        key=(
            (f"Spread of end points, {span}, same speed", f"{spread['speed']:.1f} m"),
            (f"Spread of end points, {span}, same force", f"{spread['force']:.1f} m"),
        ),
        data={"n": speed.n, "spread": spread, "ends": ends},
    )


def _drive(settings: DemoSettings, tick: Tick) -> _Episode:
    arm = make_arm("aware", scenario=settings.scenario)
    env = gym.make(ENV_ID, scenario=settings.scenario, terrain_info=arm.terrain_info, render_mode="rgb_array")
    observation, info = env.reset(seed=settings.seed)
    arm.agent.reset(env.unwrapped.briefing)
    infos, frame, done = [info], None, False
    while not done:
        observation, _, terminated, truncated, info = env.step(arm.agent.act(observation))
        infos.append(info)
        done = terminated or truncated
        if frame is None and (done or info["progress"] > 0.5 * info["path_length"]):
            frame = _frame(env)
        if len(infos) % 100 == 0:
            tick(max(info["progress"], 0.0) / info["path_length"])
    env.close()
    series = {name: np.array([info[name] for info in infos]) for name in ("time", "n_front", "speed")}
    return _Episode(
        t=series["time"],
        n=series["n_front"],
        mean=np.array([info["n_estimate"] for info in infos]),
        sd=np.array([info["n_estimate_sd"] for info in infos]),
        speed=series["speed"],
        last=infos[-1],
        frame=frame,
    )


def _frame(env: gym.Env) -> np.ndarray | None:
    """A picture of the environment, or None where drawing is not installed."""
    try:
        return env.render()
    except (ImportError, gym.error.DependencyNotInstalled):
        return None


def _ending(info: dict[str, Any]) -> str:
    if info["success"]:
        return f"reaches the goal of the {info['path_length']:.0f} m course in {info['time']:.1f} s"
    reason = (info["failure"] or "time_limit").replace("_", " ")
    return f"ends ({reason}) {info['progress']:.0f} m into the {info['path_length']:.0f} m course"


def _episode(run: _Run) -> Section:
    episode, settings = run.episode, run.settings
    info = episode.last
    sees = (
        f"The vehicle, told nothing about the soil, {_ending(info)} at {episode.speed.mean():.1f} m/s on average, "
        f"up to {episode.speed.max():.1f} m/s; the true exponent is {info['n']:.2f}."
    )
    caption = "From above with path and corridor; from the side with sinkage; the exponent over time."
    pictures = () if episode.frame is None else (frame_picture(episode.frame, caption),)
    notes = () if pictures else ("The picture needs pygame-ce: pip install offroad-bekker[view].",)
    return Section(
        name="drive",
        title=f"One episode of the scenario {settings.scenario!r}",
        sees=sees,
        command=f"offroad drive --scenario {settings.scenario} --agent aware --seed {settings.seed}",
        pictures=pictures,
        notes=notes,
        data={"n": info["n"], "time": info["time"], "success": info["success"], "failure": info["failure"]},
    )


def _estimate(run: _Run) -> Section:
    settings = run.settings
    row = ROWS[settings.row - 1]
    truth = row_truth(row, duration=settings.row_duration)
    results = [run_row(row, model, seed=settings.seed, truth=truth) for model in ("half_car", "bicycle")]
    run.tick(0.5)
    episode = run.episode
    first, mean, sd = results[0], float(episode.mean[-1]), float(episode.sd[-1])
    sees = (
        f"On row {row.number} of the paper's table the half-car filter moves from its guess "
        f"{first.filter.n[0]:.2f} to {first.filter.n[-1]:.2f} (true {truth.n:g}); on board, in the episode above, "
        f"the estimate moves from {episode.mean[0]:.2f} ± {episode.sd[0]:.2f} to {mean:.2f} ± {sd:.2f} "
        f"(true {episode.last['n']:.2f})."
    )
    panels = (
        EstimatePanel(
            title=f"Paper, row {row.number}: {row.soil}, H0 = {row.H0:g} m, steering "
            f"{row.steer_amplitude:g} sin({row.steer_frequency:g} t)",
            t=first.t,
            truth=np.full(first.t.shape, truth.n),
            lines=tuple(_line(result) for result in results),
        ),
        EstimatePanel(
            title=f"On board: scenario {settings.scenario!r}, seed {settings.seed}",
            t=episode.t,
            truth=episode.n,
            lines=(EstimateLine(label="embedded filter", n=episode.mean, sd=episode.sd),),
        ),
    )
    return Section(
        name="estimate",
        title="Estimating n while driving",
        sees=sees,
        command="offroad demo --only estimate",
        pictures=(figure_picture(estimate_figure(panels), "Mean and band of two standard deviations."),),
        tables=(_mse_table(results, settings.row_duration),),
        notes=(
            f"The paper's errors are over 100 s; those here are over {settings.row_duration:g} s, one noise seed. "
            f"In the episode the filter repaired its covariance {episode.last['filter_repairs']} times.",
        ),
        key=(("Estimate of n on board at the end of the episode", f"{mean:.2f} ± {sd:.2f}"),)
        + (("True n of that episode", f"{episode.last['n']:.2f}"),),
        data={
            "row": row.number,
            "mse": {result.model: result.mse for result in results},
            "paper_mse": {result.model: result.paper_mse for result in results},
            "on_board": {"n": episode.last["n"], "mean": mean, "sd": sd},
        },
    )


def _line(result: RowRun) -> EstimateLine:
    label = f"{result.model.replace('_', '-')} filter"
    return EstimateLine(label=label, n=result.filter.n, sd=result.filter.sd)


def _mse_table(results: Sequence[RowRun], duration: float) -> Table:
    rows = tuple(
        (r.model.replace("_", "-"), f"{r.filter.n[-1]:.3f} ± {r.filter.sd[-1]:.3f}", f"{r.mse:.2e}", f"{r.paper_mse:.2e}")
        for r in results
    )
    heading = ("filter model", f"n after {duration:g} s", "mean square error", "paper's")
    return Table(heading=heading, rows=rows)


def _arms(run: _Run) -> Section:
    settings = run.settings
    result = run_arms(
        settings.scenario,
        settings.episodes,
        seed=settings.seed,
        n_jobs=settings.n_jobs,
        progress=lambda done, total: run.tick(done / total),
    )
    rows = tuple(
        (
            summary.name,
            f"{summary.score:.1f}",
            "-" if summary.paired_time is None else f"{summary.paired_time:.1f}",
            f"{len(arm.episodes) - int(arm.success.sum())} of {len(arm.episodes)}",
            ", ".join(f"{cause} {count}" for cause, count in summary.failures.items()) or "-",
        )
        for summary, arm in zip(result.summaries, result.arms, strict=True)
    )
    heading = (
        "arm",
        "score [s]",
        f"time of the {result.finished_by_all} episodes that all finished [s]",
        "failures",
        "causes",
    )
    difference = result.oracle_minus_uninformed
    key = ()
    if difference is not None:
        key = ((f"Oracle minus {result.better_uninformed}, the better uninformed arm", f"{difference:.1f} s"),)
    return Section(
        name="arms",
        title="What knowing the soil is worth",
        sees=_arms_sentence(result),
        command="offroad demo --only arms",
        pictures=(figure_picture(arms_figure(result), "Every episode, and means with 95 % intervals."),),
        tables=(Table(heading=heading, rows=rows),),
        notes=(
            "Score: mean time to the goal, where a failed episode costs the whole time limit. Brackets: 95 % "
            "intervals by bootstrap over episodes. All arms are one controller and drive the same episodes; they "
            "differ in what they believe about n: nominal the one value that does best over all soils, "
            "conservative the worst case, aware the embedded estimate, oracle the truth.",
        ),
        key=key,
        data=result.to_dict(),
    )


def _arms_sentence(result: Benchmark) -> str:
    episodes, difference = len(result.arms[0].episodes), result.oracle_minus_uninformed
    if difference is None:
        return f"The arms drive the same {episodes} episodes."
    against = f"{result.better_uninformed}, the better of the two arms that know nothing"
    gap = Interval(abs(difference.value), *sorted((abs(difference.low), abs(difference.high))), difference.level)
    if difference.high < 0.0:
        verdict = f"the arm that knows the true n scores {gap:.1f} s better than {against}"
    elif difference.low > 0.0:
        verdict = f"the arm that knows the true n scores {gap:.1f} s worse than {against}"
    else:
        verdict = f"no difference shows between the arm that knows the true n and {against} ({difference:.1f} s)"
    recovered = ""
    if result.recovered is not None and math.isfinite(result.recovered):
        recovered = f"; the arm with the estimate recovers {100.0 * result.recovered:.0f} % of it"
    return f"Over {episodes} paired episodes {verdict}{recovered}."


def _learning(run: _Run) -> Section:
    settings, command = run.settings, "offroad train --time-budget 60"
    args = TrainArgs(
        scenario=settings.scenario,
        seed=settings.seed,
        time_budget=settings.learning_time,
        out=settings.out / "policy",
        eval_episodes=settings.test_episodes,
    )
    try:
        result = train(args, progress=lambda _, seconds: run.tick(seconds / settings.learning_time))
    except MissingExtraError as error:
        return Section(name="learning", title="Learning to drive", sees=f"Left out: {error}.", command=command)
    arrived = sum(episode.success for episode in result.evaluation)
    rewards = [point.reward for point in result.curve if point.reward is not None]
    sees = (
        f"PPO ran for {result.wall_time:.0f} s ({result.steps} environment steps, "
        f"{result.steps_per_second:.0f} a second) and its policy, saved and loaded again, reaches the goal in "
        f"{arrived} of {len(result.evaluation)} test episodes; so short a run shows that environment and trainer "
        "fit together, not what learning can do."
    )
    rows = (
        ("environment steps", f"{result.steps}"),
        ("mean reward of an episode, first and last", f"{rewards[0]:.1f}, {rewards[-1]:.1f}" if rewards else "-"),
        ("progress in test episodes [m]", ", ".join(f"{e.progress:.0f}" for e in result.evaluation)),
    )
    return Section(
        name="learning",
        title="Learning to drive",
        sees=sees,
        command=command,
        tables=(Table(heading=("", ""), rows=rows),),
        notes=(f"Here the time was limited to {settings.learning_time:g} s; the command takes what you give it.",),
        data={"result": result},
    )


def _wheel_data(run: _Run) -> Section:
    name, title, command = "cmu_single_wheel", "Measured against predicted", "offroad wheel-data"
    try:
        path = _find_data(name)
    except DataError as error:
        sees = f"The measured data can be had neither on this machine nor by download ({error}); all else ran."
        return Section(name="wheel-data", title=title, sees=sees, command=f"offroad data get {name}")
    result = compare(load_cmu_single_wheel(path), SOILS["cmu_sand"], CMU_WHEEL, seed=run.settings.seed)
    heading, rows = score_rows(result)
    caption = "Top: points measured, lines predicted. Bottom: measured less predicted."
    return Section(
        name="wheel-data",
        title=title,
        sees=_wheel_sentence(result),
        command=command,
        pictures=(figure_picture(wheel_rig_figure(result), caption),),
        tables=(Table(heading=heading, rows=tuple(rows), texts=2),),
        notes=(
            *(f"Left out: {count} trials, {reason}." for reason, count in result.outside.items()),
            f"Data: {DATASETS[name].citation}; licence {DATASETS[name].licence}.",
        ),
        key=tuple((f"Wheel in sand, measured less predicted, RMSE of {row[0]}", f"{row[2]} {row[1]}") for row in rows),
        data={"comparison": result.to_json()},
    )


def _find_data(name: str) -> Path:
    """The data set on this machine, else from its publisher."""
    try:
        return locate(name)
    except DataError:
        return fetch(name)


def _wheel_sentence(result: RigComparison) -> str:
    sinkage = {kind: [1e3 * value for value in ends] for kind, ends in result.span("sinkage").items()}
    pull = result.span("drawbar")
    return (
        "Straight ahead, over all slips, the wheel in the soil bin sinks {:.0f} to {:.0f} mm where the model with "
        "the plate-measured sand says {:.0f} to {:.0f} mm, and pulls {:+.0f} to {:+.0f} N where it says {:+.0f} to "
        "{:+.0f} N: the gap is far wider than the scatter of repeats."
    ).format(*sinkage["measured"], *sinkage["predicted"], *pull["measured"], *pull["predicted"])


#: Name -> (what the progress bar shows, share of the run time, maker).
SECTIONS: dict[str, tuple[str, float, Callable[[_Run], Section]]] = {
    "soil": ("one wheel on soil", 4.0, _soil),
    "forward": ("half-car against bicycle", 12.0, _forward),
    "exponent": ("paths over n", 2.0, _exponent),
    "drive": ("one episode", 12.0, _episode),
    "estimate": ("estimating n", 8.0, _estimate),
    "arms": ("comparing arms", 40.0, _arms),
    "learning": ("learning to drive", 40.0, _learning),
    "wheel-data": ("measured wheel data", 4.0, _wheel_data),
}


def run_demo(
    settings: DemoSettings,
    *,
    only: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Section]:
    """Run the parts of the demo, in order.

    Parameters
    ----------
    settings
    only
        Names in `SECTIONS`; default all.
    progress
        Called with (what runs, share of the whole that is done).

    Raises
    ------
    InvalidParameter
        For a name that is no section.
    """
    unknown = [name for name in only if name not in SECTIONS]
    if unknown:
        raise InvalidParameter(f"only must name sections among {', '.join(SECTIONS)}, got {', '.join(unknown)}")
    names = [name for name in SECTIONS if not only or name in only]
    total, done = sum(SECTIONS[name][1] for name in names), 0.0
    run = _Run(settings)
    for name in names:
        label, weight, make = SECTIONS[name]

        def tick(share: float, label: str = label, weight: float = weight, done: float = done) -> None:
            if progress is not None:
                progress(label, (done + weight * min(max(share, 0.0), 1.0)) / total)

        run.tick = tick
        tick(0.0)
        start = time.perf_counter()
        section = make(run)
        done += weight
        yield replace(section, seconds=time.perf_counter() - start)
