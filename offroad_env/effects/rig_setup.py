"""Setup of a wheel rig: a wheel, its soil, and the measurement errors of the gauges."""

from __future__ import annotations

from dataclasses import dataclass, field

from offroad_env.effects.protocol import Setup

__all__ = ["RigErrors", "RigSetup"]


@dataclass(frozen=True, kw_only=True)
class RigErrors:
    """What a rig's gauges add to the quantities that they measure; the defaults change nothing."""

    sinkage: float = 0.0  #: zero of the sinkage gauge [m]
    drawbar: float = 0.0  #: force along the wheel that is not the soil's [N]
    side_force: float = 0.0  #: force across the wheel that is not the soil's [N]
    load_scale: float = 1.0  #: true load over the load in the log [-]


@dataclass(frozen=True, kw_only=True)
class RigSetup(Setup):
    """One wheel on a carriage; of the plant's vehicle only the wheel matters."""

    rig: RigErrors = field(default_factory=RigErrors)

    @property
    def model(self) -> str:
        """ "rig", whichever preset's wheel it is."""
        return "rig"
