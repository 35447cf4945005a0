"""Residuals of a simulation by channel and driving regime, in its worst seconds, and against the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.protocol import Channel, Records
from estimators.discrepancy.model.run_model import RunModel, drives
from offroad_env.physics import state as at

__all__ = [
    "Dependence", "Misfit", "Stretch", "driving_regimes", "driving_states", "misfit_of", "rows_of_channel",
]  # fmt: skip

#: Length of the worst stretch, and of the blocks in which residuals count as one draw [s].
WORST, BLOCK = 5.0, 1.0
#: Bins of a residual over a quantity, of equal counts; least samples in a bin.
_BINS, _LEAST = 8, 20
#: Bounds of the regimes [m/s^2].
_SPEEDING, _TURNING = 0.4, 0.5
_STRETCH_POINTS = 250


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One channel in the worst seconds."""

    channel: str
    t: np.ndarray  #: (K,) [s]
    window: np.ndarray  #: (K,) number of the window: both models start anew in each
    measured: np.ndarray
    nominal: np.ndarray
    extended: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """Residuals of a channel over a quantity of the state, in bins of equal counts."""

    channel: str
    quantity: str
    centre: np.ndarray  #: (B,) mean of the quantity
    nominal: np.ndarray  #: (B,) mean residual
    extended: np.ndarray
    nominal_band: np.ndarray  #: (B,) half width, 95 % for all bins together
    extended_band: np.ndarray
    share: float  #: of the nominal residual's variance that depends on the quantity
    share_extended: float


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """Residuals of the nominal and the extended model on the windows of the search."""

    channels: tuple[str, ...]
    regimes: tuple[str, ...]
    seconds: np.ndarray  #: (R,) of data in every regime
    nominal: np.ndarray  #: (C, R) root mean square; NaN where a regime has too few samples
    extended: np.ndarray  #: (C, R)
    worst_run: str  #: name of the log with the worst seconds
    worst: tuple[Stretch, ...]  #: the channels that are wrong most
    dependences: tuple[Dependence, ...]  #: the strongest, one a channel


def misfit_of(nominal: FitResult, extended: FitResult) -> Misfit:
    """Compare two fits of the same data; without causes both may be the same."""
    before, after = nominal.residual, extended.residual
    pairs = zip(drives(extended.runs), extended.records, strict=True)
    states = [driving_states(run, records) for run, records in pairs]
    regimes = driving_regimes(states)
    names = tuple(dict.fromkeys(channel.name for run in nominal.runs for channel in run.channels))
    tables = np.full((2, len(names), len(regimes)), np.nan)
    for i, name in enumerate(names):
        rows = rows_of_channel(nominal, name)
        for j, inside in enumerate(regimes.values()):
            kept = np.concatenate([r[inside[k][c.record]] for k, c, r in rows])
            if len(kept) >= _LEAST:
                tables[:, i, j] = [np.sqrt(np.mean(values[kept] ** 2)) for values in (before, after)]
    steps = [run.step for run in nominal.runs]
    worst_run, worst = _worst(nominal, extended, before, after)
    return Misfit(
        channels=names,
        regimes=tuple(regimes),
        seconds=np.array(
            [sum(m.sum() * step for m, step in zip(masks, steps, strict=True)) for masks in regimes.values()]
        ),
        nominal=tables[0],
        extended=tables[1],
        worst_run=worst_run,
        worst=worst,
        dependences=_dependences(nominal, states, before, after),
    )


class _Rows(NamedTuple):
    """Samples of a channel in one run."""

    run: int  #: its number
    channel: Channel
    rows: np.ndarray  #: in the data of all runs


class _Binned(NamedTuple):
    """A residual by bins of a quantity."""

    mean: np.ndarray  #: (B,)
    band: np.ndarray  #: (B,) half width, 95 % for all bins together
    share: float  #: of the mean square that lies between the bins


def rows_of_channel(fit: FitResult, name: str) -> list[_Rows]:
    """Samples of a channel in all runs that have it."""
    return [
        _Rows(k, channel, np.arange(channel.rows.start, channel.rows.stop) + fit.problem.offsets[k])
        for k, run in enumerate(fit.runs)
        for channel in run.channels
        if channel.name == name
    ]


def driving_states(run: RunModel, records: Records) -> dict[str, np.ndarray]:
    """Quantities on which a residual may depend, at every record (R,)."""
    x, r, windows = records.states, records.readings, run.windows
    instants = np.concatenate(
        [np.arange(f, f + c + 1) for f, c in zip(windows.first, windows.count, strict=True)]
    )
    return {
        "speed [m/s]": x[:, at.V_X],
        "slip [-]": 0.5 * (r[:, at.SLIP] + r[:, at.AXLE + at.SLIP]),
        "front load [N]": r[:, at.N],
        "steering [rad]": x[:, at.STEER],
        "yaw rate [rad/s]": x[:, at.YAW_RATE],
        "a_x [m/s²]": r[:, at.A_X],
        "a_y [m/s²]": r[:, at.A_Y],
        "vertical speed [m/s]": x[:, at.V_Z],
        "drive torque [N m]": x[:, at.DRIVE] - x[:, at.BRAKE],
        "time [s]": run.t_0 + run.step * instants,
        "position x [m]": x[:, at.X],
        "position y [m]": x[:, at.Y],
    }


def driving_regimes(states: list[dict[str, np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Regime -> for every run which records (R,) belong to it; a moment may belong to several."""
    speeds = np.concatenate([table["speed [m/s]"] for table in states])
    slow, fast = np.quantile(speeds, (1.0 / 3.0, 2.0 / 3.0))
    found: dict[str, list[np.ndarray]] = {}
    for table in states:
        v, a_x, a_y = table["speed [m/s]"], table["a_x [m/s²]"], table["a_y [m/s²]"]
        masks = {
            "all": v > -np.inf,
            f"slow,\n< {slow:.1f} m/s": v < slow,
            f"fast,\n> {fast:.1f} m/s": v > fast,
            "speeding\nup": a_x > _SPEEDING,
            "braking": a_x < -_SPEEDING,
            "turning\nleft": a_y > _TURNING,
            "turning\nright": a_y < -_TURNING,
            "straight\non": np.abs(a_y) < _TURNING,
        }
        for name, mask in masks.items():
            found.setdefault(name, []).append(mask)
    return found


# ------------------------------------------------------------------ worst seconds


def _worst(
    nominal: FitResult, extended: FitResult, before: np.ndarray, after: np.ndarray
) -> tuple[str, tuple[Stretch, ...]]:
    """The seconds in which the nominal model is wrong most, by its squares in the extended one's units."""
    scale = {name: _rms(after, rows_of_channel(nominal, name)) for name in nominal.noise.pieces}
    best: tuple[float, int, float] = (-1.0, 0, 0.0)
    for k, run in enumerate(drives(nominal.runs)):
        if len(run.windows) == 0:
            continue
        begin = run.t_0 + run.step * run.windows.first
        end = run.t_0 + run.step * float((run.windows.first + run.windows.count).max())
        for start in np.arange(begin.min(), max(end - WORST, begin.min()) + 0.01, 0.5):
            size = sum(
                float(np.mean((before[_inside(nominal, k, c, start)] / scale[c.name]) ** 2))
                for c in run.channels
                if len(_inside(nominal, k, c, start))
            )
            best = max(best, (size, k, float(start)))
    _, k, start = best
    run = drives(nominal.runs)[k]
    stretches = {}
    for channel in run.channels:
        rows = _inside(nominal, k, channel, start)
        if len(rows) < _LEAST:
            continue
        ratio = float(np.sqrt(np.mean(before[rows] ** 2))) / scale[channel.name]
        stretches[channel.name] = (ratio, _stretch(nominal, extended, k, channel, rows))
    order = sorted(stretches.values(), key=lambda pair: -pair[0])
    return run.log.name, tuple(stretch for _, stretch in order[:4])


def _rms(residual: np.ndarray, rows: list[_Rows]) -> float:
    """Root mean square residual of a channel, at least what keeps a ratio finite."""
    values = residual[np.concatenate([r for _, _, r in rows])]
    return max(float(np.sqrt(np.mean(values**2))), 1e-12)


def _inside(fit: FitResult, k: int, channel: Channel, start: float) -> np.ndarray:
    """Rows of a channel of run ``k`` within the stretch from ``start`` [s]."""
    a, b = np.searchsorted(channel.t, (start, start + WORST))
    return np.asarray(np.arange(a, b) + channel.rows.start + fit.problem.offsets[k])


def _stretch(nominal: FitResult, extended: FitResult, k: int, channel: Channel, rows: np.ndarray) -> Stretch:
    rows = rows[:: max(len(rows) // _STRETCH_POINTS, 1)]
    own = rows - nominal.problem.offsets[k]
    return Stretch(
        channel=channel.name,
        t=channel.t[own - channel.rows.start],
        window=channel.window[own - channel.rows.start],
        measured=nominal.runs[k].y[own],
        nominal=nominal.prediction[rows],
        extended=extended.prediction[rows],
    )


# ------------------------------------------------------------------ residual against state


def _dependences(
    fit: FitResult, states: list[dict[str, np.ndarray]], before: np.ndarray, after: np.ndarray
) -> tuple[Dependence, ...]:
    """For every channel the quantity on which its nominal residual depends most; strongest first."""
    found = []
    for name in fit.noise.pieces:
        rows = rows_of_channel(fit, name)
        index = np.concatenate([r for _, _, r in rows])
        blocks = np.concatenate([k * 1_000_000 + (c.t // BLOCK).astype(int) for k, c, _ in rows])
        pairs = []
        for quantity in states[0]:
            values = np.concatenate([states[k][quantity][c.record] for k, c, _ in rows])
            made = _dependence(name, quantity, values, blocks, before[index], after[index])
            if made is not None:
                pairs.append(made)
        if pairs:
            found.append(max(pairs, key=lambda pair: pair.share))
    return tuple(sorted(found, key=lambda pair: -pair.share))


def _dependence(
    channel: str,
    quantity: str,
    values: np.ndarray,
    blocks: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> Dependence | None:
    """Residuals of both models over a quantity; None where its values do not fill the bins."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    if len(edges) < 3 or len(values) < _LEAST * _BINS:
        return None
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bins, minlength=len(edges) - 1)
    if count.min() < _LEAST:
        return None
    first, second = (_binned(residual, bins, count, blocks) for residual in (before, after))
    return Dependence(
        channel=channel,
        quantity=quantity,
        centre=np.bincount(bins, values) / count,
        nominal=first.mean,
        extended=second.mean,
        nominal_band=first.band,
        extended_band=second.band,
        share=first.share,
        share_extended=second.share,
    )


def _binned(residual: np.ndarray, bins: np.ndarray, count: np.ndarray, blocks: np.ndarray) -> _Binned:
    """Means of a residual by bin, and their simultaneous confidence band.

    Neighbouring samples err alike: what lies in one bin and one block of time counts as one draw.
    """
    mean = np.bincount(bins, residual) / count
    away = residual - mean[bins]
    _, cell = np.unique(blocks * len(count) + bins, return_inverse=True)
    sums = np.bincount(cell, away)
    bin_of_cell = np.zeros(len(sums), dtype=int)
    bin_of_cell[cell] = bins
    variance = np.bincount(bin_of_cell, sums**2, minlength=len(count)) / count**2
    wide = float(norm.ppf(1.0 - 0.025 / len(count)))
    total = max(float(np.mean(residual**2)), 1e-300)
    between = float(np.sum(count * mean**2) / len(residual))
    return _Binned(mean, wide * np.sqrt(variance), between / total)
