"""A plan made again for a model: the knobs of one controller, chosen by driving in that model."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from agents.benchmark.runner import ENV_ID, run_episode
from agents.controllers.arms import ArmSettings, believe_truth
from agents.controllers.protocol import Agent
from agents.controllers.pure_pursuit import PursuitGains
from agents.controllers.speed_control import SpeedGains
from agents.controllers.speed_planner import PlannerGains, SoilTracker
from agents.controllers.tuned import SETTINGS
from agents.reports.output import write_json
from offroad_env.effects import Extension

__all__ = ["KNOBS", "TASK", "careful", "driver", "make_world", "plan_for", "scores_in", "shipped_knobs"]

TASK = "speed"
#: Knobs with their ranges. The last three answer a vehicle that obeys late or pulls less than its model.
KNOBS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "margin": (0.3, 1.1),  # share of the lateral limit [-]
        "slip_angle": (0.15, 0.52),  # [rad]
        "feed_forward": (0.0, 1.0),  # share of the slip angles that steering anticipates [-]
        "brake_share": (0.2, 1.0),  # share of the braking [-]
        "lag": (0.05, 0.8),  # between a command and its effect [s]
        "time": (0.3, 1.2),  # of the point that the tracker aims at [s]
        "integral": (0.0, 1.5),  # of the speed control [1/s^2]
    }
)
_LOW, _HIGH = (np.array([limits[i] for limits in KNOBS.values()]) for i in (0, 1))


def driver(knobs: Mapping[str, float]) -> Agent:
    """The controller of the benchmark's oracle with these knobs; n is all that it knows of the truth."""
    gains = PlannerGains(
        margin=knobs["margin"],
        slip_angle=knobs["slip_angle"],
        feed_forward=knobs["feed_forward"],
        brake_share=knobs["brake_share"],
        lag=knobs["lag"],
        pursuit=PursuitGains(time=knobs["time"]),
        speed=SpeedGains(k_i=knobs["integral"]),
    )
    return SoilTracker(believe_truth, gains)


def shipped_knobs() -> dict[str, float]:
    """Those of the benchmark's oracle."""
    arm, usual = ArmSettings(**SETTINGS[TASK, "oracle"]), PlannerGains()
    fixed = {"brake_share": usual.brake_share, "lag": usual.lag, "time": usual.pursuit.time}
    return {name: float(fixed[name] if name in fixed else getattr(arm, name)) for name in KNOBS}


def make_world(extension: Extension | None) -> gym.Env:
    """The task with a vehicle by an extended model; None: by the nominal one."""
    options: dict[str, Any] = {"scenario": TASK, "terrain_info": "truth"}
    if extension is None:
        return gym.make(ENV_ID, **options)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "extended.json"
        write_json(path, extension.to_dict())
        return gym.make(ENV_ID, model=str(path), **options)


def scores_in(world: gym.Env, knobs: Mapping[str, float], seeds: Sequence[int], n: float) -> list[float]:
    """Time to the goal by episode, of a failure the time limit [s]."""
    agent = driver(knobs)
    return [run_episode(world, agent, seed, n=n).score for seed in seeds]


def plan_for(
    extension: Extension | None, n: float, episodes: Sequence[int], *, generations: int, seed: int
) -> dict[str, float]:
    """The knobs with which the controller drives these episodes fastest in a model.

    Differential evolution (R. Storn & K. Price, J. Global Optimization 11, 1997) over `KNOBS`, from the
    shipped knobs and a low-discrepancy sample; all models have the same budget.
    """
    world = make_world(extension)
    rng = np.random.default_rng(seed)
    start = qmc.Halton(len(KNOBS), rng=rng).random(10)
    start[0] = (np.array([*shipped_knobs().values()]) - _LOW) / (_HIGH - _LOW)

    def cost(place: np.ndarray) -> float:
        knobs = dict(zip(KNOBS, (_LOW + place * (_HIGH - _LOW)).tolist(), strict=True))
        return float(np.mean(scores_in(world, knobs, episodes, n)))

    found = differential_evolution(
        cost,
        [(0.0, 1.0)] * len(KNOBS),
        init=np.clip(start, 0.0, 1.0),
        maxiter=generations,
        polish=False,
        tol=0.0,
        rng=rng,
    )
    world.close()
    return dict(zip(KNOBS, (_LOW + found.x * (_HIGH - _LOW)).tolist(), strict=True))


def careful(knobs: Mapping[str, float], share: float) -> dict[str, float]:
    """The knobs with a ``share`` of the lateral limit: how one drives a vehicle for the first time."""
    return {**knobs, "margin": share * knobs["margin"]}
