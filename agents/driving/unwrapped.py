"""The project's environment below the wrappers of ``gym.make``."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter

__all__ = ["bekker_env"]


def bekker_env(env: gym.Env[Any, Any]) -> OffroadBekkerEnv:
    """The environment below all wrappers.

    Raises
    ------
    InvalidParameter
        If it is not one of this project.
    """
    inner = env.unwrapped
    if not isinstance(inner, OffroadBekkerEnv):
        raise InvalidParameter(f"env must be an OffroadBekker environment, got {type(inner).__name__}")
    return inner
