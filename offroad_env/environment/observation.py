"""The observation, written by one kernel: layout, bounds, clipping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from estimators.filters.online_soil_belief import BELIEF_VECTOR, LONGEST
from offroad_env.physics._jit import kernel
from offroad_env.physics.path_geometry import PathTable, preview, project

__all__ = [
    "BELIEF_BOUNDS",
    "PREVIEW",
    "SHOWN",
    "WHOLE_SOIL",
    "Layout",
    "Measured",
    "SeenPose",
    "Window",
    "write_observation",
]

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
#: Lowest and highest values of `BELIEF_VECTOR`: limits of a vehicle of up to some tonnes, n, the flag. A pull
#: can be negative.
_BELIEF_HIGH = {"lateral": 100.0, "pull": 1e6, "pull_slip": 1.0, "resistance": 1e6, "sinkage": 10.0}
_BELIEF_HIGH |= {"stopping": 1e4, "n": 3.0, "stuck": 1.0, "stop_in": LONGEST, "valid": 1.0}
_belief_high = np.array([_BELIEF_HIGH[name.removesuffix("_sd")] for name in BELIEF_VECTOR], dtype=np.float32)
BELIEF_BOUNDS = np.stack([np.where(np.array(BELIEF_VECTOR) == "pull", -_belief_high, 0.0), _belief_high])
BELIEF_BOUNDS = BELIEF_BOUNDS.astype(np.float32)


#: Values of ``terrain_info`` that show what the soil holds, as `BELIEF_VECTOR` has it.
WHOLE_SOIL = ("belief", "limits")


class SeenPose(NamedTuple):
    """Pose by the navigation filter, and where its projection on the path is searched from."""

    X: float  #: [m]
    Y: float  #: [m]
    yaw: float  #: [rad]
    speed: float  #: [m/s]
    hint: int  #: node of the path, from the last call


class Measured(NamedTuple):
    """Numbers that go into the observation as they are."""

    rim_front: float  #: rim speed [m/s]
    rim_rear: float  #: rim speed [m/s]
    steer: float  #: last steering command [rad]
    drive: float  #: last drive command [-]
    target_speed: float  #: 0 = as fast as possible [m/s]
    n: float  #: sinkage exponent [-]
    n_sd: float  #: its standard deviation [-]
    valid: float  #: 1 = the estimate may be used


class Window(NamedTuple):
    """How far the observation reaches, and its limits."""

    distances: np.ndarray  #: (K,) at which the curvature ahead is observed [m]
    bounds: np.ndarray  #: (2, SHOWN) lowest and highest values
    length: float  #: of the path [m]


@kernel
def write_observation(
    path: PathTable,
    pose: SeenPose,
    samples: np.ndarray,
    measured: Measured,
    window: Window,
    out: np.ndarray,
) -> int:
    """Fill the flat observation ``out`` (SHOWN,) float32 and clip it; returns the next hint.

    ``samples`` (S, CHANNELS) are those of the sensors in this period.
    """
    for i in range(_MOTION):
        total = 0.0
        for j in range(samples.shape[0]):
            total += samples[j, i]
        out[i] = total / samples.shape[0]
    out[_MOTION] = pose.speed
    out[_MOTION + 1], out[_MOTION + 2] = measured.rim_front, measured.rim_rear
    out[_MOTION + 3], out[_MOTION + 4] = measured.steer, measured.drive
    s, error, path_yaw, _, hint = project(path, pose.X, pose.Y, pose.hint)
    turn = (pose.yaw - path_yaw) / (2.0 * math.pi)
    out[_PATH] = error
    out[_PATH + 1] = 2.0 * math.pi * (turn - round(turn))
    out[_PATH + 2] = measured.target_speed
    ahead = np.empty((window.distances.shape[0], 2))
    preview(path, s, window.distances, ahead)
    for i in range(window.distances.shape[0]):
        out[_PATH + 3 + i] = ahead[i, 0]
    out[_TERRAIN - 1] = window.length - s
    out[_TERRAIN], out[_TERRAIN + 1], out[_TERRAIN + 2] = measured.n, measured.n_sd, measured.valid
    for i in range(out.shape[0]):
        out[i] = min(max(out[i], window.bounds[0, i]), window.bounds[1, i])
    return hint


class Layout:
    """Bounds and keys of the observation of one environment.

    Parameters
    ----------
    steer_max : largest steering angle [rad]
    terrain_info : what the key ``terrain`` shows, see `OffroadBekkerEnv`
    """

    def __init__(self, steer_max: float, *, terrain_info: str) -> None:
        self._belief, self.steer_max = terrain_info in WHOLE_SOIL, steer_max
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
        if terrain_info in ("estimate", "truth"):
            self.slices["terrain"] = slice(_TERRAIN, SHOWN)

    def space(self) -> spaces.Dict:
        """The observation space."""
        parts: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(self.bounds[0, part], self.bounds[1, part]) for key, part in self.slices.items()
        }
        if self._belief:
            parts["terrain"] = spaces.Box(*BELIEF_BOUNDS)
        return spaces.Dict(parts)

    def split(self, flat: np.ndarray, beliefs: Sequence[np.ndarray] = ()) -> dict[str, np.ndarray]:
        """The observation as the agent gets it: new arrays that share no memory, of one row or of many.

        ``beliefs`` : a vector of `BELIEF_VECTOR` for each row, where beliefs about the soil are shown.
        """
        found = {key: flat[..., part].copy() for key, part in self.slices.items()}
        if self._belief:
            rows = np.array(beliefs, dtype=np.float32).reshape(*flat.shape[:-1], len(BELIEF_VECTOR))
            found["terrain"] = np.clip(rows, *BELIEF_BOUNDS)
        return found
