"""Sizes of effects that physics allows: beyond them a fit may be good, but the name is wrong."""

from __future__ import annotations

from offroad_env.effects import EFFECTS
from offroad_env.physics.records import Vehicle

__all__ = ["NEVER_NEGATIVE", "is_physical"]

#: Effects that are absent from the nominal model, so that less than none would be the opposite force: soil
#: never pulls a wheel along, friction never drives, and nothing answers early.
NEVER_NEGATIVE = (
    "bulldozing", "coulomb_friction", "front_bulldozing", "grouser_thrust", "pose_delay", "rut_drag",
    "slip_sinkage", "steer_delay", "steer_lag",
)  # fmt: skip
#: Largest size, in largest believable ones: what is believed is a judgement, so a factor is left to it.
_MOST = 3.0


def is_physical(effect: str, low: float, high: float, vehicle: Vehicle) -> bool:
    """Whether an interval of sizes holds one that physics allows.

    Parameters
    ----------
    low, high
        Ends of the interval, in the unit of the effect's size.
    """
    most = _MOST * EFFECTS[effect].plausible(vehicle)
    return high >= (0.0 if effect in NEVER_NEGATIVE else -most) and low <= most
