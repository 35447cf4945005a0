"""Tuned knobs of the arms. Written by ``python -m agents.tune``; do not edit by hand.

Last run: scenario speed, seed 0, 480 training episodes for each arm;
mean scores in training: nominal 45.6 s, conservative 44.7 s, aware 42.8 s, oracle 41.3 s.
"""

from __future__ import annotations

__all__ = ["SETTINGS"]

#: (scenario, arm) -> fields of `agents.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("speed", "aware"): {"margin": 0.9333, "slip_angle": 0.3092, "feed_forward": 0.8787, "z": 0.5},
    ("speed", "conservative"): {"margin": 0.8843, "slip_angle": 0.45, "feed_forward": 0.6727},
    ("speed", "nominal"): {"margin": 0.9685, "slip_angle": 0.2934, "feed_forward": 0.6919, "n": 0.0642},
    ("speed", "oracle"): {"margin": 0.9333, "slip_angle": 0.3092, "feed_forward": 0.8787},
}
