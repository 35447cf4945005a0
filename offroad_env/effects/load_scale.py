"""A rig's wheel carries another load than the log says."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Values
from offroad_env.effects.rig_setup import RigSetup

__all__ = ["EFFECT"]


def _change(setup: RigSetup, values: Values) -> RigSetup:
    return setup.with_rig(load_scale=setup.rig.load_scale * (1.0 + values["share"]))


EFFECT = Effect(
    id="load_scale",
    family="sensor",
    hook="sensor",
    size=Parameter(name="share", unit="-", low=-0.9, high=5.0),
    plausible=lambda vehicle: 0.1,
    sentence="the load is {size} of its value larger than the log says",
    look_alikes=("soil_stiffness", "sinkage_offset"),
    separated_by="the load cell on a known weight",
    models=("rig",),
    change=_change,
)
