"""The accelerometers have another scale."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(
        setup, errors=replace(setup.errors, accel_scale=setup.errors.accel_scale + values["share"])
    )


EFFECT = Effect(
    id="accel_scale",
    family="sensor",
    hook="sensor",
    size=Parameter(name="share", unit="-", low=-0.9, high=3.0),
    plausible=lambda vehicle: 0.1,
    sentence="the accelerometers read {size} of the true value too much",
    look_alikes=("accel_bias_z",),
    separated_by="standing still on each of its sides",
    sensors_only=True,
    change=_change,
)
