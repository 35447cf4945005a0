"""Calls with arguments of the wrong type end in one sentence of this project, never inside of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

import offroad_env
from offroad_env.errors import OffroadError
from offroad_env.simulation.soil_holds import what_soil_holds
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


COURSE = offroad_env.SCENARIOS["speed"].draw(np.random.default_rng(0))
Calls = dict[str, tuple[Callable[..., Any], Mapping[str, Any]]]


# What needs a simulation waits for the first test that calls it: every worker collects all tests.
@cache
def begun() -> offroad_env.OffroadBekkerEnv:
    """An environment in an episode."""
    env = offroad_env.OffroadBekkerEnv()
    env.reset(seed=0)
    return env


@cache
def begun_in_parallel() -> offroad_env.OffroadBekkerVectorEnv:
    """Two of them."""
    envs = offroad_env.make_vec(2, threads=1)
    envs.reset(seed=0)
    return envs


@cache
def settled() -> tuple[Any, Any]:
    """State and warm start of a plant at 3 m/s."""
    return offroad_env.settled_state(plant(), v_x=3.0)


class Late(NamedTuple):
    """An argument that is made when it is needed."""

    make: Callable[[], Any]


def made(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a call, with those that come late."""
    return {name: value.make() if isinstance(value, Late) else value for name, value in arguments.items()}


def calls_of_environments() -> Calls:
    """Name -> (what is called, arguments by which the call is right)."""
    whole = {"scenario": "speed", "terrain_info": "none", "model": "full", "vehicle_model": "half_car"}
    chosen = {"estimator": None, "n_range": (0.5, 0.9), "soil": "clay", "vehicle": "mrzr", "weights": None}
    more = {"sensors": "paper", "structure": None, "tyre": None, "natural_soil": False, "randomise": None}
    many = {
        "num_envs": 1,
        "max_episode_steps": 10,
        "autoreset_mode": "NextStep",
        "threads": 1,
        "version": "v0",
    }
    contexts = {"n": 0.7, "vehicle__m": 1400.0, "imu__bias": 0.1, "terrain__slope": 0.01}
    return {
        "OffroadBekkerEnv": (offroad_env.OffroadBekkerEnv, {**whole, **chosen, **more, "render_mode": None}),
        "make_vec": (offroad_env.make_vec, many),
        "reset": (lambda **arguments: begun().reset(**arguments), {"seed": 0, "options": {}}),
        "reset options": (
            lambda **options: begun().reset(seed=0, options=options),
            {"n": 0.7, "mismatch": (1.0, 1.0, 1.0), "context": {}},
        ),
        "reset context": (
            lambda **keys: begun().reset(
                options={"context": {k.replace("__", "."): v for k, v in keys.items()}}
            ),
            contexts,
        ),
        "step": (lambda action: begun().step(action), {"action": np.zeros(2)}),
        "register_scenario": (
            offroad_env.register_scenario,
            {"scenario": {"base": "speed"}, "name": "own_of_calls"},
        ),
        "RewardWeights": (offroad_env.RewardWeights, {"progress": 0.1, "goal": 10.0}),
        "CourseRecipe": (
            offroad_env.CourseRecipe,
            {"path": "winding", "length": 100.0, "radius": (12.0, 40.0), "max_heading": 1.0, "slope": 0.0},
        ),
        "Scenario": (
            offroad_env.Scenario,
            {"name": "own", "draw": offroad_env.CourseRecipe(), "corridor": 2.0, "soil": "clay"}
            | {
                "vehicle": "mrzr",
                "n_range": (0.5, 0.9),
                "time_limit": 20.0,
                "weights": offroad_env.RewardWeights(),
            },
        ),
        "Course": (
            offroad_env.Course,
            {name: getattr(COURSE, name) for name in ("path", "ground", "known_ground", "sections")},
        ),
    }


def calls_of_vector_environments() -> Calls:
    """As `calls_of_environments`."""
    options = {"n": 0.7, "reset_mask": np.array([True, True]), "context": {}}
    return {
        "vector reset": (
            lambda **arguments: begun_in_parallel().reset(**arguments),
            {"seed": 0, "options": {}},
        ),
        "vector reset options": (
            lambda **options: begun_in_parallel().reset(seed=0, options=options),
            options,
        ),
        "make_sb3_vec": (offroad_env.make_sb3_vec, {"num_envs": 1, "seed": 0, "threads": 1}),
        "OffroadBekkerVectorEnv": (
            offroad_env.OffroadBekkerVectorEnv,
            {"num_envs": 1, "max_episode_steps": 10, "autoreset_mode": "NextStep", "threads": 1},
        ),
        "vector step": (lambda actions: begun_in_parallel().step(actions), {"actions": np.zeros((2, 2))}),
    }


def calls_that_describe() -> Calls:
    """As `calls_of_environments`; of soils, vehicles, sensors and distributions."""
    soil = {"base": "clay", "kind": None, "n": 0.7, "c": 4000.0, "phi": 0.3, "k_phi": 1e6, "k_x": 0.02}
    vehicle = {"base": "mrzr", "m": 1400.0, "h_cg": 0.6, "r": 0.33, "k_f": 28029.0, "steer_max": 0.5}
    laws = {"elastic_modulus": 2e8, "slip_sinkage_rate": 1.5, "damping": 0.0, "ruts": "none"}
    sensors = {"sensors": "paper", "imu": "preset", "wheel": "preset", "gnss": "preset"}
    return {
        "make_soil": (offroad_env.make_soil, soil),
        "make_vehicle": (offroad_env.make_vehicle, vehicle),
        "make_wheel": (offroad_env.make_wheel, {"r": 0.3, "b": 0.2}),
        "make_tyre": (offroad_env.make_tyre, {"base": next(iter(offroad_env.TYRES))}),
        "make_structure": (offroad_env.make_structure, {"preset": "grid", **laws}),
        "make_sensors": (offroad_env.make_sensors, sensors),
        "ImuConfig": (offroad_env.ImuConfig, {"rate": 100.0, "lever_arm": (0.0, 0.0, 0.0)}),
        "WheelSpeedConfig": (offroad_env.WheelSpeedConfig, {"rate": 50.0}),
        "GnssConfig": (offroad_env.GnssConfig, {"rate": 10.0}),
        "Uniform": (offroad_env.Uniform, {"low": 0.1, "high": 0.2}),
        "LogUniform": (offroad_env.LogUniform, {"low": 0.1, "high": 0.2}),
        "Normal": (offroad_env.Normal, {"mean": 0.1, "sd": 0.2}),
        "Choice": (offroad_env.Choice, {"values": ("clay",)}),
        "MeasuredSoils": (offroad_env.MeasuredSoils, {"vehicle": "mrzr", "deepest": 0.5}),
        "register_soil": (
            offroad_env.register_soil,
            {"name": "own_of_calls", "soil": {"base": "clay"}, "title": "", "source": "", "remark": ""},
        ),
        "register_vehicle": (
            offroad_env.register_vehicle,
            {"name": "own_of_calls", "vehicle": {"base": "mrzr"}, "title": "", "source": "", "remark": ""},
        ),
        "read_soil": (offroad_env.read_soil, {"given": "clay"}),
        "read_vehicle": (offroad_env.read_vehicle, {"given": "mrzr"}),
    }


def calls_of_the_simulator() -> Calls:
    """As `calls_of_environments`."""
    truth = plant()
    soil, wheel = offroad_env.SOILS["clay"], offroad_env.make_wheel(r=0.3, b=0.2)
    planar = offroad_env.make_plant(truth.vehicle, soil, flat(), model="paper")
    begin = {"plant": truth, "state": Late(lambda: settled()[0]), "warm": Late(lambda: settled()[1])}
    kinds = {"model": "full", "vehicle_model": "half_car", "slip": 0.0, "structure": None, "tyre": None}
    place = {"x": 0.0, "y": 0.0, "yaw": 0.0, "v_x": 1.0}
    still = {"commands": np.tile([0.0, 100.0, 0.0], (2, 1)), "interval": 0.02, "dt": 0.005}
    wheel_at = {"load": 3000.0, "slip": 0.1, "slip_angle": 0.0, "shear": "independent"}
    laws = {"structure": None, "tyre": None, "errors": "raise"}
    return {
        "make_plant": (
            offroad_env.make_plant,
            {"vehicle": offroad_env.VEHICLES["mrzr"], "soil": soil, "ground": flat(), **kinds},
        ),
        "settled_state": (offroad_env.settled_state, {"plant": truth, **place}),
        "simulate": (
            offroad_env.simulate,
            {**begin, "plant": planar, "steer": 0.0, "force": 0.0, "duration": 0.05, "dt": 0.01},
        ),
        "simulate_commands": (offroad_env.simulate_commands, {**begin, **still}),
        "what_soil_holds": (what_soil_holds, {"plant": truth, "x": 0.0, "y": 0.0}),
        "wheel_forces": (offroad_env.wheel_forces, {"soil": soil, "wheel": wheel, **wheel_at, **laws}),
    }


CALLS: Calls = {
    **calls_of_environments(),
    **calls_of_vector_environments(),
    **calls_that_describe(),
    **calls_of_the_simulator(),
}
CASES = [(name, argument) for name, (_, arguments) in CALLS.items() for argument in arguments]


def test_the_list_of_calls_is_long():
    assert len(CASES) * len(WRONG) >= 1000


@pytest.fixture(autouse=True)
def own_register(monkeypatch):
    """What a call registers is gone after its test."""
    monkeypatch.setattr(
        "offroad_env.environment.scenario_descriptions.SCENARIOS", dict(offroad_env.SCENARIOS)
    )
    monkeypatch.setenv("OFFROAD_BEKKER_REGISTERED", os.environ.get("OFFROAD_BEKKER_REGISTERED", "{}"))
    yield
    for catalogue in (offroad_env.SOILS, offroad_env.VEHICLES):
        catalogue.remove("own_of_calls")


@pytest.mark.parametrize("name", CALLS)
def test_the_calls_are_right_before_an_argument_is_replaced(name):
    function, arguments = CALLS[name]
    function(**made(arguments))


@pytest.mark.parametrize(("name", "argument"), CASES)
def test_a_wrong_argument_is_refused_in_a_sentence(name, argument):
    function, arguments = CALLS[name]
    right = made(arguments)
    wrong = []
    for label, value in WRONG.items():
        try:
            with np.errstate(all="ignore"):
                function(**{**right, argument: value})
        except (OffroadError, gym.error.Error) as error:
            if len(str(error)) > 1000:
                wrong.append(f"{label}: a sentence of {len(str(error))} characters")
        except Exception as error:
            wrong.append(f"{label}: {type(error).__name__}: {str(error)[:120]}")
    assert not wrong, "\n".join(wrong)
