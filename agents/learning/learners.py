"""The algorithms that learn, by name. Their packages are in the extra ``rl``."""

from __future__ import annotations

from typing import Any

from offroad_env.errors import InvalidParameter, OffroadError

__all__ = ["ALGORITHMS", "MissingExtraError", "find_learner"]

ALGORITHMS = ("ppo", "recurrent_ppo", "sac")


class MissingExtraError(OffroadError, ImportError):
    """Learning needs packages that the base install leaves out."""


def find_learner(algorithm: str) -> Any:
    """The class of stable-baselines3 or sb3-contrib.

    Raises
    ------
    InvalidParameter
        For an unknown algorithm.
    MissingExtraError
        Without these packages.
    """
    if algorithm not in ALGORITHMS:
        raise InvalidParameter(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    try:
        import sb3_contrib
        import stable_baselines3
    except ImportError as error:
        raise MissingExtraError(
            f"learning needs stable-baselines3, sb3-contrib and torch ({error}): "
            "pip install offroad-bekker[rl]"
        ) from error
    if algorithm == "recurrent_ppo":
        return sb3_contrib.RecurrentPPO
    return stable_baselines3.SAC if algorithm == "sac" else stable_baselines3.PPO
