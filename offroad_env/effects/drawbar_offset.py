"""A rig's force along the wheel holds something that is not the soil's."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Values
from offroad_env.effects.rig_setup import RigSetup
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


def _change(setup: RigSetup, values: Values) -> RigSetup:
    return setup.with_rig(drawbar=setup.rig.drawbar + values["force"])


EFFECT = Effect(
    id="drawbar_offset",
    family="sensor",
    hook="sensor",
    size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
    plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY / 4.0,
    sentence="the force along the wheel reads {size} too much",
    look_alikes=("rut_drag", "front_bulldozing"),
    separated_by="a trial with the wheel lifted out of the soil",
    models=("rig",),
    sensors_only=True,
    change=_change,
)
