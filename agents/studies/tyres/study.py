"""``offroad reproduce tyre``: the flexible tyre against what is published on tyres and soft soil.

Nothing is fitted to the numbers on soil. The stiffness of the Goodyear tyre is fitted to its curves.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.reports.output import Results, console, say, table
from agents.studies.tyres.results import (
    Comparison,
    field_ruts,
    hard_ground_pressures,
    load_deflection,
    pressure_effects,
    rut_ranks,
    side_forces,
    snow,
    stiffnesses,
)
from agents.studies.tyres.trends import trend_checks
from offroad_env.errors import InvalidParameter
from offroad_env.world.tyres import make_tyre

__all__ = ["TyreStudy"]

_DATA = "tyre_on_soil"


@dataclass(kw_only=True)
class TyreStudy(Results):
    """Flexible tyre: load-deflection, ruts, resistance, pull and side force against published numbers.

    Writes tyres.png.
    """

    data: Path | None = None  #: folder of the published tables; default: tyre_on_soil in OFFROAD_DATA

    def run(self) -> None:
        """Compute, print, draw and write."""
        from agents.studies.tyres.figure import tyres_figure

        folder = self.data or Path(os.environ.get("OFFROAD_DATA", ".")) / _DATA
        if not (folder / "trend_checks.csv").is_file():
            raise InvalidParameter(
                f"the published tables on tyres are not in {folder} - set OFFROAD_DATA to the folder that "
                f"holds {_DATA}/, or name it with --data"
            )
        curves, effects, snowy = load_deflection(folder), pressure_effects(folder), snow(folder)
        deviation = max(abs(point.model / point.load - 1.0) for point in curves)
        say(f"load at {len(curves)} published deflections: largest deviation {deviation:.1%}")
        _show("vertical stiffness, and mean pressure on hard ground", stiffnesses(folder))
        _show("hard ground (check T4)", hard_ground_pressures(folder))
        _show("inflation pressure from 270 to 650 kPa, Goodyear tyre", effects)
        ruts, rank = rut_ranks(folder)
        _show(f"ruts in the soil bin at 4.5 t; rank correlation {rank:+.2f}", ruts)
        _show("ruts in the field", field_ruts(folder))
        say(
            f"snow, resistance over sinkage: rank correlation {snowy.rank:+.2f}, exponent {snowy.slope:.2f} "
            f"measured, {snowy.model_slope:.2f} by the model"
        )
        checks = trend_checks()
        heading = ("check", "published", "model", "")
        console().print(table("trend checks", heading, checks, texts=4))
        forces = _side_forces()
        self.save_figure(
            tyres_figure(curves, effects, snowy, forces),
            "tyres",
            "Lines: the model; points: published measurements.",
        )
        self.save_numbers(
            {
                "load_deflection": curves,
                "largest_deviation": deviation,
                "stiffness": stiffnesses(folder),
                "hard_ground": hard_ground_pressures(folder),
                "pressure_effects": effects,
                "ruts": {"rows": ruts, "rank_correlation": rank},
                "field_ruts": field_ruts(folder),
                "snow": snowy,
                "trend_checks": [list(check) for check in checks],
                "side_force": {name: list(values) for name, values in forces.items()},
            }
        )


def _show(title: str, rows: Iterable[Comparison]) -> None:
    heading = ("case", "quantity", "published", "model", "deviation", "direction")
    body = [
        (
            row.case,
            row.quantity,
            f"{row.published:.3g}",
            f"{row.model:.3g}",
            f"{row.model / row.published - 1.0:+.0%}",
            "agrees" if row.agrees else "differs",
        )
        for row in rows
    ]
    console().print(table(title, heading, body, texts=2))


def _side_forces() -> dict[str, np.ndarray]:
    """Side force over load at 10 degrees over the sand's pressure at 5 cm."""
    pressures = np.geomspace(30e3, 1e6, 13)
    found = {"pressure": pressures, "rigid rim": side_forces(list(pressures), None)}
    for inflation in (100e3, 150e3, 300e3, 1e6):
        tyre = make_tyre("mrzr", inflation=inflation)
        found[f"tyre, {inflation / 1e3:.0f} kPa"] = side_forces(list(pressures), tyre)
    for name, values in found.items():
        if name != "pressure":
            fall = float(np.max(1.0 - values / np.maximum.accumulate(values)))
            say(
                f"side force at 10 degrees, {name}: {values[0]:.3f} of the load on the softest sand, "
                f"{values[-1]:.3f} on the firmest, falls by {fall:.1%} at most"
            )
    return found
