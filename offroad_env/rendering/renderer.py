"""The whole picture, in a window or as an array."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import Any
from weakref import WeakSet

import numpy as np
from gymnasium.error import Error

from offroad_env.environment.snapshot import Snapshot
from offroad_env.errors import InvalidParameter
from offroad_env.rendering.above import CourseDrawing, MapView, Overview
from offroad_env.rendering.canvas import Canvas, import_pygame
from offroad_env.rendering.charts import Charts
from offroad_env.rendering.history import History
from offroad_env.rendering.side import SideView
from offroad_env.rendering.style import BAD, FRAME_SIZE, GOOD, HEADER, MUTED, PAGE, PANEL

__all__ = ["RENDER_MODES", "Renderer"]

RENDER_MODES = ("human", "rgb_array")

_ENDINGS = {
    "goal": "GOAL REACHED",
    "left_corridor": "LEFT THE CORRIDOR",
    "overran": "CROSSED THE LINE",
    "too_rough": "SHAKEN TOO MUCH",
    "rollover": "ROLLED OVER",
    "immobilised": "IMMOBILISED",
    "diverged": "SIMULATION DIVERGED",
}
_OBSERVED = {
    "none": "without n",
    "estimate": "with the estimate of n",
    "truth": "with the true n",
    "belief": "with the belief about the soil",
    "limits": "with what the soil truly holds",
}


class Renderer:
    """Draws an environment; made by ``OffroadBekkerEnv.render``.

    Parameters
    ----------
    mode : {"human", "rgb_array"}
        A window on the screen, or an array; an array needs no screen.
    fps
        Pictures a second that a window waits for [1/s].

    Raises
    ------
    InvalidParameter
        For another mode, or an ``fps`` that is not positive.
    """

    def __init__(self, mode: str, fps: float = 50.0) -> None:
        if mode not in RENDER_MODES:
            raise InvalidParameter(f"mode must be one of {', '.join(RENDER_MODES)}, got {mode!r}")
        if not 0.0 < fps < math.inf:
            raise InvalidParameter(f"fps must be a positive number of pictures a second, got {fps!r}")
        self.mode, self.fps = mode, fps
        self.closed_by_user = False  #: the window was closed: nothing is drawn any more
        self._panels: _Panels | None = None
        self._window: _Window | None = None

    def __reduce__(self) -> tuple[type[Renderer], tuple[str, float]]:
        # Surfaces and windows cannot be copied: a copied or pickled environment starts with blank ones.
        return Renderer, (self.mode, self.fps)

    def draw(self, snapshot: Snapshot) -> np.ndarray | None:
        """One picture of the environment at the moment of ``snapshot``.

        Returns
        -------
        (720, 1280, 3) uint8 array, new with every call; None with mode "human".

        Raises
        ------
        gymnasium.error.DependencyNotInstalled
            Without pygame-ce.
        gymnasium.error.Error
            With mode "human" where no window can be opened.
        """
        if self.closed_by_user:
            return None
        if self._panels is None:
            pygame = import_pygame()
            self._window = _Window(pygame) if self.mode == "human" else None
            self._panels = _Panels(pygame)
        self._panels.draw(snapshot)
        if self._window is None:
            return self._panels.canvas.pixels()
        if not self._window.show(self._panels.canvas, self.fps):
            self.close()
            self.closed_by_user = True
        return None

    def close(self) -> None:
        """Close the window, if there is one, and forget everything drawn."""
        if self._window is not None:
            self._window.close()
        self._window = self._panels = None


#: Drivers of SDL whose windows nobody sees.
_NO_SCREEN = ("offscreen", "dummy")


class _Window:
    """A window on the screen: pygame has one display, in which all environments of a process draw."""

    def __init__(self, pygame: Any) -> None:
        self.pygame = pygame
        try:
            pygame.display.init()
            # Without a screen SDL draws into memory, unless somebody asks for that, as tests do.
            if pygame.display.get_driver() in _NO_SCREEN and "SDL_VIDEODRIVER" not in os.environ:
                pygame.display.quit()
                raise pygame.error("there is no screen")
            self._surface = pygame.display.set_mode(FRAME_SIZE)
        except pygame.error as error:
            raise Error(
                f'no window can be opened ({error}): render_mode="rgb_array" needs no screen'
            ) from error
        pygame.display.set_caption("OffroadBekker")
        self._clock = pygame.time.Clock()
        _OPEN.add(self)

    def show(self, canvas: Canvas, fps: float) -> bool:
        """Show a picture and wait for its time; False when the user has closed the window.

        So it is for everybody who draws in it: the others find that the display is gone.
        """
        try:
            if any(event.type == self.pygame.QUIT for event in self.pygame.event.get()):
                self.pygame.display.quit()
                return False
            self._surface.blit(canvas.surface, (0, 0))
            self.pygame.display.flip()
        except self.pygame.error:
            return False
        self._clock.tick(fps)
        return True

    def close(self) -> None:
        """Leave the window; the last one to do so removes it from the screen."""
        _OPEN.discard(self)
        if not _OPEN:
            self.pygame.display.quit()


#: Who draws on the display. Weak, since an environment that was dropped without `close` needs it no more.
_OPEN: WeakSet[_Window] = WeakSet()


class _Panels:
    """The panels of the picture, and the history that they show."""

    def __init__(self, pygame: Any) -> None:
        self.canvas = canvas = Canvas(pygame, FRAME_SIZE)
        self._map, self._overview = MapView(canvas), Overview(canvas)
        self._side, self._charts = SideView(canvas), Charts(canvas)
        self._last: Snapshot | None = None

    def draw(self, snapshot: Snapshot) -> None:
        """The whole picture."""
        snapshot = self._remember(snapshot)
        self.canvas.box((0, 0, *FRAME_SIZE), PAGE)
        self._map.draw(self._course, snapshot, self._history)
        self._overview.draw(self._course, snapshot)
        self._side.draw(snapshot)
        self._charts.draw(snapshot, self._history)
        self._write_header(snapshot)

    def _remember(self, snapshot: Snapshot) -> Snapshot:
        """Add to the history, or start a new one; a diverged state shows the last sound one instead."""
        last = self._last
        if last is None or snapshot.course is not last.course or snapshot.time < last.time:
            self._history = History()
            self._side.restart()
            self._course = CourseDrawing(self.canvas.pygame, snapshot)
        elif not (np.isfinite(snapshot.state).all() and np.isfinite(snapshot.readings).all()):
            return replace(last, ending=snapshot.ending)
        self._history.add(snapshot)
        self._last = snapshot
        return snapshot

    def _write_header(self, snapshot: Snapshot) -> None:
        canvas, middle = self.canvas, HEADER.top + HEADER.height // 2
        x = canvas.text((14, middle), f"OffroadBekker \u00b7 {snapshot.scenario.name}", size=30) + 22
        kind = "half-car" if snapshot.plant.half_car > 0.5 else "bicycle"
        kind = kind if snapshot.plant.four_wheel is None else "four wheels"
        facts = f"{snapshot.model} model, {kind}   |   observation {_OBSERVED[snapshot.terrain_info]}"
        canvas.text((x, middle + 2), facts, size=22, colour=MUTED)
        canvas.text((1266, middle), f"t = {snapshot.time:.2f} s", size=28, anchor="midright")
        if snapshot.ending:
            badge = (822, 8, 290, 28)
            canvas.box(badge, GOOD if snapshot.ending == "goal" else BAD)
            place = (badge[0] + badge[2] / 2, middle)
            canvas.text(place, _ENDINGS[snapshot.ending], size=26, colour=PANEL, anchor="center")
