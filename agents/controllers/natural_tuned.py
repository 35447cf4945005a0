"""Knobs of the arms in the natural form, by ``python -m agents.benchmark.natural_tune``; do not edit."""

from __future__ import annotations

__all__ = ["RUNS", "SETTINGS"]

#: (task arm knobs) -> the search, with its mean score.
RUNS: dict[str, str] = {
    "brake aware common": "not searched",
    "brake aware own": "seed 0, 440 episodes: 13.33 in training",
    "brake conservative common": "not searched",
    "brake conservative own": "seed 0, 440 episodes: 13.49 in training",
    "brake nominal common": "seed 0, 240 episodes: 10.2 in training",
    "brake nominal own": "seed 0, 440 episodes: 11.46 in training",
    "brake oracle common": "seed 0, 440 episodes: 9.714 in training",
    "brake oracle own": "seed 0, 440 episodes: 9.72 in training",
    "speed aware common": "not searched",
    "speed aware own": "seed 0, 440 episodes: 33.23 in training",
    "speed conservative common": "not searched",
    "speed conservative own": "seed 0, 440 episodes: 43.91 in training",
    "speed nmpc_belief common": "seed 0, 200 episodes: 31.56 in training",
    "speed nmpc_nominal common": "seed 0, 240 episodes: 39.43 in training",
    "speed nmpc_truth common": "seed 0, 440 episodes: 29.38 in training",
    "speed nominal common": "seed 0, 240 episodes: 34.86 in training",
    "speed nominal own": "seed 0, 440 episodes: 39.19 in training",
    "speed oracle common": "seed 0, 440 episodes: 31.66 in training",
    "speed oracle own": "seed 0, 440 episodes: 31.66 in training",
}

#: (task, arm, knobs) -> fields of `ArmSettings`; of `NmpcSettings` where arm is "nmpc_...".
SETTINGS: dict[tuple[str, str, str], dict[str, float]] = {
    ("brake", "aware", "common"): {
        "brake_share": 0.5737,
        "z": 1,
    },
    ("brake", "aware", "own"): {
        "brake_share": 1.2862,
        "z": 1.9135,
    },
    ("brake", "conservative", "common"): {
        "brake_share": 0.5737,
    },
    ("brake", "conservative", "own"): {
        "brake_share": 1.5487,
    },
    ("brake", "nominal", "common"): {
        "brake_share": 0.5737,
        "n": 0.36,
    },
    ("brake", "nominal", "own"): {
        "brake_share": 0.8737,
        "n": 0.1728,
    },
    ("brake", "oracle", "common"): {
        "brake_share": 0.5737,
    },
    ("brake", "oracle", "own"): {
        "brake_share": 0.5737,
    },
    ("speed", "aware", "common"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
        "z": 1,
    },
    ("speed", "aware", "own"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
        "z": 1.3812,
    },
    ("speed", "conservative", "common"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
    },
    ("speed", "conservative", "own"): {
        "margin": 0.7421,
        "feed_forward": 1.0073,
        "brake_share": 0.4304,
        "speed_max": 10.2128,
    },
    ("speed", "nmpc_belief", "common"): {
        "margin": 0.7934,
        "inside": 0.7728,
        "beyond": 1.0464,
        "brake_share": 0.3704,
        "speed_max": 13.4534,
        "z": 0,
    },
    ("speed", "nmpc_nominal", "common"): {
        "margin": 0.7934,
        "inside": 0.7728,
        "beyond": 1.0464,
        "brake_share": 0.3704,
        "speed_max": 13.4534,
        "n": 0.1,
    },
    ("speed", "nmpc_truth", "common"): {
        "margin": 0.7934,
        "inside": 0.7728,
        "beyond": 1.0464,
        "brake_share": 0.3704,
        "speed_max": 13.4534,
    },
    ("speed", "nominal", "common"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
        "n": 0.26,
    },
    ("speed", "nominal", "own"): {
        "margin": 0.5874,
        "feed_forward": 0.2518,
        "brake_share": 0.4544,
        "speed_max": 9.4985,
        "n": 0.291,
    },
    ("speed", "oracle", "common"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
    },
    ("speed", "oracle", "own"): {
        "margin": 0.7249,
        "feed_forward": 0.9185,
        "brake_share": 0.3344,
        "speed_max": 12.9271,
    },
}
