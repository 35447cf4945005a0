"""OffroadBekker: vehicles on deformable soil of unknown properties.

Importing this package registers the environments ``OffroadBekker-v0`` and ``OffroadBekker-v1``; the
public names load on first use, so that the import stays fast and ``estimators`` can be imported on its own.
"""

from __future__ import annotations

import importlib
from typing import Any

from gymnasium.envs.registration import register, registry

__version__ = "0.2.0"

#: Public name -> module that defines it.
_EXPORTS = {
    "SENSORS": "offroad_env.simulation.sensor_presets",
    "SCENARIOS": "offroad_env.environment.scenarios",
    "SOILS": "offroad_env.world.soils",
    "TYRES": "offroad_env.world.tyres",
    "VEHICLES": "offroad_env.world.vehicles",
    "Choice": "offroad_env.environment.randomisation",
    "Course": "offroad_env.environment.scenarios",
    "CourseRecipe": "offroad_env.environment.courses",
    "GnssConfig": "offroad_env.simulation.sensor_configs",
    "ImuConfig": "offroad_env.simulation.sensor_configs",
    "LogUniform": "offroad_env.environment.randomisation",
    "MeasuredSoils": "offroad_env.environment.soil_draws",
    "Normal": "offroad_env.environment.randomisation",
    "OffroadBekkerEnv": "offroad_env.environment.env",
    "OffroadBekkerVectorEnv": "offroad_env.environment.vector_env",
    "RewardWeights": "offroad_env.environment.rewards",
    "Scenario": "offroad_env.environment.scenarios",
    "Uniform": "offroad_env.environment.randomisation",
    "WheelForces": "offroad_env.simulation.wheel",
    "WheelSpeedConfig": "offroad_env.simulation.sensor_configs",
    "make_plant": "offroad_env.simulation.simulator",
    "make_sb3_vec": "offroad_env.environment.sb3_vec",
    "make_sensors": "offroad_env.simulation.sensor_presets",
    "make_soil": "offroad_env.world.soils",
    "make_structure": "offroad_env.world.structures",
    "make_tyre": "offroad_env.world.tyres",
    "make_vec": "offroad_env.environment.vector_env",
    "make_vehicle": "offroad_env.world.vehicles",
    "make_wheel": "offroad_env.world.vehicles",
    "read_soil": "offroad_env.world.descriptions",
    "read_vehicle": "offroad_env.world.descriptions",
    "register_scenario": "offroad_env.environment.scenario_descriptions",
    "register_soil": "offroad_env.world.descriptions",
    "register_vehicle": "offroad_env.world.descriptions",
    "settled_state": "offroad_env.simulation.simulator",
    "simulate": "offroad_env.simulation.simulator",
    "simulate_commands": "offroad_env.simulation.simulator",
    "wheel_forces": "offroad_env.simulation.wheel",
}

__all__ = ["__version__", *_EXPORTS]

ENV_ID = "OffroadBekker-v0"

if ENV_ID not in registry:
    register(
        id=ENV_ID,
        entry_point="offroad_env.environment.env:OffroadBekkerEnv",
        vector_entry_point="offroad_env.environment.vector_env:OffroadBekkerVectorEnv",
    )
    register(
        id="OffroadBekker-v1",
        entry_point="offroad_env.environment.env_v1:OffroadBekkerEnvV1",
        vector_entry_point="offroad_env.environment.env_v1:OffroadBekkerVectorEnvV1",
    )
    # v0 stays: v1 has other defaults. With a number here Gymnasium would call v0 out of date.
    registry["OffroadBekker-v1"].version = None


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_EXPORTS[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_EXPORTS})
