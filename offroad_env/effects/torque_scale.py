"""The drive gives another force than logged."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(
        setup, inputs=replace(setup.inputs, drive_scale=setup.inputs.drive_scale + values["share"])
    )


EFFECT = Effect(
    id="torque_scale",
    family="longitudinal",
    hook="actuator",
    size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
    plausible=lambda vehicle: 0.3,
    sentence="drive and brake give {size} more than logged",
    look_alikes=("payload", "rolling_resistance"),
    separated_by="a pull against a load cell",
    needs=(("torque_f", "torque_r", "drive_force"),),
    change=_change,
)
