"""The wheel speeds are referred to a wrong radius."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(
        setup, errors=replace(setup.errors, wheel_scale=setup.errors.wheel_scale + values["share"])
    )


EFFECT = Effect(
    id="wheel_radius_scale",
    family="sensor",
    hook="sensor",
    size=Parameter(name="share", unit="-", low=-0.5, high=1.0),
    plausible=lambda vehicle: 0.1,
    sentence="the wheel speeds read {size} of the true value too much",
    look_alikes=(),
    separated_by="towing the vehicle with free wheels past a satellite receiver",
    needs=(("omega_f", "omega_r"),),
    sensors_only=True,
    change=_change,
)
