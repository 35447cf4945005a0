"""The steering acts later than the log says."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(
        setup, inputs=replace(setup.inputs, steer_delay=setup.inputs.steer_delay + values["delay"])
    )


EFFECT = Effect(
    id="steer_delay",
    family="timing",
    hook="actuator",
    size=Parameter(name="delay", unit="s", low=-0.5, high=2.0),
    plausible=lambda vehicle: 0.3,
    sentence="the steering acts {size} later than logged",
    look_alikes=("steer_lag", "clock_offset"),
    separated_by="steps of the steering at constant speed",
    change=_change,
)
