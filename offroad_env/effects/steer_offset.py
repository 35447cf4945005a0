"""The wheels are not straight when the steering says so."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(
        setup, inputs=replace(setup.inputs, steer_offset=setup.inputs.steer_offset + values["angle"])
    )


EFFECT = Effect(
    id="steer_offset",
    family="steering",
    hook="actuator",
    size=Parameter(name="angle", unit="rad", low=-0.5, high=0.5),
    plausible=lambda vehicle: 0.08,
    sentence="the wheels point {size} further left than the steering says",
    look_alikes=("yaw_moment", "gyro_bias_yaw"),
    separated_by="straight driving both ways, slow and fast",
    change=_change,
)
