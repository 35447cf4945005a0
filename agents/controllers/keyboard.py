"""A person at the keyboard, in the window that shows the drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.protocol import Observation
from offroad_env.errors import OffroadError
from offroad_env.rendering.canvas import import_pygame

__all__ = ["KeyboardAgent", "Keys"]

#: Time from straight ahead to full lock, and from coasting to full drive or brake [s].
_TURNING, _PRESSING = 0.8, 0.5
#: A control period [s].
_STEP = 0.02


class Keys(NamedTuple):
    """Which way the keys point."""

    left: bool = False
    right: bool = False
    drive: bool = False
    brake: bool = False
    stop: bool = False  #: the driver ends the drive


class KeyboardAgent:
    """Drives by the arrow keys, or W, A, S, D; space brakes, escape ends the drive.

    Steering and drive follow the keys at the pace of a hand and a foot, and go back when they are released.

    Parameters
    ----------
    keys
        What is pressed now; default: the keys of the window.
    """

    def __init__(self, keys: Callable[[], Keys] | None = None) -> None:
        self._keys = _pressed if keys is None else keys
        self._steer = self._drive = 0.0
        self.stopped = False  #: whether the driver has ended the drive, or closed the window

    def reset(self, briefing: Any) -> None:
        """Nothing is pressed yet."""
        self._steer = self._drive = 0.0
        self.stopped = False

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,) of the keys: steering, left positive; drive, or brake negative."""
        keys = self._keys()
        self.stopped = self.stopped or keys.stop
        self._steer = _towards(self._steer, float(keys.left) - float(keys.right), _STEP / _TURNING)
        wanted = -1.0 if keys.brake else float(keys.drive)
        self._drive = _towards(self._drive, wanted, _STEP / _PRESSING)
        return np.array([self._steer, self._drive], dtype=np.float32)


def _towards(value: float, wanted: float, step: float) -> float:
    return min(value + step, wanted) if wanted > value else max(value - step, wanted)


def _pressed() -> Keys:
    """The keys of the window; without a window the drive is over.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        Without pygame-ce.
    OffroadError
        If a window was never opened.
    """
    pygame: Any = import_pygame()
    if not pygame.display.get_init():
        return Keys(stop=True)
    if pygame.display.get_surface() is None:
        raise OffroadError("the keyboard needs a window: offroad drive --agent keyboard opens one")
    down = pygame.key.get_pressed()
    return Keys(
        left=down[pygame.K_LEFT] or down[pygame.K_a],
        right=down[pygame.K_RIGHT] or down[pygame.K_d],
        drive=down[pygame.K_UP] or down[pygame.K_w],
        brake=down[pygame.K_DOWN] or down[pygame.K_s] or down[pygame.K_SPACE],
        stop=down[pygame.K_ESCAPE],
    )
