"""Inputs: how the command that acts differs from the one in the log, one row an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from offroad_env.effects.protocol import Change, Effect, Inputs, Parameter, Setup

__all__ = ["TABLE"]

_row = partial(Effect, hook="actuator")


def _of_inputs(changed: Callable[[Inputs, float], Inputs]) -> Change:
    """A change of the inputs alone, from them and the size."""

    def change(setup: Setup, size: float) -> Setup:
        return replace(setup, inputs=changed(setup.inputs, size))

    return change


TABLE = (
    _row(
        id="clock_offset",
        family="timing",
        size=Parameter(name="delay", unit="s", low=-0.5, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the sensors lag {size} behind all inputs",
        source="definition: offset of the sensors' clock against that of the inputs",
        look_alikes=("steer_delay", "steer_lag"),
        separated_by="steps of the drive, which a steering delay does not touch",
        change=_of_inputs(lambda inputs, delay: replace(inputs, delay=inputs.delay + delay)),
    ),
    _row(
        id="steer_delay",
        family="timing",
        size=Parameter(name="delay", unit="s", low=-0.5, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the steering acts {size} later than logged",
        source="definition: dead time of the steering actuator; below zero, stamps that are late",
        look_alikes=("steer_lag", "clock_offset"),
        separated_by="steps of the steering at constant speed",
        change=_of_inputs(lambda inputs, delay: replace(inputs, steer_delay=inputs.steer_delay + delay)),
    ),
    _row(
        id="steer_lag",
        family="timing",
        size=Parameter(name="time", unit="s", low=-0.02, high=3.0),
        plausible=lambda vehicle: 0.4,
        sentence="the steering follows its command with a lag of {size}",
        source="definition: time constant of a first-order lag of the steering actuator",
        look_alikes=("steer_delay",),
        separated_by="steps of the steering: a lag rounds them, a delay only moves them",
        change=_of_inputs(lambda inputs, time: replace(inputs, steer_lag=max(inputs.steer_lag + time, 0.0))),
    ),
    _row(
        id="steer_gain",
        family="steering",
        size=Parameter(name="share", unit="-", low=-0.8, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the wheels turn {size} of the logged angle further",
        source="definition: scale factor of the steering angle",
        look_alikes=("shear_modulus",),
        separated_by="circles at walking pace",
        change=_of_inputs(lambda inputs, share: replace(inputs, steer_gain=inputs.steer_gain + share)),
    ),
    _row(
        id="steer_offset",
        family="steering",
        size=Parameter(name="angle", unit="rad", low=-0.5, high=0.5),
        plausible=lambda vehicle: 0.08,
        sentence="the wheels point {size} further left than logged",
        source="definition: zero offset of the steering angle",
        look_alikes=("yaw_moment", "gyro_bias_yaw"),
        separated_by="straight driving both ways, slow and fast",
        change=_of_inputs(lambda inputs, angle: replace(inputs, steer_offset=inputs.steer_offset + angle)),
    ),
    _row(
        id="torque_scale",
        family="longitudinal",
        size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="drive and brake give {size} more than logged",
        source="definition: scale factor of drive torque, brake torque and drive force",
        look_alikes=("payload", "rolling_resistance"),
        separated_by="a pull against a load cell",
        needs=(("torque_f", "torque_r", "drive_force"),),
        change=_of_inputs(
            lambda inputs, share: replace(
                inputs, drive_scale=inputs.drive_scale + share, brake_scale=inputs.brake_scale + share
            )
        ),
    ),
    _row(
        id="drive_scale",
        family="longitudinal",
        size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the drive gives {size} more than logged",
        source="definition: scale factor of drive torque and forward drive force",
        look_alikes=("torque_scale", "payload", "rolling_resistance"),
        separated_by="a pull against a load cell; from `torque_scale`, braking",
        needs=(("torque_f", "torque_r", "drive_force"),),
        change=_of_inputs(lambda inputs, share: replace(inputs, drive_scale=inputs.drive_scale + share)),
    ),
    _row(
        id="brake_scale",
        family="longitudinal",
        size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the brakes give {size} more than logged",
        source="definition: scale factor of brake torque and backward drive force",
        look_alikes=("torque_scale", "rolling_resistance"),
        separated_by="braking hard, and coasting",
        needs=(("torque_f", "torque_r", "drive_force"),),
        change=_of_inputs(lambda inputs, share: replace(inputs, brake_scale=inputs.brake_scale + share)),
    ),
)
