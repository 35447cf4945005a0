"""Tuned knobs of the arms. Written by ``python -m agents.tune``; do not edit by hand.

Last run: scenario speed, seed 0, 432 training episodes for each arm;
mean scores in training: nominal 48.6 s, conservative 45.4 s, aware 42.4 s, oracle 42.8 s.
"""

from __future__ import annotations

__all__ = ["SETTINGS"]

#: (scenario, arm) -> fields of `agents.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("speed", "aware"): {"margin": 0.8791, "slip_angle": 0.2919, "feed_forward": 0.8909, "z": 1.4555},
    ("speed", "conservative"): {"margin": 1.0056, "slip_angle": 0.3449, "feed_forward": 0.8228},
    ("speed", "nominal"): {"margin": 0.7797, "slip_angle": 0.3095, "feed_forward": 0.6367, "n": 0.0626},
    ("speed", "oracle"): {"margin": 0.8944, "slip_angle": 0.2364, "feed_forward": 0.9823},
}
