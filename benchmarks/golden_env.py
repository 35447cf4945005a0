"""Episodes of ``OffroadBekker-v0`` with fixed seeds and actions, in full precision: a case of `golden`.

Knows the environment by its public interface alone (`gymnasium.make`, `make_vec`), so that it runs on any
commit: ``PYTHONPATH=TREE python benchmarks/golden_env.py TREE FILE [ESTIMATOR ...]`` drives the environment
of that source tree, with these estimators besides the usual one, and writes FILE.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

ENV_ID = "offroad_env:OffroadBekker-v0"
SCENARIOS = ("track", "speed", "climb", "brake", "ride", "patches")
MODELS = ("full", "paper")
TERRAIN_INFO = ("none", "estimate", "truth")
#: Steps of each drive; every step's reward is written, and every so many steps all that is seen.
STEPS, EVERY = 600, 10
#: Steps of the drives that follow the path, which get to where the soil changes and the hill is steep.
TRACKED_STEPS = 2000
#: Drives besides scenario x model x terrain_info: name -> (arguments, options of the reset).
OTHERS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "bicycle full": ({"scenario": "speed", "vehicle_model": "bicycle", "terrain_info": "estimate"}, {}),
    "bicycle paper": ({"scenario": "speed", "vehicle_model": "bicycle", "model": "paper"}, {}),
    "n 0.7": ({"scenario": "speed", "terrain_info": "estimate"}, {"n": 0.7}),
    "mismatch": ({"scenario": "speed", "terrain_info": "estimate"}, {"mismatch": (1.1, 0.8, 1.2)}),
    "clay": ({"scenario": "ride", "soil": "clay", "n_range": (0.4, 0.6), "terrain_info": "estimate"}, {}),
}


def plain(value: Any) -> Any:
    """What JSON can hold, with every digit; what is not finite becomes a word."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        return plain(value.tolist())
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def actions(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """(STEPS, *shape): waves with some noise, the same on every commit."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(STEPS).reshape(-1, *[1] * (len(shape) - 1))
    phase = rng.uniform(0.0, 2.0 * math.pi, (2, *shape[:-1]))
    steer = 0.15 * np.sin(1.3 * t + phase[0])
    drive = 0.45 + 0.5 * np.sin(0.4 * t + phase[1])
    wanted = np.stack([steer, drive], axis=-1) + 0.05 * rng.standard_normal((STEPS, *shape))
    return wanted.astype(np.float32)


def columns(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """key -> its value in every row; the keys must stay the same."""
    names = {tuple(sorted(row)) for row in rows}
    assert len(names) == 1, f"keys differ from step to step: {names}"
    return {name: [plain(row[name]) for row in rows] for name in rows[0]}


def tracked(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Steers along the path at 4 m/s."""
    offset, heading, curvature = (float(observation["path"][i]) for i in (0, 1, 5))
    steer = 4.0 * curvature - 0.4 * offset - 1.2 * heading
    drive = 0.3 + 0.4 * (4.0 - float(observation["motion"][0]))
    return np.clip(np.array([steer, drive]), -1.0, 1.0).astype(np.float32)


def single(arguments: dict[str, Any], options: dict[str, Any], *, tracking: bool = False) -> dict[str, Any]:
    """Episodes of one environment, one after the other, until the steps are done."""
    env = gym.make(ENV_ID, **arguments)
    seed = 1
    observation, info = env.reset(seed=seed, options=options)
    seen, infos, rewards, ends = [observation], [info], [], []
    plan = actions((2,), seed=7)
    for step in range(TRACKED_STEPS if tracking else STEPS):
        action = tracked(observation) if tracking else plan[step]
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        over = terminated or truncated
        if over or step % EVERY == 0:
            seen.append(observation)
            infos.append(info)
        if over:
            ends.append([step, bool(terminated), bool(truncated)])
            seed += 1
            observation, info = env.reset(seed=seed, options=options)
            seen.append(observation)
            infos.append(info)
    spaces = {name: [plain(box.low), plain(box.high)] for name, box in env.observation_space.spaces.items()}
    env.close()
    return {
        "spaces": spaces,
        "observations": columns(seen),
        "infos": columns(infos),
        "rewards": rewards,
        "ends": ends,
    }


def vector(arguments: dict[str, Any], count: int = 4) -> dict[str, Any]:
    """The native vector environment, with episodes that begin anew by themselves."""
    envs = gym.make_vec(ENV_ID, count, vectorization_mode="vector_entry_point", **arguments)
    observation, info = envs.reset(seed=11)
    seen, infos, rewards, ends = [observation], [plain(info)], [], []
    for step, action in enumerate(actions((count, 2), seed=8)):
        observation, reward, terminated, truncated, info = envs.step(action)
        rewards.append(plain(reward))
        if step % EVERY == 0:
            seen.append({name: value.copy() for name, value in observation.items()})
            infos.append(plain(info))
        if np.any(terminated | truncated):
            ends.append([step, plain(terminated), plain(truncated)])
    envs.close()
    return {"observations": columns(seen), "infos": infos, "rewards": rewards, "ends": ends}


def everything(estimators: list[str]) -> dict[str, Any]:
    """Name of a drive -> what came out."""
    result = {}
    for scenario in SCENARIOS:
        for model in MODELS:
            for terrain_info in TERRAIN_INFO:
                arguments = {"scenario": scenario, "model": model, "terrain_info": terrain_info}
                result[" ".join(arguments.values())] = single(arguments, {})
            arguments = {"scenario": scenario, "model": model, "terrain_info": "estimate"}
            result[f"{scenario} {model} tracked"] = single(arguments, {}, tracking=True)
    for name, (arguments, options) in OTHERS.items():
        result[name] = single(arguments, options)
    for place, name in enumerate(estimators):
        arguments = {"scenario": "speed", "terrain_info": "estimate", "estimator": name}
        result[f"estimator {place}"] = single(arguments, {})
    for model in MODELS:
        arguments = {"scenario": "speed", "model": model, "terrain_info": "estimate"}
        result[f"vector {model}"] = vector(arguments)
    return result


def main() -> None:
    """Drive and write; refuses to measure another tree than the one that was asked for."""
    tree, path = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    kind = type(gym.make(ENV_ID).unwrapped)
    source = Path(sys.modules[kind.__module__].__file__).resolve()
    assert source.is_relative_to(tree), f"{ENV_ID} comes from {source}, not from {tree}"
    print(f"{ENV_ID} from {source}")
    path.write_text(json.dumps(everything(sys.argv[3:]), allow_nan=False), encoding="utf-8")


if __name__ == "__main__":
    main()
