"""A log as a page plays it back: its channels, the way of the vehicle, its wheels, n and its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from agents.reports.playback import HOW_TO, Above, Chart, Line, Playback, WheelSide
from estimators.logs.log import Log
from estimators.logs.schema import VEHICLE_COLUMNS
from estimators.logs.substitutes import substituted
from estimators.replay.planar_smoother import V_X, YAW, PlanarMotion, X, Y, smooth_motion
from estimators.replay.replay import grid_of
from offroad_env.errors import OffroadError
from offroad_env.simulation.simulator import make_plant
from offroad_env.simulation.soil_holds import soils_hold
from offroad_env.world.terrain import flat

__all__ = ["log_playback"]

#: Charts of channels, those that a log has: title -> names.
_GROUPS = {
    "speed": ("v_x", "v_y", "speed"),
    "rate of turn": ("yaw_rate",),
    "rate of pitch and roll": ("pitch_rate", "roll_rate"),
    "acceleration": ("a_x", "a_y", "a_z"),
    "wheel speeds": ("omega_f", "omega_r"),
    "steering": ("steer",),
    "torques at the wheels": ("torque_f", "torque_r"),
    "drive force": ("drive_force",),
}
#: Samples that lie further apart are a gap [s].
_GAP = 0.5
#: Limits that the soil holds: place in `SoilHolds`, title, unit, factor.
_LIMITS = (
    (0, "largest lateral acceleration that the soil holds", "m/s²", 1.0),
    (1, "largest pull", "kN", 1e-3),
)


def log_playback(
    log: Log,
    *,
    exponents: Mapping[str, tuple[float, float, float]] | None = None,
    more: Sequence[tuple[str, str, Mapping[str, np.ndarray]]] = (),
) -> Playback | None:
    """The playback of a log; None for the trials of a rig, and where no motion can be made out.

    Parameters
    ----------
    log
        Of a drive.
    exponents
        Estimates of n: label -> value and 95 % interval [-]. Default: the one that the log states.
    more
        Further charts: title, unit and lines on the log's even instants (`grid_of`).
    """
    if log.rig:
        return None
    try:
        t = grid_of(log)
        motion = smooth_motion(substituted(log)[0], t)
    except OffroadError:
        return None
    above = _above(log, motion)
    charts = [_chart(log, t, title, names) for title, names in _GROUPS.items()]
    return Playback(
        t=t,
        above=above,
        wheels=_wheels(log, motion),
        charts=(
            *_soil_charts(log, t, exponents),
            *(
                Chart(
                    title=title,
                    unit=unit,
                    lines=tuple(Line(label=label, values=row) for label, row in lines.items()),
                )
                for title, unit, lines in more
            ),
            *(chart for chart in charts if chart.lines),
        ),
        caption=f"{HOW_TO} The way from above is {_way(log)}; the slip follows from the smoothed speed.",
    )


def _way(log: Log) -> str:
    return "the log's reference" if "ref_x" in log.references else "smoothed from the sensors"


def _sampled(log: Log, t: np.ndarray, name: str) -> np.ndarray:
    """(K,) a channel between its samples; NaN in gaps."""
    times, values = log.samples(name)
    if not len(times):
        return np.full(t.shape, math.nan)
    behind = np.clip(np.searchsorted(times, t), 1, max(len(times) - 1, 1))
    found: np.ndarray = np.interp(t, times, values)
    if len(times) > 1:
        found[times[behind] - times[behind - 1] > _GAP] = math.nan
    return found


def _chart(log: Log, t: np.ndarray, title: str, names: tuple[str, ...]) -> Chart:
    present = [name for name in names if name in log.channels]
    unit = VEHICLE_COLUMNS[present[0]].unit if present else ""
    lines = (Line(label=name, values=_sampled(log, t, name)) for name in present)
    return Chart(title=title, unit=unit.replace("^2", "²"), lines=tuple(lines))


def _reference(log: Log, t: np.ndarray, name: str) -> np.ndarray | None:
    values = log.references.get(f"ref_{name}")
    if values is None:
        return None
    known = np.isfinite(values)
    return np.interp(t, log.times[known], values[known]) if known.sum() > 1 else None


def _above(log: Log, motion: PlanarMotion) -> Above:
    smoothed = motion.states
    places = [_reference(log, motion.t, name) for name in ("x", "y", "yaw")]
    x, y, yaw = (
        smoothed[:, place] if found is None else found
        for found, place in zip(places, (X, Y, YAW), strict=True)
    )
    return Above(x=x, y=y, yaw=yaw)


def _wheels(log: Log, motion: PlanarMotion) -> tuple[WheelSide, ...]:
    v, r = motion.states[:, V_X], log.vehicle.r
    wheels = []
    for name, axle, rate in (("front", "f", motion.omega_f), ("rear", "r", motion.omega_r)):
        if not np.isfinite(rate).any():
            continue
        rim = r * np.nan_to_num(rate)
        largest = np.maximum(np.maximum(np.abs(rim), np.abs(v)), 0.3)  # hardly any slip is known at rest
        wheels.append(
            WheelSide(
                name=name,
                radius=r,
                turned=np.cumsum(rim) * motion.step / r,
                sinkage=_reference(log, motion.t, f"sinkage_{axle}"),
                slip=(rim - v) / largest,
            )
        )
    return tuple(wheels)


def _soil_charts(
    log: Log, t: np.ndarray, exponents: Mapping[str, tuple[float, float, float]] | None
) -> list[Chart]:
    """n, and what the log's soil holds with that n; none on hard ground."""
    soil = log.config.soil
    if soil is None or soil.rigid > 0.5:
        return []
    found = exponents or {"as stated": (soil.n, soil.n, soil.n)}
    lines = [_level(t, label, numbers) for label, numbers in found.items()]
    charts = [Chart(title="sinkage exponent n", unit="-", lines=tuple(lines))]
    try:
        plant = make_plant(log.vehicle, soil, flat())
        held = {
            label: soils_hold(plant, [soil._replace(n=min(max(n, 0.1), 2.4)) for n in numbers])
            for label, numbers in found.items()
        }
    except OffroadError:
        return charts
    for place, title, unit, factor in _LIMITS:
        rows = {label: factor * table[:, place] for label, table in held.items()}
        if all(np.isfinite(row).all() for row in rows.values()):
            lines = [_level(t, label, (row[0], row.min(), row.max())) for label, row in rows.items()]
            charts.append(Chart(title=title, unit=unit, lines=tuple(lines)))
    return charts


def _level(t: np.ndarray, label: str, numbers: tuple[float, float, float]) -> Line:
    value, low, high = (np.full(t.shape, float(number)) for number in numbers)
    return Line(label=label, values=value, low=low, high=high)
