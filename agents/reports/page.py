"""One HTML page out of sections: figures embedded, nothing fetched, fit for the screen and for paper."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import jinja2
import numpy as np
from matplotlib.figure import Figure

from agents.reports.playback import Playback

__all__ = [
    "PageVerdict",
    "Picture",
    "Section",
    "Table",
    "figure_picture",
    "frame_picture",
    "frame_png",
    "render_page",
]

_DPI = 110  # 12 inches wide figures: 1320 pixels, sharp at the width of the page
_ROUGH = 208  # colours of a frame that are fitted to it as a whole, of 256
_VISIBLE = 16  # error of a colour that the eye sees on a thin line, of 255


@dataclass(frozen=True, kw_only=True)
class Picture:
    """An image with a description for readers who cannot see it."""

    png: bytes
    caption: str

    @property
    def source(self) -> str:
        """The image as a data address."""
        return f"data:image/png;base64,{base64.b64encode(self.png).decode()}"


@dataclass(frozen=True, kw_only=True)
class Table:
    """Numbers for people; the first ``texts`` columns are text."""

    heading: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1


@dataclass(frozen=True, kw_only=True)
class PageVerdict:
    """What a page concludes, before anything else on it."""

    light: Literal["good", "caution", "problem", "neutral"]  #: green, amber, red, grey
    sentence: str  #: in plain words


@dataclass(frozen=True, kw_only=True)
class Section:
    """One part of a page."""

    name: str  #: short name, used for the address within the page
    title: str
    sees: str  #: one plain sentence: what one sees
    command: str = ""  #: the command that makes this part; empty where the page names one for all
    pictures: tuple[Picture, ...] = ()
    playback: Playback | None = None
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    key: tuple[tuple[str, str], ...] = ()  #: numbers for the summary: (what, value)
    data: dict[str, Any] = field(default_factory=dict)  #: all numbers, for JSON
    seconds: float = 0.0  #: wall time


def figure_picture(figure: Figure, caption: str) -> Picture:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return Picture(png=buffer.getvalue(), caption=caption)


def frame_picture(frame: np.ndarray, caption: str) -> Picture:
    """A rendered frame (H, W, 3) uint8 as PNG."""
    return Picture(png=frame_png(frame), caption=caption)


def frame_png(frame: np.ndarray) -> bytes:
    """A rendered frame (H, W, 3) uint8 as a PNG of 256 colours, less than half the size of one of all.

    A palette that fits the picture as a whole loses the colours of thin lines and letters, so those
    that it misses most are added to it.
    """
    from PIL import Image

    image = Image.fromarray(frame)
    rough = image.quantize(_ROUGH, dither=Image.Dither.NONE)
    palette = np.array(rough.getpalette("RGB")).reshape(-1, 3)[:_ROUGH]
    missed = np.abs(np.asarray(rough.convert("RGB")).astype(int) - frame).max(axis=2) > _VISIBLE
    colours, counts = np.unique(frame[missed], axis=0, return_counts=True)
    exact = colours[np.argsort(counts)[::-1][: 256 - _ROUGH]]
    holder = Image.new("P", (1, 1))
    holder.putpalette(np.concatenate((palette, exact)).astype(np.uint8).tobytes())
    buffer = io.BytesIO()
    image.quantize(palette=holder, dither=Image.Dither.NONE).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def render_page(
    sections: Sequence[Section], *, title: str, intro: str, footer: str, verdict: PageVerdict | None = None
) -> str:
    """The page as HTML text: the verdict first, then what it rests on."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("agents"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["units"] = _hold_units
    template = environment.get_template("report.html.j2")
    return template.render(sections=sections, title=title, intro=intro, footer=footer, verdict=verdict)


def _hold_units(text: str) -> str:
    """No line break between a number and its unit."""
    return re.sub(r"(?<=\d) (?=(?:s|m|mm|N|kN|kB|%|m/s|rad)\b|%)", "\N{NO-BREAK SPACE}", text)
