"""An episode as a page plays it back: where it went, its wheels, n and what the soil holds."""

from __future__ import annotations

import numpy as np

from agents.driving.recording import EpisodeLog
from agents.reports.playback import HOW_TO, Above, Chart, Line, Playback, WheelSide
from offroad_env.environment.snapshot import Briefing
from offroad_env.physics.records import Soil
from offroad_env.simulation.simulator import make_plant
from offroad_env.simulation.soil_holds import soils_hold
from offroad_env.world.terrain import flat

__all__ = ["episode_playback"]

#: Half width of a 95 % interval in standard deviations.
_WIDE = 1.96
#: Column of a path's nodes that holds the heading.
_YAW = 2
#: Different n for which the limits of the soil are computed; between them they are interpolated.
_SUPPORT = 40
#: Limits that are drawn: place in `SoilHolds`, title, unit, factor.
_LIMITS = (
    (0, "largest lateral acceleration that the soil holds", "m/s²", 1.0),
    (1, "largest pull", "kN", 1e-3),
)


def episode_playback(log: EpisodeLog, briefing: Briefing) -> Playback:
    """The playback of an episode.

    Parameters
    ----------
    log
        Of at least two rows.
    briefing
        What the driver knew: vehicle and believed soil, with which n becomes what the soil holds.

    Returns
    -------
    Playback
        Where an estimator ran, with its n and 95 % band, and what the believed soil holds for that n.
    """
    columns = log.columns()
    t = columns["time"]
    return Playback(
        t=t,
        above=_above(log, columns),
        wheels=tuple(_wheel(name, columns, briefing.vehicle.r) for name in ("front", "rear")),
        charts=(
            *_belief_charts(log, columns, briefing),
            Chart(title="speed", unit="m/s", lines=(Line(label="true", values=columns["speed"]),)),
            Chart(title="cross-track error", unit="m", lines=_beside(log, columns)),
            _pair("slip", "%", 100.0, columns, "slip"),
            _pair("sinkage", "mm", 1000.0, columns, "sinkage"),
            Chart(title="steering", unit="rad", lines=(Line(label="command", values=columns["steer"]),)),
            Chart(
                title="drive (below 0: brake)",
                unit="-",
                lines=(Line(label="command", values=columns["drive"]),),
            ),
        ),
        caption=f"{HOW_TO} Bands are 95 % intervals; a small vehicle is drawn larger than it is.",
    )


def _beside(log: EpisodeLog, columns: dict[str, np.ndarray]) -> tuple[Line, ...]:
    """Cross-track error and the edges of the corridor."""
    error = columns["cross_track_error"]
    lines = [Line(label="true", values=error)]
    if np.isfinite(log.corridor):
        for label, edge in (("left edge", log.corridor), ("right edge", -log.corridor)):
            lines.append(Line(label=label, values=np.full(error.shape, edge), dashed=True))
    return tuple(lines)


def _above(log: EpisodeLog, columns: dict[str, np.ndarray]) -> Above:
    return Above(
        x=columns["X"],
        y=columns["Y"],
        yaw=np.interp(columns["progress"], log.path.s, log.path.nodes[:, _YAW]) + columns["heading_error"],
        path=log.path.xy,
        corridor=log.corridor if np.isfinite(log.corridor) else 0.0,
        stretches=tuple((start, end, f"n = {n:.2f}") for start, end, n in log.stretches),
    )


def _wheel(name: str, columns: dict[str, np.ndarray], radius: float) -> WheelSide:
    """A wheel; its rate follows from speed and slip, (r omega - v) / max(r omega, v)."""
    v, slip = columns["speed"], np.clip(columns[f"slip_{name}"], -0.99, 0.99)
    rim = np.where(slip > 0.0, v / (1.0 - np.maximum(slip, 0.0)), v * (1.0 + np.minimum(slip, 0.0)))
    turned = np.concatenate(([0.0], np.cumsum(rim[1:] * np.diff(columns["time"])))) / radius
    return WheelSide(
        name=name,
        radius=radius,
        turned=turned,
        sinkage=columns[f"sinkage_{name}"],
        slip=columns[f"slip_{name}"],
    )


def _pair(title: str, unit: str, factor: float, columns: dict[str, np.ndarray], name: str) -> Chart:
    lines = (Line(label=end, values=factor * columns[f"{name}_{end}"]) for end in ("front", "rear"))
    return Chart(title=title, unit=unit, lines=tuple(lines))


def _belief_charts(log: EpisodeLog, columns: dict[str, np.ndarray], briefing: Briefing) -> list[Chart]:
    """n and what the soil holds; the truth alone where nothing is estimated."""
    true, mean, sd = columns["n_front"], columns["n_estimate"], columns["n_estimate_sd"]
    low, high = mean - _WIDE * sd, mean + _WIDE * sd
    lines = [Line(label="true", values=true, dashed=True)]
    if log.estimating:
        lines.insert(0, Line(label="estimate", values=mean, low=low, high=high))
    charts = [Chart(title="sinkage exponent n", unit="-", lines=tuple(lines))]
    seen = np.concatenate((true, low, high) if log.estimating else (true,))
    support = np.linspace(max(float(seen.min()), 0.15), min(max(float(seen.max()), 0.2), 2.0), _SUPPORT)
    held = _held(briefing, support)
    for place, title, unit, factor in _LIMITS:
        curve = factor * held[:, place]
        if not np.isfinite(curve).any():
            continue
        of = np.interp  # between the values of n that were computed
        lines = [Line(label="with the true n", values=of(true, support, curve), dashed=True)]
        if log.estimating:
            ends = np.array([of(n, support, curve) for n in (low, mean, high)])
            estimate = Line(label="estimate", values=ends[1], low=ends.min(axis=0), high=ends.max(axis=0))
            lines.insert(0, estimate)
        charts.append(Chart(title=title, unit=unit, lines=tuple(lines)))
    return charts


def _held(briefing: Briefing, exponents: np.ndarray) -> np.ndarray:
    """(N, 6) what the believed soil holds for each n."""
    plant = make_plant(briefing.vehicle, briefing.soil, flat())
    soils: list[Soil] = [briefing.soil._replace(n=float(n)) for n in exponents]
    return soils_hold(plant, soils)
