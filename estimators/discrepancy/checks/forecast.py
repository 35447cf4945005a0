"""Open-loop prediction: started from a second of data, then simulated without further data.

Each forecast begins with a window of its own, whose start is fitted to the sensors. From its end on the model
runs on the inputs alone and is compared with the position, speed and heading measured 1, 3 and 10 s later.
The windows lie in the report's part of the runs, or in the pause before it that no fit has seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.checks.holdout_gain import held_out
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.protocol import ForwardModel
from estimators.discrepancy.model.run_model import RunModel, drives
from estimators.discrepancy.model.starts import COURSE_SPEED
from estimators.discrepancy.model.windows import REPORT, Windows
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at

__all__ = ["HORIZONS", "Prediction", "predictions"]

HORIZONS = (1.0, 3.0, 10.0)  #: [s]
#: Length of the window that starts a forecast; pause before the report's windows that may be used [s].
_LEAD, _PAUSE = 1.0, 5.0
#: Most forecasts: enough for an interval, and a bound of the work for a long log.
_MOST = 120
#: Longest time between an instant of comparison and the nearest sample [s].
_NEAR = 0.15
_DRAWS = 2000
#: Quantity -> unit.
_QUANTITIES = {"position": "m", "speed": "m/s", "heading": "rad"}
#: What a forecast without any model errs by: the speed stays as it is.
_KEPT = "kept speed"


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Root mean square error of forecasts; both models start from the same samples."""

    quantity: str
    unit: str
    horizon: float  #: [s]
    count: int  #: forecasts
    nominal: float
    extended: float
    low: float  #: 95 % interval of 1 - extended / nominal; NaN where the forecasts are too few
    high: float
    #: Of speeds: error if the speed stayed as it was measured at the start; else NaN.
    kept: float = math.nan
    #: Upper end of the 95 % interval of 1 - extended / kept; NaN where the forecasts are too few.
    kept_high: float = math.nan


@dataclass(frozen=True, kw_only=True)
class _Forecasts:
    """A run with one short window before each forecast."""

    run: RunModel
    begin: int  #: instants of the grid between which forecasts are compared
    end: int


def predictions(
    nominal: FitResult, extended: FitResult, runs: Sequence[ForwardModel], *, seed: int = 0
) -> tuple[Prediction, ...]:
    """Errors of both models on ``runs``, which hold the windows of the report, by horizon and quantity.

    Empty where the logs have no position, speed or course.
    """
    parts = [part for part in map(_forecasts, drives(runs)) if part is not None]
    if not parts:
        return ()
    try:
        before, after = _errors(nominal, parts), _errors(extended, parts)
    except OffroadError:
        return ()
    rng, found = np.random.default_rng(seed), []
    for quantity, horizon in before:
        if quantity == _KEPT:
            continue
        columns = [before[quantity, horizon], after[quantity, horizon]]
        columns += [before[_KEPT, horizon]] if quantity == "speed" else []
        errors = np.column_stack(columns)
        errors = errors[np.isfinite(errors).all(axis=1)]
        if len(errors):
            found.append(_prediction(quantity, horizon, errors, rng))
    return tuple(found)


def _forecasts(run: RunModel) -> _Forecasts | None:
    """Windows that start forecasts within the report's part; None where none fits."""
    if len(run.windows) == 0:
        return None
    begin, end = int(run.windows.first[0]), int((run.windows.first + run.windows.count).max())
    lead, ahead, pause = (round(span / run.step) for span in (_LEAD, min(HORIZONS), _PAUSE))
    first = np.arange(max(begin - pause, lead), end - lead - ahead + 1, lead)
    if len(first) == 0:
        return None
    first = first[:: math.ceil(len(first) / _MOST)]
    windows = Windows(first=first, count=np.full(len(first), lead), use=np.full(len(first), REPORT))
    return _Forecasts(run=run.with_windows(windows), begin=begin, end=end)


def _errors(fit: FitResult, parts: Sequence[_Forecasts]) -> dict[tuple[str, float], np.ndarray]:
    """Error of every forecast by quantity and horizon; NaN where nothing was measured then."""
    started = held_out(fit, [part.run for part in parts]).fit
    found: dict[tuple[str, float], list[np.ndarray]] = {}
    setups, point = started.linearisation.setups, started.point
    for part, setup, records, warm in zip(parts, setups, started.records, point.warm, strict=True):
        run = part.run
        first = run.windows.first + run.windows.count
        longest = np.minimum(round(max(HORIZONS) / run.step), part.end - first)
        alone = Windows(first=first, count=longest, use=run.windows.use)
        states = run.simulate(setup, records.states[run.windows.begin[1:] - 1], warm, alone).states
        for horizon in HORIZONS:
            ahead = round(horizon / run.step)
            # Compared within the report's part alone, wherever the forecast began.
            kept = (ahead <= longest) & (first + ahead >= part.begin)
            reached = states[alone.begin[:-1][kept] + ahead]
            start = run.t_0 + run.step * first[kept]
            errors = _compared(run, reached, start, start + run.step * ahead)
            for quantity, error in errors.items():
                found.setdefault((quantity, horizon), []).append(error)
    return {key: np.concatenate(errors) for key, errors in found.items()}


def _compared(run: RunModel, x: np.ndarray, start: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Errors of states (F, 15) at ``t`` (F,) against what was measured, of forecasts from ``start`` (F,)."""
    speed, heading = np.hypot(x[:, at.V_X], x[:, at.V_Y]), x[:, at.YAW]
    if "yaw" in run.log.channels:
        measured = _measured(run, "yaw", t)
    else:
        heading = heading + np.arctan2(x[:, at.V_Y], x[:, at.V_X])
        # At a crawl a course is noise.
        measured = np.where(speed > COURSE_SPEED, _measured(run, "course", t), np.nan)
    name = "speed" if "speed" in run.log.channels else "v_x"
    own = _measured(run, name, t)
    return {
        "position": np.hypot(x[:, at.X] - _measured(run, "x", t), x[:, at.Y] - _measured(run, "y", t)),
        "speed": speed - own,
        _KEPT: _measured(run, name, start) - own,
        "heading": np.remainder(heading - measured + math.pi, 2.0 * math.pi) - math.pi,
    }


def _measured(run: RunModel, name: str, t: np.ndarray) -> np.ndarray:
    """A channel at ``t`` (F,) [s] between its samples; NaN where there are none near."""
    if name not in run.log.channels:
        return np.full(len(t), np.nan)
    times, values = run.log.samples(name)
    values = np.unwrap(values) if name in ("course", "yaw") else values
    nearest = np.abs(times[:, None] - t).min(axis=0)
    return np.where(nearest <= _NEAR, np.interp(t, times, values), np.nan)


def _prediction(quantity: str, horizon: float, errors: np.ndarray, rng: np.random.Generator) -> Prediction:
    """Errors (F, 2 or 3) of the nominal and the extended model, and of no model at all, in one line.

    Forecasts of neighbouring starts see the same ground: blocks as long as the horizon are drawn together.
    """
    squares = errors**2
    before, after, *kept = np.sqrt(squares.mean(axis=0)).tolist()
    size = max(round(horizon / _LEAD), 1)
    low = high = kept_high = math.nan
    if len(errors) >= 3 * size:
        blocks = math.ceil(len(errors) / size)
        begins = rng.integers(len(errors), size=(_DRAWS, blocks))
        index = ((begins[:, :, None] + np.arange(size)) % len(errors)).reshape(_DRAWS, -1)
        drawn = np.maximum(np.sqrt(squares[index].mean(axis=1)), 1e-300)
        low, high = np.quantile(1.0 - drawn[:, 1] / drawn[:, 0], (0.025, 0.975)).tolist()
        if kept:
            kept_high = float(np.quantile(1.0 - drawn[:, 1] / drawn[:, 2], 0.975))
    return Prediction(
        quantity=quantity,
        unit=_QUANTITIES[quantity],
        horizon=horizon,
        count=len(errors),
        nominal=before,
        extended=after,
        low=low,
        high=high,
        kept=kept[0] if kept else math.nan,
        kept_high=kept_high,
    )
