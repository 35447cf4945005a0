"""What the agent is shown, written by one kernel: layout, bounds, clipping."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from offroad_env.physics._jit import kernel
from offroad_env.physics.path_kernels import preview, project

__all__ = ["PREVIEW", "SHOWN", "Layout", "write_observation"]

#: How far ahead the curvature of the path is observed [m].
PREVIEW = (0.0, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0)

# Where the parts stand in the flat observation.
_MOTION, _PATH = 5, 10
_TERRAIN = _PATH + 4 + len(PREVIEW)
#: Length of the flat observation.
SHOWN = _TERRAIN + 3

#: Bounds: what the sensors saturate at, and what a drive can bring.
_IMU_HIGH = (100.0, 100.0, 100.0, 10.0, 10.0)
_SPEED_HIGH = 60.0
_ERROR_HIGH = 50.0
_CURVATURE_HIGH = 2.0
_DISTANCE_HIGH = 1e3


@kernel
def write_observation(path, seen, samples, measured, shown, out):
    """Fill the flat observation ``out`` (float32) and clip it.

    ``seen`` = (X, Y, yaw, speed, index): pose by the navigation filter, hint for the projection;
    ``samples`` (S, CHANNELS) of the period's sensors; ``measured`` = (rim speed front, rear [m/s],
    steering command [rad], drive command, target speed [m/s], n, sd of n, valid); ``shown`` =
    (preview distances [m], bounds (2, size), length of the path [m]). Returns the next hint.
    """
    distances, bounds, length = shown
    X, Y, yaw, speed, index = seen
    for i in range(_MOTION):
        total = 0.0
        for j in range(samples.shape[0]):
            total += samples[j, i]
        out[i] = total / samples.shape[0]
    out[_MOTION] = speed
    for i in range(4):
        out[_MOTION + 1 + i] = measured[i]
    s, error, path_yaw, _, index = project(path, X, Y, index)
    turn = (yaw - path_yaw) / (2.0 * math.pi)
    out[_PATH] = error
    out[_PATH + 1] = 2.0 * math.pi * (turn - round(turn))
    out[_PATH + 2] = measured[4]
    ahead = np.empty((distances.shape[0], 2))
    preview(path, s, distances, ahead)
    for i in range(distances.shape[0]):
        out[_PATH + 3 + i] = ahead[i, 0]
    out[_TERRAIN - 1] = length - s
    for i in range(3):
        out[_TERRAIN + i] = measured[5 + i]
    for i in range(out.shape[0]):
        out[i] = min(max(out[i], bounds[0, i]), bounds[1, i])
    return index


class Layout:
    """Bounds and keys of the observation of one environment.

    Parameters
    ----------
    steer_max : largest steering angle [rad]
    terrain : whether the key ``terrain`` is shown
    """

    def __init__(self, steer_max: float, *, terrain: bool) -> None:
        speeds = (_SPEED_HIGH,) * 3
        high = np.array(
            [
                *_IMU_HIGH,
                *speeds,
                steer_max,
                1.0,
                _ERROR_HIGH,
                math.pi,
                _SPEED_HIGH,
                *(_CURVATURE_HIGH,) * len(PREVIEW),
                _DISTANCE_HIGH,
                3.0,
                1.0,
                1.0,
            ]
        )
        low = -high
        low[_PATH + 2] = 0.0
        low[_TERRAIN:] = 0.0
        self.bounds = np.stack([low, high]).astype(np.float32)
        self.slices = {
            "imu": slice(0, _MOTION),
            "motion": slice(_MOTION, _PATH),
            "path": slice(_PATH, _TERRAIN),
        }
        if terrain:
            self.slices["terrain"] = slice(_TERRAIN, SHOWN)

    def space(self) -> spaces.Dict:
        """The observation space."""
        return spaces.Dict(
            {key: spaces.Box(self.bounds[0, part], self.bounds[1, part]) for key, part in self.slices.items()}
        )

    def split(self, flat: np.ndarray) -> dict[str, Any]:
        """The observation as the agent gets it: new arrays that share no memory, of one row or of many."""
        return {key: flat[..., part].copy() for key, part in self.slices.items()}
