"""What a technical drawing needs, on a surface of pygame-ce, which is imported late."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from offroad_env.rendering.style import INK, Area, Colour, Point

__all__ = ["Canvas", "import_pygame", "number", "rectangle", "round_number", "turned"]


def import_pygame() -> Any:
    """pygame-ce, without its greeting on standard output."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            'rendering needs pygame-ce, which is not installed: pip install "offroad-bekker[view]"'
        ) from error
    return pygame


class Canvas:
    """A surface with the strokes that a technical drawing needs; all places in pixels."""

    def __init__(self, pygame: Any, size: tuple[int, int]) -> None:
        self.pygame = pygame
        pygame.font.init()
        # Without a display, and always in this layout, whatever the screen has.
        self.surface = pygame.Surface(size, 0, 32)
        self._fonts: dict[int, Any] = {}
        self._texts: dict[tuple[str, int, Colour], Any] = {}

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8, red first; a new array."""
        width, height = self.surface.get_size()
        flat = np.frombuffer(self.pygame.image.tobytes(self.surface, "RGB"), np.uint8)
        return flat.reshape(height, width, 3).copy()

    def box(self, box: Area, fill: Colour, edge: Colour | None = None) -> None:
        """A filled rectangle."""
        self.surface.fill(fill, box)
        if edge is not None:
            self.pygame.draw.rect(self.surface, edge, box, 1)

    @contextmanager
    def clipped(self, box: Area) -> Iterator[None]:
        """Draw nothing outside ``box``."""
        self.surface.set_clip(box)
        try:
            yield
        finally:
            self.surface.set_clip(None)

    def text(
        self,
        place: Point,
        text: str,
        *,
        size: int = 18,
        colour: Colour = INK,
        anchor: str = "midleft",
    ) -> float:
        """Write one line; ``anchor`` is the point of its box at ``place``. Returns its right end."""
        key = (text, size, colour)
        image = self._texts.get(key)
        if image is None:
            if len(self._texts) > 600:
                self._texts.clear()
            image = self._texts[key] = self._written(text, size, colour)
        x, y = place
        where = image.get_rect(**{anchor: (round(float(x)), round(float(y)))})
        self.surface.blit(image, where)
        return float(where.right)

    def _written(self, text: str, size: int, colour: Colour) -> Any:
        """An image of the text, made twice as large and shrunk: small letters are spaced badly."""
        if size not in self._fonts:
            self._fonts[size] = self.pygame.font.Font(None, 2 * size)
        large = self._fonts[size].render(text, True, colour)
        width, height = large.get_size()
        return self.pygame.transform.smoothscale(large, ((width + 1) // 2, (height + 1) // 2))

    def words(self, place: Point, words: Sequence[tuple[str, Colour]], *, size: int = 18) -> float:
        """Words of different colours on one line, from ``place`` on; returns the right end."""
        x, y = place
        for word, colour in words:
            x = self.text((x, y), word, size=size, colour=colour) + 0.35 * size
        return float(x)

    def stroke(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """A smooth line through (N, 2) points: thin lines side by side, as pygame's wide ones are rough."""
        if len(points) < 2:
            return
        if width <= 1.0:
            self.pygame.draw.aalines(self.surface, colour, False, points.tolist())
            return
        along = np.empty_like(points)
        along[0], along[-1], along[1:-1] = (
            points[1] - points[0],
            points[-1] - points[-2],
            points[2:] - points[:-2],
        )
        across = along[:, ::-1] * (-1.0, 1.0)
        across *= 0.5 * (width - 1.0) / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        if len(points) == 2:
            self.shape(np.concatenate((points + across, points[::-1] - across)), colour)
            return
        lines = math.ceil(width)
        for i in range(lines):
            share = 2.0 * i / (lines - 1) - 1.0
            self.pygame.draw.aalines(self.surface, colour, False, (points + share * across).tolist())

    def dashes(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """Two of four segments of a line."""
        for i in range(0, len(points) - 1, 4):
            self.stroke(points[i : i + 3], colour, width)

    def shape(self, points: np.ndarray, fill: Colour, edge: Colour | None = None) -> None:
        """A filled polygon with a smooth edge."""
        corners = np.asarray(points).tolist()
        self.pygame.draw.polygon(self.surface, fill, corners)
        self.pygame.draw.aalines(self.surface, edge or fill, True, corners)

    def disc(self, centre: Point, radius: float, fill: Colour) -> None:
        """A filled circle with a smooth edge."""
        x, y = centre
        self.pygame.draw.aacircle(self.surface, fill, (float(x), float(y)), radius)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: Colour, width: float = 3.0) -> None:
        """An arrow; one shorter than its head is left out."""
        along = end - start
        length = float(np.hypot(*along))
        if length < 8.0:
            return
        along = along / length
        across = np.array([-along[1], along[0]])
        self.stroke(np.array([start, end - 7.0 * along]), colour, width)
        back = end - 10.0 * along
        self.shape(np.array([end, back + 5.0 * across, back - 5.0 * across]), colour)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """(N, 2) points, turned to the left by ``angle`` [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    rotation = np.array([[cos, sin], [-sin, cos]])
    return np.asarray(points @ rotation)


def rectangle(x: float, y: float, length: float, width: float) -> np.ndarray:
    """Corners (4, 2) of a rectangle around (x, y)."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.array([x, y]) + 0.5 * corners * [length, width]


def number(value: float, digits: int, unit: str = "", *, sign: bool = False) -> str:
    """``value`` as text with a true minus sign, and never as minus zero."""
    value = round(value, digits) + 0.0
    return f"{value:{'+' if sign else ''}.{digits}f}{unit}".replace("-", "\u2212")


def round_number(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= value * 1.000001)
