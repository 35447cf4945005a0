"""Speed as ratios in one run: `make speed`, or `python benchmarks/speed.py --json speed.json`.

Every figure stands beside a peer measured in the same minutes: MuJoCo's HalfCheetah step for the
physics, one vehicle for a fleet, Pendulum-v1 for the environment. Actions are drawn beforehand; the
two sides take turns, so that a busy machine slows both; CPU time is measured, and the median of the
ratios is printed with its range.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np

import offroad_env
from offroad_env.fleet import simulate_fleet_commands, vary
from offroad_env.physics import state as at
from offroad_env.physics.full_model import full_advance
from offroad_env.physics.paper_model import simulate_paper
from offroad_env.simulator import FULL_STEP, PAPER_SLIP, Plant
from offroad_env.terrain import paper_terrain, rough_terrain

#: What the project promises: (name, ratio, smallest or largest).
BARS = {
    "RK4 step, half-car, clay / mj_step": ("at most", 1.3),
    "RK4 step, half-car, dry_sand / mj_step": ("at most", 1.3),
    "fleet of 64 / a vehicle stepped from Python": ("at most", 0.5),
    "fleet of 64, two threads / one (wall)": ("at most", 1.0 / 1.8),
    "env.step / Pendulum-v1": ("at least", 0.15),
    "env.step with UKF / Pendulum-v1": ("at least", 0.05),
}


def paper_drive(soil: str, push: tuple[float, float]) -> Callable[[int], float]:
    """Seconds per RK4 step of the paper's vehicle on its rough ground (H0 = 0.05 m).

    ``push`` = mean and amplitude of F_u/m [m/s^2], as in its sections II-C and IV.
    """
    vehicle = offroad_env.VEHICLES["paper"]
    plant = offroad_env.make_plant(
        vehicle, offroad_env.SOILS[soil], paper_terrain(0.05), model="paper", slip=PAPER_SLIP[soil]
    )
    state, warm = offroad_env.settled_state(plant, v_x=5.0)

    def run(steps: int) -> float:
        t = 0.005 * np.arange(2 * steps + 1)
        force = vehicle.m * (push[0] + push[1] * np.sin(0.8 * t))
        inputs = np.stack([0.3 * np.sin(0.1 * t), force, np.full(t.shape, np.nan)], axis=1)
        states, readings = np.empty((steps + 1, at.STATE_SIZE)), np.empty((steps + 1, at.READINGS_SIZE))
        x, w = state.copy(), warm.copy()
        start = time.process_time()
        _, done = simulate_paper(x, w, inputs, plant, 0.01, states, readings)
        seconds = time.process_time() - start
        if done < steps:
            raise RuntimeError(f"the drive on {soil} ended after {done} of {steps} steps")
        return seconds / steps

    return run


def half_cheetah() -> Callable[[int], float]:
    """Seconds per mj_step of Gymnasium's HalfCheetah model under random controls."""
    import mujoco

    path = Path(gym.__file__).parent / "envs/mujoco/assets/half_cheetah.xml"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)

    def run(steps: int) -> float:
        mujoco.mj_resetData(model, data)
        controls = np.random.default_rng(0).uniform(-1.0, 1.0, (steps // 10, model.nu))
        start = time.process_time()
        for control in controls:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=10)
        return (time.process_time() - start) / steps

    return run


#: Interval that commands are held for [s], as in the environment, and intervals of a drive.
_INTERVAL, _DRIVE = 0.02, 50


def full_plant() -> tuple[Plant, np.ndarray, np.ndarray]:
    """The full model on clay and an average unpaved road, with its settled state and warm start."""
    ground = rough_terrain("C", np.random.default_rng(0))
    plant = offroad_env.make_plant(offroad_env.VEHICLES["mrzr"], offroad_env.SOILS["clay"], ground)
    return plant, *offroad_env.settled_state(plant, v_x=5.0)


def stepped_vehicle() -> Callable[[int], float]:
    """Seconds per 0.02 s of the full model, one vehicle, one call from Python for each interval."""
    plant, state, warm = full_plant()
    readings, command = np.empty(at.READINGS_SIZE), (0.02, 400.0, 0.0)

    def run(intervals: int) -> float:
        start = time.process_time()
        for i in range(intervals):
            if i % _DRIVE == 0:
                x, w = state.copy(), warm.copy()
            full_advance(x, w, command, plant, FULL_STEP, round(_INTERVAL / FULL_STEP), readings)
        return (time.process_time() - start) / intervals

    return run


def fleet_drive(count: int, threads: int = 1, *, wall: bool = False) -> Callable[[int], float]:
    """Seconds per vehicle and 0.02 s of a fleet, each vehicle on a soil of its own.

    ``count = 1`` is the compiled loop over one vehicle. ``wall``: by the clock on the wall, which
    only an idle machine gives a meaning.
    """
    plant, state, warm = full_plant()
    fleet = vary(plant, {"n": plant.soil.n * np.linspace(0.95, 1.05, count) if count > 1 else [plant.soil.n]})
    clock = time.perf_counter if wall else time.process_time

    held = np.tile([0.02, 400.0, 0.0], (_DRIVE, 1))

    def run(intervals: int) -> float:
        repeats = max(intervals // (count * _DRIVE), 1)
        start = clock()
        for _ in range(repeats):
            found = simulate_fleet_commands(fleet, state, warm, held, every=False, threads=threads)
            if (found.done < _DRIVE).any():
                raise RuntimeError("a vehicle of the fleet did not come to the end")
        return (clock() - start) / (repeats * _DRIVE * count)

    return run


def environment(name: str, actions: np.ndarray, **options: object) -> Callable[[int], float]:
    """Seconds per step of an environment as ``gym.make`` returns it; resets are not counted."""
    env = gym.make(name, **options)
    env.reset(seed=0)

    def run(steps: int) -> float:
        env.reset(seed=0)
        spent = 0.0
        start = time.process_time()
        for i in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[i % len(actions)])
            if terminated or truncated:
                pause = time.process_time()
                env.reset()
                spent += time.process_time() - pause
        return (time.process_time() - start - spent) / steps

    return run


def take_turns(ours: Callable[[int], float], peer: Callable[[int], float], steps: int, rounds: int) -> dict:
    """Median and range of ours/peer over rounds in which both run once."""
    ours(min(steps, 50)), peer(min(steps, 50))
    pairs = [(ours(steps), peer(steps)) for _ in range(rounds)]
    ratios = [a / b for a, b in pairs]
    return {
        "ours_us": 1e6 * statistics.median(a for a, _ in pairs),
        "peer_us": 1e6 * statistics.median(b for _, b in pairs),
        "time_ratio": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
    }


def measure(rounds: int) -> dict[str, dict]:
    """All comparisons."""
    rng = np.random.default_rng(0)
    drive = np.clip(rng.normal([0.0, 0.4], [0.1, 0.2], (4000, 2)), -1.0, 1.0).astype(np.float32)
    swing = rng.uniform(-2.0, 2.0, (4000, 1)).astype(np.float32)
    results: dict[str, dict] = {}
    try:
        cheetah = half_cheetah()
    except ImportError:
        cheetah = None
    if cheetah:
        for soil, push in (("clay", (0.8, 0.5)), ("dry_sand", (1.8, 0.6))):
            name = f"RK4 step, half-car, {soil} / mj_step"
            results[name] = take_turns(paper_drive(soil, push), cheetah, 3000, rounds)
    vehicle, fleet = stepped_vehicle(), fleet_drive(64)
    results["fleet of 64 / a vehicle stepped from Python"] = take_turns(fleet, vehicle, 3200, rounds)
    results["fleet of 64 / a vehicle in a compiled loop"] = take_turns(fleet, fleet_drive(1), 3200, rounds)
    walls = fleet_drive(64, 2, wall=True), fleet_drive(64, 1, wall=True)
    results["fleet of 64, two threads / one (wall)"] = take_turns(*walls, 6400, rounds)
    pendulum = environment("Pendulum-v1", swing)
    bekker = "offroad_env:OffroadBekker-v0"
    for name, options in (
        ("env.step / Pendulum-v1", {"terrain_info": "none"}),
        ("env.step with UKF / Pendulum-v1", {"terrain_info": "estimate"}),
    ):
        ours = environment(bekker, drive, scenario="speed", **options)
        results[name] = take_turns(ours, pendulum, 2000, rounds)
        # Of an environment one quotes the rate, not the time.
        row = results[name]
        rates = 1.0 / row["time_ratio"], 1.0 / row["highest"], 1.0 / row["lowest"]
        row["rate_ratio"], row["lowest"], row["highest"] = rates
    return results


def main() -> None:
    """Measure, print and, if asked, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="turns that each side takes")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    results = measure(arguments.rounds)
    for name, row in results.items():
        ratio = row.get("rate_ratio", row["time_ratio"])
        bar = "  bar: {} {:g}".format(*BARS[name]) if name in BARS else ""
        print(
            f"{name:45s} {ratio:6.3f} [{row['lowest']:.3f}, {row['highest']:.3f}]"
            f"  ({row['ours_us']:.1f} us against {row['peer_us']:.1f} us){bar}"
        )
    if arguments.json:
        partial = arguments.json.with_suffix(".partial")
        partial.write_text(json.dumps(results, indent=2) + "\n")
        partial.replace(arguments.json)


if __name__ == "__main__":
    main()
