"""The scan of the power that soil takes from a wheel."""

from __future__ import annotations

import math

from agents.reports.figures.soil_power import soil_power_figure
from agents.reports.soil_power import scan_power
from offroad_env.world.soils import SOILS
from offroad_env.world.structures import read_structure
from offroad_env.world.vehicles import make_wheel


def test_soil_gives_power_to_rims_that_spin_backwards_under_pressure_along_the_grounds_normal_only():
    wheel, soils = make_wheel(r=0.33, b=0.212), {"clay_wet": SOILS["clay_wet"]}
    scans = {name: scan_power(read_structure(name), wheel, soils) for name in ("full", "grid")}
    assert scans["full"].least.min() > 0.0
    assert math.isnan(scans["full"].slip_angles[0])
    grid = scans["grid"]
    giving = grid.least < 0.0
    assert grid.soils == ("clay_wet",)
    assert grid.direction[giving.any(axis=1)].max() < 0.0
    assert grid.depth[giving.any(axis=0)].min() > 0.1
    figure = soil_power_figure(scans)
    assert [panel.get_title(loc="left") for panel in figure.axes[:2]] == ["full", "grid"]
