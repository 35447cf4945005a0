"""The zero of a rig's sinkage gauge is off."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Values
from offroad_env.effects.rig_setup import RigSetup

__all__ = ["EFFECT"]


def _change(setup: RigSetup, values: Values) -> RigSetup:
    return setup.with_rig(sinkage=setup.rig.sinkage + values["depth"])


EFFECT = Effect(
    id="sinkage_offset",
    family="sensor",
    hook="sensor",
    size=Parameter(name="depth", unit="m", low=-0.5, high=0.5),
    plausible=lambda vehicle: 0.1 * vehicle.r,
    sentence="the sinkage gauge reads {size} too much",
    look_alikes=("soil_stiffness", "load_scale"),
    separated_by="trials at several loads",
    models=("rig",),
    sensors_only=True,
    change=_change,
)
