"""A log as sound sensors and exact inputs would have written it, if the effects of a model are right.

So a model with effects is compared by open-loop predictions with models that have other laws: what effects
change in the plant is simulated, what they change in inputs and sensors is undone in the log.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimators.logs.log import Log
from offroad_env.effects.protocol import Setup
from offroad_env.physics.imu import ImuMount

__all__ = ["corrected_log"]

_ACCELERATIONS, _INPUTS = ("a_x", "a_y", "a_z"), ("steer", "drive_force", "torque_f", "torque_r")
_POSE = ("x", "y", "yaw", "v_x", "v_y", "speed", "course")
_ANGLES = ("yaw", "course")


def corrected_log(log: Log, setup: Setup, stated: Setup) -> Log:
    """The log without the errors of inputs and sensors that ``setup`` has beyond the ``stated`` one."""
    found = dict(log.channels)
    for name in _INPUTS:
        if name in found:
            found[name] = _input(log, name, setup)
    found |= _inertial(log, setup, stated.mount)
    errors = setup.errors
    for name, split in (("omega_f", errors.wheel_split), ("omega_r", -errors.wheel_split)):
        if name in found:
            scaled = found[name] / (errors.wheel_scale + split)
            found[name] = _moved(log.times, scaled, errors.wheel_delay)
    late = errors.pose_delay - stated.errors.pose_delay
    for name in _POSE:
        if name in found and late != 0.0:
            found[name] = _moved(log.times, found[name], late, angle=name in _ANGLES)
    position: tuple[float, float, float] = tuple(float(value) for value in setup.mount.lever)  # type: ignore[assignment]
    config = replace(log.config, imu=replace(log.imu, position=position))
    return replace(log, channels=_of_the_centre(found, log.times, errors.antenna), config=config)


def _input(log: Log, name: str, setup: Setup) -> np.ndarray:
    """An input as it acts, on the rows of the log."""
    inputs, (times, values) = setup.inputs, log.samples(name)
    delay = inputs.delay + (inputs.steer_delay if name == "steer" else 0.0)
    asked = log.times - delay
    if log.config.hold == "linear":
        acting = np.interp(asked, times, values)
    else:
        # Rows are dense enough that the mean over the row stands for a change within it.
        acting = _held_mean(times, values, asked, float(np.median(np.diff(log.times))))
    if name != "steer":
        return inputs.acting(acting)
    return _lagged(log.times, inputs.steer_gain * acting + inputs.steer_offset, inputs.steer_lag)


def _held_mean(times: np.ndarray, values: np.ndarray, asked: np.ndarray, span: float) -> np.ndarray:
    """Mean of held samples over ``span`` [s] after each instant."""
    edges = np.concatenate([[min(times[0], asked[0]) - 1.0], times, [max(times[-1], asked[-1]) + 1.0 + span]])
    held = np.concatenate([values[:1], values])
    integral = np.concatenate([[0.0], np.cumsum(held * np.diff(edges))])
    ends = np.interp(asked + span, edges, integral)
    return np.asarray((ends - np.interp(asked, edges, integral)) / span)


def _lagged(times: np.ndarray, values: np.ndarray, lag: float) -> np.ndarray:
    """After a first-order lag [s]."""
    if lag <= 0.0:
        return values
    found, state = np.empty(len(values)), float(values[0])
    spans = np.append(np.diff(times), 0.0)
    for i, span in enumerate(spans):
        found[i] = state
        state += (values[i] - state) * (1.0 - math.exp(-float(span) / lag))
    return found


def _moved(times: np.ndarray, values: np.ndarray, age: float, *, angle: bool = False) -> np.ndarray:
    """Samples that are ``age`` [s] old, put back to their instants; empty rows stay empty."""
    known = ~np.isnan(values)
    if age == 0.0 or known.sum() < 2:
        return values
    found = np.full(len(values), math.nan)
    own = np.unwrap(values[known]) if angle else values[known]
    found[known] = np.interp(times[known] + age, times[known], own)
    return found


def _inertial(log: Log, setup: Setup, stated: ImuMount) -> dict[str, np.ndarray]:
    """Channels of the IMU without offsets, scales and misalignment."""
    errors, found = setup.errors, {}
    rows = dict(zip((*_ACCELERATIONS, "pitch_rate", "yaw_rate"), errors.offset, strict=True))
    for name, offset in rows.items():
        if name in log.channels:
            scale = errors.accel_scale if name in _ACCELERATIONS else 1.0
            scale *= 1.0 + errors.lean if name == "a_y" else 1.0
            found[name] = (log.channels[name] - offset) / scale
    turn = stated.rotation.T @ setup.mount.rotation
    if np.allclose(turn, np.eye(3), atol=1e-12) or not set(_ACCELERATIONS) <= set(found):
        return found
    turned = turn @ np.stack([found[name] for name in _ACCELERATIONS])
    return found | dict(zip(_ACCELERATIONS, turned, strict=True))


def _of_the_centre(channels: dict[str, np.ndarray], times: np.ndarray, ahead: float) -> dict[str, np.ndarray]:
    """Positions of the centre of gravity from those of an antenna ``ahead`` of it [m]."""
    heading = channels.get("yaw", channels.get("course"))
    if ahead == 0.0 or heading is None or "x" not in channels or "y" not in channels:
        return channels
    known = ~np.isnan(heading)
    if known.sum() < 2:
        return channels
    angle = np.interp(times, times[known], np.unwrap(heading[known]))
    return channels | {
        "x": channels["x"] - ahead * np.cos(angle),
        "y": channels["y"] - ahead * np.sin(angle),
    }
