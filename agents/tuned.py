"""Tuned knobs of the arms. Written by ``python -m agents.tune``; do not edit by hand."""

from __future__ import annotations

__all__ = ["RUNS", "SETTINGS"]

#: Scenario -> the search that its settings come from, with the mean scores in training.
RUNS: dict[str, str] = {
    "brake": "seed 0, 136 episodes an arm: nominal 9.197, conservative 9.37, aware 9.052, oracle 9.053",
    "climb": "seed 0, 136 episodes an arm: nominal 74.42, conservative 72.65, aware 70.82, oracle 70.79",
    "patches": "seed 0, 136 episodes an arm: nominal 49.13, conservative 52.63, aware 58.14, oracle 43.92",
}

#: (scenario, arm) -> fields of `agents.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("brake", "aware"): {"brake_share": 1.2133, "z": 0.5508},
    ("brake", "conservative"): {"brake_share": 1.3},
    ("brake", "nominal"): {"brake_share": 0.7103, "n": 0.9003},
    ("brake", "oracle"): {"brake_share": 1.2133},
    ("climb", "aware"): {"slip_share": 2, "z": 0.5059},
    ("climb", "conservative"): {"slip_share": 1.9358},
    ("climb", "nominal"): {"slip_share": 1.2047, "n": 0.3448},
    ("climb", "oracle"): {"slip_share": 1.7672},
    ("patches", "aware"): {"margin": 0.6348, "slip_angle": 0.2744, "feed_forward": 0.8222, "z": 0.7108},
    ("patches", "conservative"): {"margin": 0.7241, "slip_angle": 0.3119, "feed_forward": 0.6529},
    ("patches", "nominal"): {"margin": 0.6348, "slip_angle": 0.2744, "feed_forward": 0.8222, "n": 0.2042},
    ("patches", "oracle"): {"margin": 0.7241, "slip_angle": 0.3119, "feed_forward": 0.6529},
    ("speed", "aware"): {"margin": 0.8791, "slip_angle": 0.2919, "feed_forward": 0.8909, "z": 1.4555},
    ("speed", "conservative"): {"margin": 1.0056, "slip_angle": 0.3449, "feed_forward": 0.8228},
    ("speed", "nominal"): {"margin": 0.7797, "slip_angle": 0.3095, "feed_forward": 0.6367, "n": 0.0626},
    ("speed", "oracle"): {"margin": 0.8944, "slip_angle": 0.2364, "feed_forward": 0.9823},
}
