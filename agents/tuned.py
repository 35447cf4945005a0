"""Tuned knobs of the arms. Written by ``python -m agents.tune``; do not edit by hand.

Last run: scenario speed, seed 0, 120 training episodes for each arm;
mean scores in training: nominal 45.4 s, conservative 41.9 s, aware 41.8 s, oracle 41.1 s.
"""

from __future__ import annotations

__all__ = ["SETTINGS"]

#: (scenario, arm) -> fields of `agents.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("speed", "aware"): {"margin": 0.8075, "slip_angle": 0.3301, "feed_forward": 0.6948, "z": 1.2657},
    ("speed", "conservative"): {"margin": 1.0444, "slip_angle": 0.4557, "feed_forward": 0.7303},
    ("speed", "nominal"): {"margin": 0.7819, "slip_angle": 0.2776, "feed_forward": 0.9543, "n": 0.1735},
    ("speed", "oracle"): {"margin": 0.8526, "slip_angle": 0.3175, "feed_forward": 0.8602},
}
