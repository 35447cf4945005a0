"""Gauges of a wheel rig: what they add to the quantity that they measure, one row an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from offroad_env.effects.protocol import Change, Effect, Parameter, Setup
from offroad_env.effects.rig_setup import RigErrors, RigSetup
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY

__all__ = ["TABLE"]

_row = partial(Effect, family="sensor", hook="sensor", models=("rig",))


def _of_gauges(changed: Callable[[RigErrors, float], RigErrors]) -> Change:
    """A change of the rig's measurement errors alone, from them and the size."""

    def change(setup: Setup, size: float) -> Setup:
        if not isinstance(setup, RigSetup):
            raise InvalidParameter(f"a {setup.model} vehicle has no gauges of a rig; expected a RigSetup")
        return replace(setup, rig=changed(setup.rig, size))

    return change


TABLE = (
    _row(
        id="drawbar_offset",
        size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
        plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY / 4.0,
        sentence="the force along the wheel reads {size} too much",
        source="definition: zero offset of a force gauge, and the carriage's own resistance",
        look_alikes=("rut_drag", "front_bulldozing"),
        separated_by="a trial with the wheel lifted out of the soil",
        sensors_only=True,
        change=_of_gauges(lambda rig, force: replace(rig, drawbar=rig.drawbar + force)),
    ),
    _row(
        id="load_scale",
        size=Parameter(name="share", unit="-", low=-0.9, high=5.0),
        plausible=lambda vehicle: 0.1,
        sentence="the load is {size} of its value larger than logged",
        source="definition: scale factor of the load cell",
        look_alikes=("soil_stiffness", "sinkage_offset"),
        separated_by="the load cell on a known weight",
        change=_of_gauges(lambda rig, share: replace(rig, load_scale=rig.load_scale * (1.0 + share))),
    ),
    _row(
        id="side_force_offset",
        size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
        plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY / 4.0,
        sentence="the force across the wheel reads {size} too much",
        source="definition: zero offset of a force gauge",
        look_alikes=("bulldozing",),
        separated_by="trials at slip angles of both signs",
        sensors_only=True,
        change=_of_gauges(lambda rig, force: replace(rig, side_force=rig.side_force + force)),
    ),
    _row(
        id="sinkage_offset",
        size=Parameter(name="depth", unit="m", low=-0.5, high=0.5),
        plausible=lambda vehicle: 0.1 * vehicle.r,
        sentence="the sinkage gauge reads {size} too much",
        source="definition: zero offset of the sinkage gauge",
        look_alikes=("soil_stiffness", "load_scale"),
        separated_by="trials at several loads",
        sensors_only=True,
        change=_of_gauges(lambda rig, depth: replace(rig, sinkage=rig.sinkage + depth)),
    ),
)
