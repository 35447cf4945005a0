"""An episode as a page plays it back: where it went, its wheels, n and what the soil holds."""

from __future__ import annotations

import numpy as np

from agents.driving.recording import EpisodeLog
from agents.reports.playback import HOW_TO, Above, Chart, Line, Playback, WheelSide
from offroad_env.environment.snapshot import Briefing
from offroad_env.physics.records import Soil
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.simulation.soil_holds import soils_hold
from offroad_env.world.terrain import flat

__all__ = ["episode_playback"]

#: Half width of a 95 % interval in standard deviations.
_WIDE = 1.96
#: Column of a path's nodes that holds the heading.
_YAW = 2
#: Different n for which the limits of the soil are computed; between them they are interpolated.
_SUPPORT, _LEAST_N = 40, 0.15
#: Limits that are drawn: place in `SoilHolds`, title, unit, factor.
_LIMITS = (
    (0, "largest lateral acceleration that the soil holds", "m/s²", 1.0),
    (1, "largest pull", "kN", 1e-3),
)


def episode_playback(log: EpisodeLog, briefing: Briefing, plant: Plant | None = None) -> Playback:
    """The playback of an episode.

    Parameters
    ----------
    log
        Of at least two rows.
    briefing
        What the driver knew: vehicle and believed soil, with which n becomes what the soil holds.
    plant
        The truth of the episode, ``env.plant``. None: it is taken for the briefing's vehicle on the believed
        soil with the true n; of soil that varies over metres, which is not that one, no limits are shown.

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
            _exponent_chart(log, columns),
            *_limit_charts(log, columns, briefing, plant),
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


def _band(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """n by the estimator: lower end of the interval, mean, upper end."""
    mean, sd = columns["n_estimate"], columns["n_estimate_sd"]
    return mean - _WIDE * sd, mean, mean + _WIDE * sd


def _exponent_chart(log: EpisodeLog, columns: dict[str, np.ndarray]) -> Chart:
    """n; the truth alone where nothing is estimated."""
    lines = [Line(label="true", values=columns["n_front"], dashed=True)]
    if log.estimating:
        low, mean, high = _band(columns)
        lines.insert(0, Line(label="estimate", values=mean, low=low, high=high))
    return Chart(title="sinkage exponent n", unit="-", lines=tuple(lines))


def _limit_charts(
    log: EpisodeLog, columns: dict[str, np.ndarray], briefing: Briefing, plant: Plant | None
) -> list[Chart]:
    """What the soil holds, by the estimate of n and in truth.

    With other wheels than the believed ones, or where more than n varies, limits do not follow from an
    estimate of n: then only the truth is drawn.
    """
    true, believed = columns["n_front"], make_plant(briefing.vehicle, briefing.soil, flat())
    if plant is None and not log.stretches and np.ptp(true) > 1e-9:
        return []
    truth = believed if plant is None else plant
    estimating = log.estimating and truth.structure is None and truth.soil_field is None
    held, band = _Held(truth, true), _band(columns)
    expected = _Held(believed, np.concatenate(band)) if estimating else None
    charts = []
    for place, title, unit, factor in _LIMITS:
        lines = []
        if expected is not None and expected.is_known(place):
            ends = factor * np.array([expected.at(place, n) for n in band])
            low, high = ends.min(axis=0), ends.max(axis=0)  # a limit may rise and fall with n
            lines.append(Line(label="estimate", values=ends[1], low=low, high=high))
        if held.is_known(place):
            label = "with the true n" if plant is None else "true"
            lines.append(Line(label=label, values=factor * held.at(place, true), dashed=True))
        if lines:
            charts.append(Chart(title=title, unit=unit, lines=tuple(lines)))
    return charts


class _Held:
    """What the soil of a plant holds over n; of one that varies over metres, what its base does.

    Parameters
    ----------
    plant
    exponents
        n that will be asked for.
    """

    def __init__(self, plant: Plant, exponents: np.ndarray) -> None:
        low, high = max(float(exponents.min()), _LEAST_N), min(max(float(exponents.max()), 0.2), 2.0)
        self._n = np.unique(np.linspace(low, high, _SUPPORT))  # one, where n does not change
        soils: list[Soil] = [plant.soil._replace(n=float(n)) for n in self._n]
        if plant.soil_field is not None:  # its other parameters vary with n
            self._n, soils = np.array([plant.soil.n]), [plant.soil]
        self._limits = soils_hold(plant, soils)

    def is_known(self, place: int) -> bool:
        """Whether any of the soils carries the vehicle."""
        return bool(np.isfinite(self._limits[:, place]).any())

    def at(self, place: int, n: np.ndarray) -> np.ndarray:
        """A limit, by its place in `SoilHolds`."""
        found: np.ndarray = np.interp(n, self._n, self._limits[:, place])
        return found
