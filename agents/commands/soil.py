"""``offroad soil``: force and sinkage curves of a soil, and the catalogue."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table

if TYPE_CHECKING:
    from offroad_env.physics.records import Soil
    from offroad_env.world.catalogue import Entry

__all__ = ["SoilPlot"]

#: Structures whose power is shown, and random states of steady rolling for each.
_POWER_OF, _ROLLING_STATES = ("full", "full,pressure_from=own_sinkage", "grid", "field"), 100_000


@dataclass(kw_only=True)
class SoilPlot(Results):
    """Force and sinkage curves of a soil, over slip and over load.

    Writes the figure soil_NAME.png. A curve ends where the soil no longer carries the wheel. --field draws
    natural soil around NAME seen from above; --power shows where soils take power from a wheel, and where
    they give some back, for four structures; --prior shows the population of measured soils, and how well
    it covers each soil when it is learnt without it.
    """

    name: Positional[str] = "dry_sand"  #: of the catalogue (--list), a file *.yaml, or "{base: clay, n: 1}"
    list: bool = False  #: show the catalogue with its sources instead
    prior: bool = False  #: show the prior of whole soils instead
    power: bool = False  #: show the power that soils take from a wheel instead, in soil_power.png
    field: bool = False  #: draw a random field around the soil instead
    correlation_length: float = 5.0  #: of the field [m]
    seed: int = 0  #: of the field, and of the soils sampled for the figure of the prior
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
        elif self.prior:
            self._show_prior()
        elif self.power:
            self._show_power()
        elif self.field:
            self._draw_field()
        else:
            self._draw()

    def _entry(self) -> Entry[Soil]:
        """The soil of the catalogue, or one's own."""
        from offroad_env.world.catalogue import Entry
        from offroad_env.world.descriptions import read_soil
        from offroad_env.world.documents import is_name
        from offroad_env.world.soils import SOILS

        if is_name(self.name) and self.name in SOILS:
            return SOILS.entry(self.name)
        soil = read_soil(self.name).record
        name = Path(self.name).stem if self.name.endswith((".yaml", ".yml")) else "own"
        return Entry(name=name, record=soil, title=f"Own soil {name}", source="", remark="")

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

    def _show_prior(self) -> None:
        from agents.reports.figures.natural_soil import prior_figure
        from offroad_env.world.soil_prior import PRIOR_NAMES, SoilPrior, leave_one_out

        prior = SoilPrior.fitted()
        title = f"Prior of whole soils from {len(prior.soils)} measured ones"
        heading = ("number", "middle", "sd", *(f"corr. {name}" for name in PRIOR_NAMES[:4]))
        rows = [
            (name, f"{mean:.3f}", f"{sd:.3f}", *(f"{value:+.2f}" for value in correlation[:4]))
            for name, mean, sd, correlation in zip(
                PRIOR_NAMES, prior.mean, prior.scale.diagonal() ** 0.5, prior.correlation, strict=True
            )
        ]
        console().print(table(title, heading, rows))
        say("p(5 cm) [Pa] of a plate 0.2 m wide, c [Pa], phi [rad], K [m]; natural logarithms")
        say(
            f"t with {prior.degrees_of_freedom:g} degrees of freedom; correlations shrunk by "
            f"{prior.shrinkage:.2f}; {prior.missing} numbers missing; log K a stated prior"
        )
        left_out = {
            "one soil left out": leave_one_out(),
            "one site left out": leave_one_out(sites=True),
        }
        heading = ("left out", "nominal", *PRIOR_NAMES[:4], "all four")
        levels = (0.5, 0.8, 0.95)
        rows = [
            (label, f"{level:.0%}", *(f"{share:.0%}" for share in found.coverage(level)))
            for label, found in left_out.items()
            for level in levels
        ]
        console().print(table("Share of left-out soils inside", heading, rows))
        self.save_figure(prior_figure(prior, left_out, seed=self.seed), "soil_prior")
        coverage = {
            label: {f"{level:g}": found.coverage(level) for level in levels}
            for label, found in left_out.items()
        }
        self.save_numbers({"prior": prior, "coverage": coverage})

    def _show_power(self) -> None:
        from agents.reports.figures.soil_power import soil_power_figure
        from agents.reports.soil_power import deformable_soils, least_rolling_power, scan_power
        from offroad_env.world.structures import read_structure
        from offroad_env.world.vehicles import make_wheel

        wheel, soils = make_wheel(r=self.radius, b=self.width), deformable_soils()
        scans, rows = {}, []
        for name in _POWER_OF:
            structure = read_structure(name)
            rolling = least_rolling_power(structure, wheel, soils, _ROLLING_STATES, self.seed)
            scans[name] = scan = scan_power(structure, wheel, soils)
            giving = scan.direction[(scan.least < 0.0).any(axis=1)]
            shallow = scan.depth[(scan.least < 0.0).any(axis=0)]
            region = (
                "none found"
                if not len(giving)
                else (f"{math.degrees(giving.min()):.0f} ... {math.degrees(giving.max()):.0f}")
            )
            depth = f"from {shallow.min():.2f}" if len(shallow) else "-"
            least = f"{scan.least.min():+.3f}"
            rows.append((name, f"{rolling:+.4f}", region, depth, least, ", ".join(scan.soils) or "-"))
        title = f"Power of {len(soils)} soils over load (|r omega| + |v|); negative: given to the wheel"
        heading = (
            "structure", "rolling,\nleast", "given at\natan(r omega/v) [deg]", "sinkage\nover r",
            "least\nanywhere", "by",
        )  # fmt: skip
        console().print(table(title, heading, rows))
        say(f"rolling: {_ROLLING_STATES} random states whose rim turns the way it travels, virgin soil")
        self.save_figure(soil_power_figure(scans), "soil_power")
        self.save_numbers(scans)

    def _draw_field(self) -> None:
        from agents.reports.figures.natural_soil import field_figure
        from offroad_env.world.natural_soil import SoilSpread, natural_soil
        from offroad_env.world.soils import make_soil

        entry = self._entry()
        soil = entry.record if self.n is None else make_soil(entry.record, n=self.n)
        length, spread = self.correlation_length, SoilSpread()
        field = natural_soil(soil, self.seed, correlation_length=length, spread=spread)
        title = f"Natural soil around {entry.title}: correlation length {length:g} m, seed {self.seed}"
        figure = field_figure(field, soil, title=title, width=12.0 * length, height=6.0 * length)
        self.save_figure(figure, f"soil_field_{entry.name}")
        self.save_numbers({"correlation_length": length, "seed": self.seed, "spread": spread})

    def _draw(self) -> None:
        from agents.reports.figures.soil import soil_figure
        from agents.reports.soil_curves import soil_curves
        from offroad_env.world.soils import make_soil
        from offroad_env.world.vehicles import make_wheel

        entry = self._entry()
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
        self.save_figure(soil_figure(curves, title=title), f"soil_{entry.name}")
        if entry.source:
            say(f"source: {entry.source}")
        self.save_numbers({"source": entry.source, "remark": entry.remark, "curves": curves})


def _describe(entry: Entry[Soil]) -> dict[str, Any]:
    return {
        "title": entry.title,
        "source": entry.source,
        "remark": entry.remark,
        "parameters": entry.record._asdict(),
    }
