"""The wheels turn more than the steering says."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    inputs = setup.inputs
    return replace(setup, inputs=replace(inputs, steer_gain=inputs.steer_gain + values["share"]))


EFFECT = Effect(
    id="steer_gain",
    family="steering",
    hook="actuator",
    size=Parameter(name="share", unit="-", low=-0.8, high=2.0),
    plausible=lambda vehicle: 0.3,
    sentence="the wheels turn {size} of the logged angle further",
    look_alikes=("shear_modulus",),
    separated_by="circles at walking pace",
    change=_change,
)
