"""Knobs of the arms in the natural form, by ``python -m agents.benchmark.natural_tune``; do not edit."""

from __future__ import annotations

__all__ = ["RUNS", "SETTINGS"]

#: (task arm knobs) -> the search, with its mean score.
RUNS: dict[str, str] = {
    "brake aware common": "seed 0, 320 episodes: not searched",
    "brake conservative common": "seed 0, 320 episodes: not searched",
    "brake nominal common": "seed 0, 320 episodes: 15.4 in training",
    "brake oracle common": "seed 0, 320 episodes: 10.59 in training",
    "speed aware common": "seed 0, 320 episodes: not searched",
    "speed conservative common": "seed 0, 320 episodes: not searched",
    "speed nominal common": "seed 0, 320 episodes: 45.1 in training",
    "speed oracle common": "seed 0, 320 episodes: 47.09 in training",
}

#: (task, arm, knobs) -> fields of `agents.controllers.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str, str], dict[str, float]] = {
    ("brake", "aware", "common"): {"brake_share": 0.7987, "z": 1},
    ("brake", "conservative", "common"): {"brake_share": 0.7987},
    ("brake", "nominal", "common"): {"brake_share": 0.7987, "n": 0.628},
    ("brake", "oracle", "common"): {"brake_share": 0.7987},
    ("speed", "aware", "common"): {"margin": 0.4451, "slip_angle": 0.2907, "feed_forward": 0.8048, "z": 1},
    ("speed", "conservative", "common"): {"margin": 0.4451, "slip_angle": 0.2907, "feed_forward": 0.8048},
    ("speed", "nominal", "common"): {
        "margin": 0.4451,
        "slip_angle": 0.2907,
        "feed_forward": 0.8048,
        "n": 0.267,
    },
    ("speed", "oracle", "common"): {"margin": 0.4451, "slip_angle": 0.2907, "feed_forward": 0.8048},
}
