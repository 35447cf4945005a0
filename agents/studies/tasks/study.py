"""What the soil changes in each task of the benchmark: curves over n, without any agent's tuning.

Corners, climbing and braking come from the forces of a wheel and from runs of the vehicle's model;
what roughness does comes from a drive at a steady speed; how late an estimate hears of another soil
comes from one drive over patches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.controllers.traction_limits import soil_capability
from agents.driving.unwrapped import bekker_env
from offroad_env.environment.scenarios import SCENARIOS, Scenario
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.descriptions import read_soil, read_vehicle
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat

__all__ = ["TaskCurves", "task_curves"]

_POINTS = 17
_TRACK_RADIUS, _CORNER_RADIUS, _SLIP_ANGLE = 12.0, 20.0, 0.3  # [m], [m], [rad]
_RIDE_SPEED, _RIDE_TIME = 5.0, 20.0  # [m/s], [s]


@dataclass(frozen=True, kw_only=True)
class TaskCurves:
    """Curves over the sinkage exponent."""

    n: np.ndarray  #: (N,) [-]
    slip_angle: np.ndarray  #: (2, N) front and rear, in a bend of 12 m radius at 4 m/s [rad]
    corner_speed: np.ndarray  #: (N,) in a bend of 20 m radius, at a slip angle of 0.3 rad [m/s]
    best_slip: np.ndarray  #: (N,) drive slip of the largest pull on the soil of `climb` [-]
    best_pull: np.ndarray  #: (N,) that pull over the weight [-]
    fixed_pull: dict[float, np.ndarray]  #: pull at a slip that does not know the soil: slip -> (N,) [-]
    stopping: np.ndarray  #: (N,) way to standstill from 10 m/s under full brakes, soil of `brake` [m]
    ride_n: np.ndarray  #: (R,) [-]
    shake: np.ndarray  #: (R,) r.m.s. of the vertical acceleration at 5 m/s on the ground of `ride` [m/s^2]
    patches: dict[str, np.ndarray]  #: a drive: "distance" [m], "n" under the front wheels, "mean", "sd"


def task_curves(seed: int = 0) -> TaskCurves:
    """Compute the curves; ``seed`` is that of the two drives."""
    corners, climb = SCENARIOS["speed"], SCENARIOS["climb"]
    n = np.linspace(*corners.n_range, _POINTS)
    table, loam = (
        soil_capability(read_vehicle(task.vehicle).record, read_soil(task.soil).record, task.n_range)
        for task in (corners, climb)
    )
    lateral = np.array([table.lateral_limit(x, x, _SLIP_ANGLE) for x in n])
    pull = np.array([np.interp(n, loam.grid, loam.pull[:, i]) for i in range(loam.slips.size)]) / GRAVITY
    best = pull.argmax(axis=0)
    ride_n = np.linspace(*SCENARIOS["ride"].n_range, 5)
    return TaskCurves(
        n=n,
        slip_angle=np.array([table.slip_angles(x, 16.0 / _TRACK_RADIUS) for x in n]).T,
        corner_speed=np.sqrt(_CORNER_RADIUS * lateral),
        best_slip=loam.slips[best],
        best_pull=pull.max(axis=0),
        fixed_pull={s: pull[int(np.argmin(np.abs(loam.slips - s)))] for s in (0.12, 0.4, 0.8)},
        stopping=np.array([_stopping_distance(SCENARIOS["brake"], x) for x in n]),
        ride_n=ride_n,
        shake=np.array([_shake(float(x), seed) for x in ride_n]),
        patches=_patches_drive(seed),
    )


def _stopping_distance(task: Scenario, n: float, speed: float = 10.0) -> float:
    """Way [m] from full brakes to standstill on level ground."""
    vehicle = read_vehicle(task.vehicle).record
    plant = make_plant(vehicle, make_soil(read_soil(task.soil).record, n=float(n)), flat())
    state, warm = settled_state(plant, v_x=speed)
    commands = np.tile([0.0, 0.0, vehicle.brake_torque_max], (300, 1))
    try:
        run = simulate_commands(plant, state, warm, commands)
    except SolverFailure:
        return math.nan
    return float(run.states[:, at.X].max() - run.states[0, at.X])


def _shake(n: float, seed: int) -> float:
    """R.m.s. of the vertical acceleration [m/s^2] at a steady speed; the limit of the task is lifted."""
    env = gym.make(ENV_ID, scenario="ride")
    inner = bekker_env(env)
    inner.scenario = replace(inner.scenario, shake_limit=math.inf)
    agent = PurePursuitAgent(speed=_RIDE_SPEED)
    observation, _ = env.reset(seed=seed, options={"n": n})
    agent.reset(bekker_env(env).briefing)
    squares = []
    for _ in range(round(_RIDE_TIME / bekker_env(env).briefing.dt)):
        observation, _, terminated, _, _ = env.step(agent.act(observation))
        squares.append(bekker_env(env).snapshot().readings[at.A_Z] ** 2)
        if terminated:
            break
    env.close()
    return math.sqrt(float(np.mean(squares[len(squares) // 4 :])))


def _patches_drive(seed: int) -> dict[str, np.ndarray]:
    """True n and the estimate along one drive over patches, by the simplest tracker."""
    env = gym.make(ENV_ID, scenario="patches", estimator="parameter")
    agent = PurePursuitAgent()
    observation, info = env.reset(seed=seed, options={"n": 0.9})
    agent.reset(bekker_env(env).briefing)
    rows, over = [], False
    while not over:
        observation, _, terminated, truncated, info = env.step(agent.act(observation))
        rows.append((info["progress"], info["n_front"], info["n_estimate"], info["n_estimate_sd"]))
        over = terminated or truncated
    env.close()
    return dict(zip(("distance", "n", "mean", "sd"), np.array(rows).T, strict=True))
