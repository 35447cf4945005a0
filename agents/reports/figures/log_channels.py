"""The channels of a log over time, one panel a quantity, with their units."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from estimators.logs import Log
from estimators.logs.schema import RIG_COLUMNS, VEHICLE_COLUMNS

__all__ = ["log_channels_figure"]

#: Panels: title, channels. One without any of its channels is left out.
_PANELS = (
    ("steering", ("steer",)),
    ("drive", ("torque_f", "torque_r")),
    ("drive force", ("drive_force",)),
    ("wheel speed", ("omega_f", "omega_r")),
    ("speed", ("v_x", "speed", "v_y")),
    ("acceleration", ("a_x", "a_y")),
    ("vertical", ("a_z",)),
    ("rates", ("roll_rate", "pitch_rate", "yaw_rate")),
    ("angles", ("yaw", "course", "pitch", "roll")),
    ("position", ("x", "y")),
)
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
#: More samples than these are drawn thinned: a picture has fewer pixels.
_MOST = 6000


def log_channels_figure(log: Log) -> Figure:
    """All channels of a log, as they are read: in SI, mounted, at the times of their samples."""
    if log.rig:
        return _rig_figure(log)
    panels = [(title, [n for n in names if n in log.channels]) for title, names in _PANELS]
    panels = [(title, names) for title, names in panels if names]
    figure = Figure(figsize=(11.0, 1.0 + 1.45 * len(panels)), layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    for axes, (title, names) in zip(rows, panels, strict=True):
        for name, colour, style in zip(names, _COLOURS, ("-", "--", "-", ":"), strict=False):
            t, values = log.samples(name)
            every = max(len(t) // _MOST, 1)
            sparse = len(t) < 0.3 * len(log)
            axes.plot(
                t[::every],
                values[::every],
                color=colour,
                ls=style,
                lw=0.9,
                label=name,
                marker="." if sparse else None,
                ms=2,
            )
        units = dict.fromkeys(VEHICLE_COLUMNS[name].unit.replace("^2", "²") for name in names)
        axes.set_ylabel(f"{title}\n[{', '.join(units)}]")
        axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        _plain(axes)
    rows[0].set_title(f"{log.name}: channels as they are read", loc="left", fontsize=11)
    rows[-1].set_xlabel("time [s]")
    return figure


def _plain(axes: object) -> None:
    axes.margins(x=0.0)  # type: ignore[attr-defined]
    axes.grid(alpha=0.25)  # type: ignore[attr-defined]
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)  # type: ignore[attr-defined]


def _rig_figure(log: Log) -> Figure:
    """Results of the trials of a wheel rig over the slip."""
    names = [name for name in ("drawbar", "side_force", "torque", "sinkage", "load") if name in log.channels]
    figure = Figure(figsize=(11.0, 1.0 + 1.8 * len(names)), layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    for axes, name in zip(rows, names, strict=True):
        axes.plot(log.channels["slip"], log.channels[name], ".", color=_COLOURS[0])
        axes.set_ylabel(f"{name}\n[{RIG_COLUMNS[name].unit}]")
        _plain(axes)
    rows[0].set_title(f"{log.name}: trials as they are read", loc="left", fontsize=11)
    rows[-1].set_xlabel("slip [-]")
    return figure
