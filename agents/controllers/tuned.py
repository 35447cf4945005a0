"""Tuned knobs of the arms. Written by ``python -m agents.benchmark.tune``; do not edit by hand."""

from __future__ import annotations

__all__ = ["COMMON_PLACES", "RUNS", "SETTINGS"]

#: Scenario -> the search that its settings come from, with the mean scores in training.
RUNS: dict[str, str] = {
    "brake": "seed 0, 136 episodes an arm: nominal 9.197, conservative 9.37, aware 9.052, oracle 9.053",
    "brake common": "seed 0, 9 x 40 episodes: nominal 9.63",
    "climb": "seed 0, 136 episodes an arm: nominal 74.42, conservative 72.65, aware 70.82, oracle 70.79",
    "climb common": "seed 0, 9 x 40 episodes: nominal 72.1",
    "patches": "seed 3, 1536 episodes an arm: nominal 47.2, conservative 45.8, aware 43.4, oracle 41.8",
    "patches common": "seed 0, 9 x 40 episodes: nominal 48.8",
    "ride": "seed 0, 136 episodes an arm: nominal 46.92, conservative 48.46, aware 48.61, oracle 48.69",
    "ride common": "seed 0, 9 x 40 episodes: nominal 48.1",
    "speed": "seed 0, 432 episodes an arm: nominal 48.6, conservative 45.4, aware 42.4, oracle 42.8",
    "speed common": "seed 0, 9 x 40 episodes: nominal 48.3",
    "track": "seed 0, 354 episodes an arm: nominal 0.0177, conservative 0.0177, aware 0.0176, oracle 0.0176",
    "track common": "seed 0, 9 x 40 episodes: nominal 0.0174",
}

#: Scenario -> place in the prior where nominal does best with the knobs of the oracle.
COMMON_PLACES: dict[str, float] = {
    "brake": 0.125,
    "climb": 0.875,
    "patches": 0,
    "ride": 0.625,
    "speed": 0.25,
    "track": 0.125,
}

#: (scenario, arm) -> fields of `agents.controllers.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("brake", "aware"): {
        "brake_share": 1.2133,
        "z": 0.5508,
    },
    ("brake", "conservative"): {
        "brake_share": 1.3,
    },
    ("brake", "nominal"): {
        "brake_share": 0.7103,
        "n": 0.9003,
    },
    ("brake", "oracle"): {
        "brake_share": 1.2133,
    },
    ("climb", "aware"): {
        "slip_share": 2,
        "z": 0.5059,
    },
    ("climb", "conservative"): {
        "slip_share": 1.9358,
    },
    ("climb", "nominal"): {
        "slip_share": 1.2047,
        "n": 0.3448,
    },
    ("climb", "oracle"): {
        "slip_share": 1.7672,
    },
    ("patches", "aware"): {
        "margin": 0.8027,
        "slip_angle": 0.4814,
        "feed_forward": 0.8792,
        "integral": 1.4393,
        "z": 0.7869,
    },
    ("patches", "conservative"): {
        "margin": 0.7916,
        "slip_angle": 0.5144,
        "feed_forward": 0.7766,
        "integral": 1.3471,
    },
    ("patches", "nominal"): {
        "margin": 0.8722,
        "slip_angle": 0.3654,
        "feed_forward": 0.9021,
        "integral": 1.2536,
        "n": 0.0711,
    },
    ("patches", "oracle"): {
        "margin": 0.9723,
        "slip_angle": 0.3033,
        "feed_forward": 0.9418,
        "integral": 0.3642,
    },
    ("ride", "aware"): {
        "ride_speed": 7.0474,
        "ride_change": 1.3609,
        "ride_feel": 0.6483,
        "ride_share": 0.539,
        "z": 0.3099,
    },
    ("ride", "conservative"): {
        "ride_speed": 7.0796,
        "ride_change": 1.753,
        "ride_feel": 0.4781,
        "ride_share": 0.5273,
    },
    ("ride", "nominal"): {
        "ride_speed": 7.0796,
        "ride_change": 1.753,
        "ride_feel": 0.4781,
        "ride_share": 0.5273,
        "n": 0.1961,
    },
    ("ride", "oracle"): {
        "ride_speed": 7.0474,
        "ride_change": 1.3609,
        "ride_feel": 0.6483,
        "ride_share": 0.539,
    },
    ("speed", "aware"): {
        "margin": 0.8791,
        "slip_angle": 0.2919,
        "feed_forward": 0.8909,
        "z": 1.4555,
    },
    ("speed", "conservative"): {
        "margin": 1.0056,
        "slip_angle": 0.3449,
        "feed_forward": 0.8228,
    },
    ("speed", "nominal"): {
        "margin": 0.7797,
        "slip_angle": 0.3095,
        "feed_forward": 0.6367,
        "n": 0.0626,
    },
    ("speed", "oracle"): {
        "margin": 0.8944,
        "slip_angle": 0.2364,
        "feed_forward": 0.9823,
    },
    ("track", "aware"): {
        "feed_forward": 0.2271,
        "distance": 0.0163,
        "unknown": 1.0872,
    },
    ("track", "conservative"): {
        "feed_forward": 0.1438,
        "distance": 0.0158,
        "unknown": 1.111,
    },
    ("track", "nominal"): {
        "feed_forward": 0.1438,
        "distance": 0.0158,
        "unknown": 1.111,
        "n": 0.0508,
    },
    ("track", "oracle"): {
        "feed_forward": 0.2271,
        "distance": 0.0163,
        "unknown": 1.0872,
    },
}
