"""``offroad soil``: force and sinkage curves of a soil, and the catalogue."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table

if TYPE_CHECKING:
    from offroad_env.physics.records import Soil
    from offroad_env.world.catalogue import Entry

__all__ = ["SoilPlot"]


@dataclass(kw_only=True)
class SoilPlot(Results):
    """Force and sinkage curves of a soil, over slip and over load.

    Writes the figure soil_NAME.png. A curve ends where the soil no longer carries the wheel.
    """

    name: Positional[str] = "dry_sand"  #: a soil of the catalogue, see --list
    list: bool = False  #: show the catalogue with its sources instead
    n: float | None = None  #: another sinkage exponent than the catalogue's [-]
    loads: tuple[float, ...] = (1000.0, 2000.0, 3500.0)  #: wheel loads of the curves over slip [N]
    slips: tuple[float, ...] = (0.0, 0.1, 0.3)  #: slips of the curves over load, -1 ... 1 [-]
    slip_angle: float = 10.0  #: slip angle of the side force [deg]
    radius: float = 0.33  #: wheel radius [m]
    width: float = 0.212  #: wheel width [m]
    shear: Literal["independent", "resultant"] = "independent"  #: one shear strength each, or one in all

    def run(self) -> None:
        """List the catalogue or draw the curves."""
        if self.list:
            self._show_catalogue()
        else:
            self._draw()

    def _show_catalogue(self) -> None:
        from offroad_env.world.soils import SOILS

        sources = list(dict.fromkeys(SOILS.entry(name).source for name in SOILS))
        rows = []
        for name, soil in SOILS.items():
            entry = SOILS.entry(name)
            strength = (f"{soil.n:.2f}", f"{soil.c / 1e3:.2f}", f"{math.degrees(soil.phi):.1f}")
            if soil.rigid:
                strength = ("-", "-", "-")
            rows.append((name, entry.title, *strength, str(sources.index(entry.source) + 1)))
        heading = ("name", "what", "n [-]", "c [kPa]", "phi [deg]", "source")
        console().print(table(f"{len(rows)} soils", heading, rows, texts=2))
        for number, source in enumerate(sources, 1):
            say(f"{number:>2}  {source}")
        self.save_numbers({name: _describe(SOILS.entry(name)) for name in SOILS})

    def _draw(self) -> None:
        from agents.reports.figures.soil import soil_figure
        from agents.reports.soil_curves import soil_curves
        from offroad_env.world.soils import SOILS, make_soil
        from offroad_env.world.vehicles import make_wheel

        entry = SOILS.entry(self.name)
        soil = entry.record if self.n is None else make_soil(entry.record, n=self.n)
        wheel = make_wheel(r=self.radius, b=self.width)
        curves = soil_curves(
            soil,
            wheel,
            loads=self.loads,
            slips=self.slips,
            slip_angle=math.radians(self.slip_angle),
            shear=self.shear,
        )
        exponent = "" if soil.rigid else f", n = {soil.n:g}"
        title = f"{entry.title}{exponent}; wheel r = {wheel.r:g} m, b = {wheel.b:g} m"
        self.save_figure(soil_figure(curves, title=title), f"soil_{self.name}")
        say(f"source: {entry.source}")
        self.save_numbers({"source": entry.source, "remark": entry.remark, "curves": curves})


def _describe(entry: Entry[Soil]) -> dict[str, Any]:
    return {
        "title": entry.title,
        "source": entry.source,
        "remark": entry.remark,
        "parameters": entry.record._asdict(),
    }
