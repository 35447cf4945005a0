"""Tuned knobs of the arms. Written by ``python -m agents.tune``; do not edit by hand."""

from __future__ import annotations

__all__ = ["SETTINGS"]

#: (scenario, arm) -> fields of `agents.arms.ArmSettings`.
SETTINGS: dict[tuple[str, str], dict[str, float]] = {
    ("speed", "nominal"): {"margin": 0.9, "slip_angle": 0.25, "feed_forward": 0.75, "n": 0.0},
    ("speed", "conservative"): {"margin": 0.9, "slip_angle": 0.25, "feed_forward": 0.75},
    ("speed", "aware"): {"margin": 0.9, "slip_angle": 0.25, "feed_forward": 1.0, "z": 1.0},
    ("speed", "oracle"): {"margin": 0.9, "slip_angle": 0.25, "feed_forward": 1.0},
}
