"""Where soil takes power from a wheel and where it gives some back, for several structures."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from agents.reports.soil_power import PowerScan

__all__ = ["soil_power_figure"]

_NORM = TwoSlopeNorm(vcenter=0.0, vmin=-0.3, vmax=0.9)


def soil_power_figure(scans: Mapping[str, PowerScan]) -> Figure:
    """A map for each structure: the least power of all slip angles and soils, over motion and sinkage.

    Parameters
    ----------
    scans
        From `agents.reports.soil_power.scan_power`, by the name of the structure.

    Returns
    -------
    Figure
        Blue: soil takes power from the wheel. Red, inside the black line: it gives some back.
    """
    figure = Figure(figsize=(11.0, 4.0 * math.ceil(len(scans) / 2)), layout="constrained")
    axes = figure.subplots(math.ceil(len(scans) / 2), 2, sharex=True, sharey=True, squeeze=False)
    for panel, (name, scan) in zip(axes.ravel(), scans.items(), strict=False):
        image = _draw(panel, scan)
        panel.set_title(name, loc="left", fontsize=11, pad=18)
    for panel in axes[:, 0]:
        panel.set_ylabel("sinkage over radius [-]")
    for panel in axes[-1]:
        panel.set_xlabel("atan(r omega / v) [°]")
    figure.colorbar(
        image, ax=axes.ravel().tolist(), label="least power / (load (|r omega| + |v|)) [-]", pad=0.01
    )
    figure.suptitle(
        "Power that soil takes from a wheel: least of all slip angles and soils",
        fontsize=12.5,
        x=0.01,
        ha="left",
    )
    return figure


def _draw(panel: Axes, scan: PowerScan) -> AxesImage:
    """One map, with the line where soil gains nothing."""
    degrees, depth, least = np.degrees(scan.direction), scan.depth, scan.least.T
    extent = (degrees[0], degrees[-1], depth[0], depth[-1])
    image = panel.imshow(
        least, origin="lower", extent=extent, aspect="auto", cmap="RdBu", norm=_NORM, interpolation="nearest"
    )
    if least.min() < 0.0 < least.max():
        panel.contour(degrees, depth, least, levels=[0.0], colors="black", linewidths=1.2)
    for place, text in ((-90.0, "spins backwards"), (0.0, "locked"), (45.0, "rolls"), (90.0, "spins")):
        panel.axvline(place, color="0.4", lw=0.7, ls=":")
        align = {-90.0: "left", 90.0: "right"}.get(place, "center")
        above = panel.get_xaxis_transform()
        panel.text(place, 1.01, text, fontsize=8, ha=align, va="bottom", transform=above)
    panel.set_xticks([-90, -45, 0, 45, 90])
    return image
