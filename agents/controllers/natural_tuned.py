"""Knobs of the arms in the natural form, by ``python -m agents.benchmark.natural_tune``; do not edit."""

from __future__ import annotations

__all__ = ["RUNS", "SETTINGS"]

#: (task arm knobs) -> the search, with its mean score.
RUNS: dict[str, str] = {
    "brake aware common": "seed 0, 440 episodes: not searched",
    "brake conservative common": "seed 0, 440 episodes: not searched",
    "brake nominal common": "seed 0, 440 episodes: 10.53 in training",
    "brake oracle common": "seed 0, 440 episodes: 10.23 in training",
    "speed aware common": "seed 0, 440 episodes: not searched",
    "speed conservative common": "seed 0, 440 episodes: not searched",
    "speed nominal common": "seed 0, 440 episodes: 41.99 in training",
    "speed oracle common": "seed 0, 440 episodes: 37.84 in training",
}

#: (task, arm, knobs) -> fields of `agents.controllers.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str, str], dict[str, float]] = {
    ("brake", "aware", "common"): {
        "brake_share": 0.4237,
        "z": 1,
    },
    ("brake", "conservative", "common"): {
        "brake_share": 0.4237,
    },
    ("brake", "nominal", "common"): {
        "brake_share": 0.4237,
        "n": 0.5,
    },
    ("brake", "oracle", "common"): {
        "brake_share": 0.4237,
    },
    ("speed", "aware", "common"): {
        "margin": 0.3812,
        "feed_forward": 0.3407,
        "brake_share": 0.2384,
        "speed_max": 10.4985,
        "z": 1,
    },
    ("speed", "conservative", "common"): {
        "margin": 0.3812,
        "feed_forward": 0.3407,
        "brake_share": 0.2384,
        "speed_max": 10.4985,
    },
    ("speed", "nominal", "common"): {
        "margin": 0.3812,
        "feed_forward": 0.3407,
        "brake_share": 0.2384,
        "speed_max": 10.4985,
        "n": 0.483,
    },
    ("speed", "oracle", "common"): {
        "margin": 0.3812,
        "feed_forward": 0.3407,
        "brake_share": 0.2384,
        "speed_max": 10.4985,
    },
}
