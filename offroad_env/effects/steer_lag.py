"""The steering follows its command like a first-order lag."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    lag = max(setup.inputs.steer_lag + values["time"], 0.0)
    return replace(setup, inputs=replace(setup.inputs, steer_lag=lag))


EFFECT = Effect(
    id="steer_lag",
    family="timing",
    hook="actuator",
    size=Parameter(name="time", unit="s", low=-0.02, high=3.0),
    plausible=lambda vehicle: 0.4,
    sentence="the steering follows its command with a lag of {size}",
    look_alikes=("steer_delay",),
    separated_by="steps of the steering: a lag rounds them, a delay only moves them",
    change=_change,
)
