"""A rig's force across the wheel holds something that is not the soil's."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Values
from offroad_env.effects.rig_setup import RigSetup
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


def _change(setup: RigSetup, values: Values) -> RigSetup:
    return setup.with_rig(side_force=setup.rig.side_force + values["force"])


EFFECT = Effect(
    id="side_force_offset",
    family="sensor",
    hook="sensor",
    size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
    plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY / 4.0,
    sentence="the force across the wheel reads {size} too much",
    look_alikes=("bulldozing",),
    separated_by="trials at slip angles of both signs",
    models=("rig",),
    sensors_only=True,
    change=_change,
)
