"""The clock of the sensors is late against that of the inputs."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    inputs = setup.inputs
    return replace(setup, inputs=replace(inputs, delay=inputs.delay + values["delay"]))


EFFECT = Effect(
    id="clock_offset",
    family="timing",
    hook="actuator",
    size=Parameter(name="delay", unit="s", low=-0.5, high=2.0),
    plausible=lambda vehicle: 0.3,
    sentence="the sensors lag {size} behind all inputs",
    look_alikes=("steer_delay", "steer_lag"),
    separated_by="steps of the drive, which a steering delay does not touch",
    change=_change,
)
