"""Colours and places of the picture.

The colours that carry meaning follow Okabe & Ito (colour-blind readers can distinguish them): front axle
blue, rear axle vermilion, estimate green, truth black.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = [
    "BAD",
    "BODY",
    "CAB",
    "EDGE",
    "ESTIMATE",
    "ESTIMATE_BAND",
    "EXPONENT",
    "FIRM",
    "FRAME_SIZE",
    "FRONT",
    "GOOD",
    "GRID",
    "HEADER",
    "INK",
    "MAP",
    "MUTED",
    "OVERVIEW",
    "PAGE",
    "PANEL",
    "PRIOR_BAND",
    "REAR",
    "RUT",
    "SIDE",
    "SOFT",
    "SOIL",
    "SOIL_DARK",
    "SOIL_LIGHT",
    "STRIPS",
    "TYRE",
    "Area",
    "Box",
    "Colour",
    "Point",
]

FRAME_SIZE = (1280, 720)  #: width, height of a frame [pixels]

Colour = tuple[int, int, int]  #: red, green, blue, 0 ... 255
Area = tuple[float, float, float, float]  #: left, top, width, height [pixels]
Point = tuple[float, float] | np.ndarray  #: x, y [pixels]


class Box(NamedTuple):
    """A place of the picture that others are measured from."""

    left: int  #: [pixels]
    top: int  #: [pixels]
    width: int  #: [pixels]
    height: int  #: [pixels]


PAGE, PANEL, GRID = (228, 229, 226), (252, 252, 250), (224, 225, 222)
INK, MUTED = (26, 30, 36), (88, 94, 102)
FRONT, REAR = (0, 114, 178), (213, 94, 0)
ESTIMATE, ESTIMATE_BAND = (0, 128, 94), (186, 226, 212)
PRIOR_BAND = (222, 222, 228)
BODY, CAB, TYRE = (84, 94, 110), (176, 188, 202), (34, 36, 40)
SOIL_LIGHT, SOIL_DARK, SOIL, RUT = (232, 218, 190), (176, 154, 118), (205, 184, 146), (150, 122, 84)
EDGE = (122, 74, 30)
#: Soil that is softer or firmer than the base soil.
SOFT, FIRM = (96, 82, 132), (246, 240, 150)
GOOD, BAD = (0, 128, 94), (190, 60, 0)

HEADER = Box(0, 0, 1280, 44)
MAP = Box(12, 52, 780, 556)
OVERVIEW = Box(12, 616, 780, 92)
SIDE = Box(804, 52, 464, 324)
EXPONENT = Box(804, 384, 464, 142)
STRIPS = Box(804, 534, 464, 174)
