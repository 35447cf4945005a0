"""How fast everything is, as ratios in one run.

Every figure stands beside another one that was measured in the same minutes: MuJoCo's step of the
HalfCheetah for the physics, other environments for the environment, one environment for many. The
sides take turns, so that a busy machine slows all of them; CPU time is measured, only the threads of
the vector environment need the clock as well; actions are drawn beforehand, resets are not counted.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.studies.speed.drives import DRIVES, structured_drive
from agents.studies.speed.fresh import Fresh, measure_fresh
from agents.studies.speed.predictive import SolveTime, measure_solves
from agents.studies.speed.verdicts import VerdictTime, verdict_times
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.filters.joint_ukf import joint_step
from estimators.filters.online import Thinned
from estimators.filters.online_parameter_ukf import OnlineParameterUKF
from estimators.filters.online_soil_belief import POPULATION_RANGE, OnlineSoilBelief
from estimators.filters.protocol import Estimator, Pose
from estimators.models.half_car_on_map import CHANNELS, JointSettings, joint_model, only_imu, prior
from offroad_env.environment.vector_env import make_vec
from offroad_env.physics import state as at
from offroad_env.physics.paper_vehicle import simulate_paper
from offroad_env.simulation.simulator import PAPER_SLIP, make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES

__all__ = ["BARS", "SIZES", "Bar", "Ratio", "Speed", "compare", "measure_speed"]

#: Episodes of the vector environment.
SIZES = (1, 4, 16, 64)
_BEKKER = "offroad_env:OffroadBekker-v0"
_ACTIONS = 4000
#: Steps that every episode of the task lasts, however it is driven.
_FEWEST = 100
#: Sides that start anew every turn and whose first second costs more than the others: never shortened.
_WHOLE_TURNS = ("update of the parameter UKF", "sample for the soil belief", "env.step, soil belief")
#: Decisions of model-predictive control.
_DECISIONS = 300

#: Seconds of CPU time and of the clock per step, of so many steps.
Run = Callable[[int], tuple[float, float]]


@dataclass(frozen=True)
class Bar:
    """A ratio that the project promises, or merely shows."""

    ours: str  #: a side
    peer: str  #: the side that it is divided by
    rate: bool = True  #: ratio of rates, as one quotes environments; else of times per step
    bar: float | None = None  #: smallest rate or largest time
    clock: bool = False  #: by the clock: what several processors do


BARS = (
    Bar("RK4 step on clay", "mj_step of HalfCheetah", rate=False, bar=1.3),
    Bar("RK4 step on dry sand", "mj_step of HalfCheetah", rate=False),
    Bar("env.step", "Pendulum-v1", bar=0.25),
    Bar("env.step", "HalfCheetah-v5", bar=1.0),
    Bar("env.step", "racetrack-v0"),
    Bar("env.step, parameter UKF", "Pendulum-v1"),
    Bar("env.step, parameter UKF", "HalfCheetah-v5", bar=0.4),
    Bar("env.step, joint filter", "HalfCheetah-v5", bar=0.1),
    Bar("env.step, soil belief", "HalfCheetah-v5", bar=0.15),
    Bar("vector of 64", "env.step", bar=10.0, clock=True),
    Bar("vector of 64", "env.step"),
    Bar("vector of 64, parameter UKF", "env.step, parameter UKF", clock=True),
    Bar("update of the parameter UKF", "env.step", rate=False),
    Bar("update of the joint UKF", "env.step", rate=False),
    Bar("sample for the soil belief", "update of the parameter UKF", rate=False, bar=4.0),
    Bar("half-car, grid", "half-car, full", rate=False, bar=2.0),
    Bar("four wheels, full", "half-car, full", rate=False, bar=5.0),
    Bar("four wheels, grid", "half-car, full", rate=False, bar=5.0),
    Bar("half-car, grid, tyre", "half-car, grid", rate=False, bar=1.5),
    Bar("env.reset", "env.step", rate=False),
)


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Ours over the peer's, from rounds in which both ran."""

    ours: str
    peer: str
    kind: str  #: "rate" or "time"
    clock: bool  #: by the clock instead of CPU time
    value: float  #: median
    low: float
    high: float
    ours_us: float  #: median time per step [us]
    peer_us: float  #: [us]
    bar: float | None

    @property
    def met(self) -> bool | None:
        """Whether the promise is kept; None where there is none."""
        if self.bar is None:
            return None
        return self.value >= self.bar if self.kind == "rate" else self.value <= self.bar


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Everything that was measured."""

    ratios: tuple[Ratio, ...]
    sides_us: dict[str, float]  #: median CPU time per step [us]
    vector_us: dict[str, dict[int, tuple[float, float]]]  #: kind -> N -> CPU and clock time of a step [us]
    missing: tuple[str, ...]  #: peers that are not installed
    processors: int
    rounds: int
    diagnosis_s: float | None = None  #: CPU time of `diagnose` on a log of a minute [s]; None when left out
    verdicts: tuple[VerdictTime, ...] = ()  #: of `diagnose` in a natural world; empty when left out
    fresh: Fresh | None = field(default=None)
    solves: SolveTime | None = None  #: of model-predictive control; None without its solver


# ---------------------------------------------------------------------- sides


def _timed(work: Callable[[int], None]) -> Run:
    def run(steps: int) -> tuple[float, float]:
        cpu, clock = time.process_time(), time.perf_counter()
        work(steps)
        return (time.process_time() - cpu) / steps, (time.perf_counter() - clock) / steps

    return run


def _paper_drive(soil: str, push: tuple[float, float]) -> Run:
    """The paper's vehicle on its rough ground (H0 = 0.05 m); ``push`` = mean and amplitude of F_u/m."""
    vehicle = VEHICLES["paper"]
    plant = make_plant(vehicle, SOILS[soil], paper_terrain(0.05), model="paper", slip=PAPER_SLIP[soil])
    state, warm = settled_state(plant, v_x=5.0)

    def work(steps: int) -> None:
        t = 0.005 * np.arange(2 * steps + 1)
        force = vehicle.m * (push[0] + push[1] * np.sin(0.8 * t))
        inputs = np.stack([0.3 * np.sin(0.1 * t), force, np.full(t.shape, np.nan)], axis=1)
        states, readings = np.empty((steps + 1, at.STATE_SIZE)), np.empty((steps + 1, at.READINGS_SIZE))
        _, done = simulate_paper(state.copy(), warm.copy(), inputs, plant, 0.01, states, readings)
        if done < steps:
            raise RuntimeError(f"the drive on {soil} ended after {done} of {steps} steps")

    return _timed(work)


def _half_cheetah() -> Run:
    """MuJoCo's step of Gymnasium's HalfCheetah under random controls."""
    import mujoco

    path = Path(gym.__file__).parent / "envs/mujoco/assets/half_cheetah.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    controls = np.random.default_rng(0).uniform(-1.0, 1.0, (_ACTIONS, model.nu))

    def work(steps: int) -> None:
        mujoco.mj_resetData(model, data)
        for i in range(0, steps, 10):
            data.ctrl[:] = controls[i // 10]
            mujoco.mj_step(model, data, nstep=10)

    return _timed(work)


def _environment(name: str, actions: np.ndarray, **options: Any) -> Run:
    """Steps of an environment as ``gym.make`` returns it."""
    env = gym.make(name, **options)

    def run(steps: int) -> tuple[float, float]:
        env.reset(seed=0)
        resetting = np.zeros(2)
        start = np.array([time.process_time(), time.perf_counter()])
        for i in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[i % len(actions)])
            if terminated or truncated:
                pause = np.array([time.process_time(), time.perf_counter()])
                env.reset()
                resetting += (time.process_time(), time.perf_counter()) - pause
        spent = np.array([time.process_time(), time.perf_counter()]) - start - resetting
        return tuple((spent / steps).tolist())

    return run


def _resets(**options: Any) -> Run:
    """Resets of an environment as ``gym.make`` returns it."""
    env = gym.make(_BEKKER, **options)
    env.reset(seed=0)

    def work(steps: int) -> None:
        for _ in range(steps):
            env.reset()

    return _timed(work)


def _vector(count: int, actions: np.ndarray, **options: object) -> Run:
    """Steps of one episode of a vector environment; begun anew before any can have ended."""
    envs = make_vec(count, **options)
    choices = np.resize(actions, (len(actions) // 4, count, 2))

    def run(steps: int) -> tuple[float, float]:
        calls, spent = max(steps // count, 20), np.zeros(2)
        for first in range(0, calls, _FEWEST):
            envs.reset(seed=0)
            start = np.array([time.process_time(), time.perf_counter()])
            for k in range(first, min(first + _FEWEST, calls)):
                envs.step(choices[k % len(choices)])
            spent += (time.process_time(), time.perf_counter()) - start
        return tuple((spent / (calls * count)).tolist())

    return run


def _parameter_update() -> Run:
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat())
    return _updates(OnlineParameterUKF(plant, (0.3, 1.1)))


def _updates(estimator: Estimator) -> Run:
    """Samples for an online filter, a hundred a second."""
    rng = np.random.default_rng(0)
    imu = np.array([0.3, 0.1, 0.0, 0.0, 0.02]) + rng.normal(0.0, 0.1, (_ACTIONS, 5))
    nothing = np.full(4, np.nan)

    def work(steps: int) -> None:
        estimator.reset(0.7, 0.2, Pose(0.0, 0.0, 0.0, 5.0))
        for k in range(steps):
            estimator.update((0.02, 600.0, 0.0), imu[k % _ACTIONS], np.full(2, 5.0), nothing)

    return _timed(work)


def _soil_belief_update() -> Run:
    """The belief over whole soils, 50 updates a second from 100 samples a second."""
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat())
    return _updates(Thinned(OnlineSoilBelief(plant, POPULATION_RANGE), 2))


def _joint_update() -> Run:
    """The filter of state and n on the paper's vehicle (23 sigma points)."""
    vehicle, settings = VEHICLES["paper"], JointSettings()
    plant = make_plant(
        vehicle, SOILS["dry_sand"], paper_terrain(0.05), model="paper", slip=PAPER_SLIP["dry_sand"]
    )
    model = joint_model(plant, 0.01, settings)
    mean, cov, warm = prior(model, settings, 0.7, 0.1, (0.0, 0.0, 0.0), 5.0)
    inputs = np.tile([0.05, 1.8 * vehicle.m, np.nan], (3, 1))
    z = only_imu(np.array([[0.3, 0.1, 0.0, 0.0, 0.02]]))[0]
    warms = np.tile(warm, (2 * len(mean) + 1, 1, 1))

    def work(steps: int) -> None:
        belief, spread, starts = mean.copy(), cov.copy(), warms.copy()
        for _ in range(steps):
            joint_step(belief, spread, starts, inputs, z, model)

    assert z.shape == (len(CHANNELS),)
    return _timed(work)


def _actions() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    drive = np.clip(rng.normal([0.0, 0.4], [0.1, 0.2], (_ACTIONS, 2)), -1.0, 1.0)
    return {
        "drive": drive.astype(np.float32),
        "swing": rng.uniform(-2.0, 2.0, (_ACTIONS, 1)).astype(np.float32),
        "run": rng.uniform(-1.0, 1.0, (_ACTIONS, 6)).astype(np.float32),
        "race": rng.uniform(-0.1, 0.1, (_ACTIONS, 1)).astype(np.float32),
    }


def _peers(actions: Mapping[str, np.ndarray]) -> tuple[dict[str, tuple[Run, int]], tuple[str, ...]]:
    """Sides of others with their steps a turn, and which of them are not installed."""

    def racetrack() -> Run:
        import highway_env

        gym.register_envs(highway_env)
        return _environment("racetrack-v0", actions["race"])

    makers: dict[str, tuple[Callable[[], Run], int]] = {
        "Pendulum-v1": (lambda: _environment("Pendulum-v1", actions["swing"]), 3000),
        "HalfCheetah-v5": (lambda: _environment("HalfCheetah-v5", actions["run"]), 2000),
        "mj_step of HalfCheetah": (_half_cheetah, 3000),
        "racetrack-v0": (racetrack, 20),
    }
    sides, missing = {}, []
    for name, (make, steps) in makers.items():
        try:
            with _quiet():
                sides[name] = (make(), steps)
        except (ImportError, gym.error.DependencyNotInstalled):
            missing.append(name)
    return sides, tuple(missing)


class _quiet(warnings.catch_warnings):  # noqa: N801 - a context manager is used like a function
    """Other people's deprecations are no news here; MuJoCo would write them into a file."""

    def __enter__(self) -> None:
        super().__enter__()
        warnings.simplefilter("ignore")
        if "mujoco" in sys.modules or _installed("mujoco"):
            import mujoco

            mujoco.set_mju_user_warning(lambda _: None)


def _installed(name: str) -> bool:
    import importlib.util

    return importlib.util.find_spec(name) is not None


def _our_sides(actions: Mapping[str, np.ndarray]) -> dict[str, tuple[Run, int]]:
    drive, speed = actions["drive"], {"scenario": "speed"}
    filtered = {**speed, "terrain_info": "estimate"}
    sides = {
        "RK4 step on clay": (_paper_drive("clay", (0.8, 0.5)), 3000),
        "RK4 step on dry sand": (_paper_drive("dry_sand", (1.8, 0.6)), 3000),
        "env.step": (_environment(_BEKKER, drive, **speed), 2000),
        "env.step, parameter UKF": (_environment(_BEKKER, drive, **filtered), 1000),
        "env.step, joint filter": (_environment(_BEKKER, drive, **filtered, estimator="joint"), 200),
        "env.step, soil belief": (_environment(_BEKKER, drive, **speed, terrain_info="belief"), 300),
        "update of the parameter UKF": (_parameter_update(), 1000),
        "sample for the soil belief": (_soil_belief_update(), 1000),
        "update of the joint UKF": (_joint_update(), 300),
        "env.reset": (_resets(**speed), 200),
        **{name: (structured_drive(**options), 4000) for name, options in DRIVES.items()},
    }
    for count in SIZES:
        sides[f"vector of {count}"] = (_vector(count, drive, **speed), 4000)
        sides[f"vector of {count}, parameter UKF"] = (_vector(count, drive, **filtered), 2000)
    return sides


def _diagnosis() -> float:
    """CPU time [s] of `diagnose`: 60 s on flat ground with unknown n, whose steering acts 0.1 s late."""
    log = simulated_log(draw_case(34, road="flat", duration=60.0, gnss=False), FAULTS["steer_delay"](0.1))
    diagnose([log])  # compiled now
    start = time.process_time()
    diagnose([log])
    return time.process_time() - start


# ---------------------------------------------------------------------- the measurement


def _take_turns(
    sides: Mapping[str, tuple[Run, int]],
    rounds: int,
    share: float,
    progress: Callable[[int, int], None] | None,
) -> dict[str, np.ndarray]:
    """Times per step (rounds, 2) of every side [s]: CPU, clock."""
    for run, _ in sides.values():
        run(20)
    times = {name: np.empty((rounds, 2)) for name in sides}
    for k in range(rounds):
        for j, (name, (run, steps)) in enumerate(sides.items()):
            part = 1.0 if name in _WHOLE_TURNS else share
            times[name][k] = run(max(round(part * steps), 20))
            if progress is not None:
                progress(k * len(sides) + j + 1, rounds * len(sides))
    return times


def compare(times: Mapping[str, np.ndarray], bars: Iterable[Bar] = BARS) -> tuple[Ratio, ...]:
    """The ratios of ``bars`` both of whose sides are in ``times``: (rounds, 2), CPU and clock [s]."""
    found = []
    for bar in bars:
        if bar.ours not in times or bar.peer not in times:
            continue
        ours, peer = (times[name][:, 1 if bar.clock else 0] for name in (bar.ours, bar.peer))
        ratios = peer / ours if bar.rate else ours / peer
        found.append(
            Ratio(
                ours=bar.ours,
                peer=bar.peer,
                kind="rate" if bar.rate else "time",
                clock=bar.clock,
                value=float(np.median(ratios)),
                low=float(ratios.min()),
                high=float(ratios.max()),
                ours_us=1e6 * float(np.median(ours)),
                peer_us=1e6 * float(np.median(peer)),
                bar=bar.bar,
            )
        )
    return tuple(found)


def measure_speed(
    *, rounds: int = 7, quick: bool = False, progress: Callable[[int, int], None] | None = None
) -> Speed:
    """Measure everything.

    Parameters
    ----------
    rounds
        Turns that each side takes.
    quick
        Fewer steps a turn but for filters that settle first, and nothing is compiled anew.
    progress
        Called with (turns done, turns in all).
    """
    actions = _actions()
    peers, missing = _peers(actions)
    sides = {**peers, **_our_sides(actions)}
    times = _take_turns(sides, rounds, 0.1 if quick else 1.0, progress)
    kinds = {"": "env.step", ", parameter UKF": "env.step, parameter UKF"}
    return Speed(
        ratios=compare(times),
        sides_us={name: 1e6 * float(np.median(rows[:, 0])) for name, rows in times.items()},
        vector_us={
            kind: {
                count: tuple(1e6 * count * np.median(times[f"vector of {count}{suffix}"], axis=0))
                for count in SIZES
            }
            for suffix, kind in kinds.items()
        },
        missing=missing,
        processors=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        rounds=rounds,
        diagnosis_s=None if quick else _diagnosis(),
        verdicts=() if quick else verdict_times(),
        fresh=measure_fresh(rounds=1 if quick else 3, cold=not quick),
        solves=measure_solves(_DECISIONS // 10 if quick else _DECISIONS),
    )
