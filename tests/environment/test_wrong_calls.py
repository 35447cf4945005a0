"""Calls with arguments of the wrong type end in one sentence of this project, never inside of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import offroad_env
from offroad_env.errors import OffroadError
from offroad_env.world.terrain import flat

#: What is given in place of an argument.
WRONG: dict[str, Any] = {
    "text": "no such thing",
    "digits": "0.1",
    "bytes": b"x",
    "list": [1, "a"],
    "mapping": {"no": {"such": "key"}},
    "object": object(),
    "class": dict,
    "negative": -3,
    "not a number": float("nan"),
    "huge": 1e300,
    "complex": 1 + 2j,
    "array": np.array([["a", None]], dtype=object),
}


def plant() -> Any:
    return offroad_env.make_plant(offroad_env.VEHICLES["mrzr"], offroad_env.SOILS["clay"], flat())


def calls() -> dict[str, tuple[Callable[..., Any], Mapping[str, Any]]]:
    """Name -> (what is called, arguments by which the call is right)."""
    truth = plant()
    state, warm = offroad_env.settled_state(truth, v_x=3.0)
    still = np.tile([0.0, 100.0, 0.0], (2, 1))
    soil, wheel = offroad_env.SOILS["clay"], offroad_env.make_wheel(r=0.3, b=0.2)
    env = offroad_env.OffroadBekkerEnv()
    envs = offroad_env.make_vec(2, threads=1)
    env.reset(seed=0)
    envs.reset(seed=0)
    vehicle = offroad_env.VEHICLES["mrzr"]
    whole = {"scenario": "speed", "terrain_info": "none", "model": "full", "vehicle_model": "half_car"}
    chosen = {"estimator": None, "n_range": (0.5, 0.9), "soil": "clay", "vehicle": "mrzr", "weights": None}
    more = {"sensors": "paper", "structure": None, "tyre": None, "natural_soil": False, "randomise": None}
    return {
        "OffroadBekkerEnv": (offroad_env.OffroadBekkerEnv, {**whole, **chosen, **more, "render_mode": None}),
        "make_vec": (
            offroad_env.make_vec,
            {
                "num_envs": 1,
                "max_episode_steps": 10,
                "autoreset_mode": "NextStep",
                "threads": 1,
                "version": "v0",
            },
        ),
        "reset": (env.reset, {"seed": 0, "options": {}}),
        "reset options": (
            lambda **options: env.reset(seed=0, options=options),
            {"n": 0.7, "mismatch": (1.0, 1.0, 1.0), "context": {}},
        ),
        "reset context": (
            lambda **keys: env.reset(options={"context": {k.replace("__", "."): v for k, v in keys.items()}}),
            {"n": 0.7, "vehicle__m": 1400.0, "imu__bias": 0.1, "terrain__slope": 0.01},
        ),
        "step": (env.step, {"action": np.zeros(2)}),
        "vector reset": (envs.reset, {"seed": 0, "options": {}}),
        "vector reset options": (
            lambda **options: envs.reset(seed=0, options=options),
            {"n": 0.7, "reset_mask": np.array([True, True]), "context": {}},
        ),
        "vector step": (envs.step, {"actions": np.zeros((2, 2))}),
        "make_soil": (
            offroad_env.make_soil,
            {"base": "clay", "kind": None, "n": 0.7, "c": 4000.0, "phi": 0.3, "k_phi": 1e6, "k_x": 0.02},
        ),
        "make_vehicle": (
            offroad_env.make_vehicle,
            {"base": "mrzr", "m": 1400.0, "h_cg": 0.6, "r": 0.33, "k_f": 28029.0, "steer_max": 0.5},
        ),
        "make_wheel": (offroad_env.make_wheel, {"r": 0.3, "b": 0.2}),
        "make_tyre": (offroad_env.make_tyre, {"base": next(iter(offroad_env.TYRES))}),
        "make_structure": (
            offroad_env.make_structure,
            {
                "preset": "grid",
                "elastic_modulus": 2e8,
                "slip_sinkage_rate": 1.5,
                "damping": 0.0,
                "ruts": "none",
            },
        ),
        "make_sensors": (
            offroad_env.make_sensors,
            {"sensors": "paper", "imu": "preset", "wheel": "preset", "gnss": "preset"},
        ),
        "ImuConfig": (offroad_env.ImuConfig, {"rate": 100.0, "lever_arm": (0.0, 0.0, 0.0)}),
        "WheelSpeedConfig": (offroad_env.WheelSpeedConfig, {"rate": 50.0}),
        "GnssConfig": (offroad_env.GnssConfig, {"rate": 10.0}),
        "Uniform": (offroad_env.Uniform, {"low": 0.1, "high": 0.2}),
        "LogUniform": (offroad_env.LogUniform, {"low": 0.1, "high": 0.2}),
        "Normal": (offroad_env.Normal, {"mean": 0.1, "sd": 0.2}),
        "Choice": (offroad_env.Choice, {"values": ("clay",)}),
        "make_plant": (
            offroad_env.make_plant,
            {
                "vehicle": vehicle,
                "soil": soil,
                "ground": flat(),
                "model": "full",
                "vehicle_model": "half_car",
                "slip": 0.0,
                "structure": None,
                "tyre": None,
            },
        ),
        "settled_state": (
            offroad_env.settled_state,
            {"plant": truth, "x": 0.0, "y": 0.0, "yaw": 0.0, "v_x": 1.0},
        ),
        "simulate": (
            offroad_env.simulate,
            {
                "plant": truth,
                "state": state,
                "warm": warm,
                "steer": 0.0,
                "force": 0.0,
                "duration": 0.05,
                "dt": 0.01,
            },
        ),
        "simulate_commands": (
            offroad_env.simulate_commands,
            {"plant": truth, "state": state, "warm": warm, "commands": still, "interval": 0.02, "dt": 0.005},
        ),
        "wheel_forces": (
            offroad_env.wheel_forces,
            {
                "soil": soil,
                "wheel": wheel,
                "load": 3000.0,
                "slip": 0.1,
                "slip_angle": 0.0,
                "shear": "independent",
                "structure": None,
                "tyre": None,
                "errors": "raise",
            },
        ),
        "read_soil": (offroad_env.read_soil, {"given": "clay"}),
        "read_vehicle": (offroad_env.read_vehicle, {"given": "mrzr"}),
        "register_scenario": (
            offroad_env.register_scenario,
            {"scenario": {"base": "speed"}, "name": "own_of_calls"},
        ),
        "RewardWeights": (offroad_env.RewardWeights, {}),
    }


CALLS = calls()
CASES = [(name, argument) for name, (_, arguments) in CALLS.items() for argument in arguments]


def test_the_list_of_calls_is_long():
    assert len(CASES) * len(WRONG) >= 300


@pytest.fixture(autouse=True)
def own_register(monkeypatch):
    """What a call registers is gone after its test."""
    monkeypatch.setattr(
        "offroad_env.environment.scenario_descriptions.SCENARIOS", dict(offroad_env.SCENARIOS)
    )
    monkeypatch.setenv("OFFROAD_BEKKER_REGISTERED", os.environ.get("OFFROAD_BEKKER_REGISTERED", "{}"))


@pytest.mark.parametrize("name", CALLS)
def test_the_calls_are_right_before_an_argument_is_replaced(name):
    function, arguments = CALLS[name]
    function(**arguments)


@pytest.mark.parametrize(("name", "argument"), CASES)
def test_a_wrong_argument_is_refused_in_a_sentence(name, argument):
    function, arguments = CALLS[name]
    wrong = []
    for label, value in WRONG.items():
        try:
            with np.errstate(all="ignore"):
                function(**{**arguments, argument: value})
        except (OffroadError, gym.error.Error) as error:
            if len(str(error)) > 1000:
                wrong.append(f"{label}: a sentence of {len(str(error))} characters")
        except Exception as error:
            wrong.append(f"{label}: {type(error).__name__}: {str(error)[:120]}")
    assert not wrong, "\n".join(wrong)
