"""Replay of a log: windows predicted open loop by several models, and their errors.

Windows start from `planar_smoother`, which no model enters, and nothing is fitted. The errors, and nothing
else, use the reference columns where a log has them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.model.windows import stretches_of
from estimators.logs.log import Log
from estimators.logs.schema import REFERENCE
from estimators.logs.signals import uninterrupted
from estimators.logs.substitutes import substituted
from estimators.replay.inputs import input_rows
from estimators.replay.planar_smoother import V_X, V_Y, YAW, PlanarMotion, X, Y, smooth_motion
from estimators.replay.prediction import Predicted, predict_windows
from estimators.replay.structures import Case, plant_for
from offroad_env.errors import DataError, InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.axle import Plant
from offroad_env.simulation.simulator import FULL_STEP

__all__ = [
    "CHANNELS",
    "LEAD_IN",
    "Reality",
    "Replay",
    "WindowReplay",
    "grid_of",
    "pooled",
    "replay_log",
    "windows_of",
]

#: Compared quantities and their units.
CHANNELS = {
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "omega_f": "rad/s", "omega_r": "rad/s", "a_y": "m/s²",
    "position": "m", "yaw": "rad",
}  # fmt: skip
#: Before each window: ruts, attitude, heave and pitch settle [s].
LEAD_IN = 1.0
#: Limits of the grid's step [s], and of the window [s].
_FINEST, _COARSEST = 0.005, 0.02
_SHORTEST, _LONGEST = 0.1, 600.0
#: Columns of the state that a channel is read from.
_STATES = {
    "v_x": at.V_X, "v_y": at.V_Y, "yaw_rate": at.YAW_RATE, "omega_f": at.OMEGA_F, "omega_r": at.OMEGA_R,
    "yaw": at.YAW,
}  # fmt: skip
_SMOOTHED = {"v_x": V_X, "v_y": V_Y, "yaw": YAW}


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Errors of one model on one log."""

    log: str
    structure: str
    vehicle_model: str
    window_s: float
    t: np.ndarray  #: (K,) time since the start of a window [s]
    squares: dict[str, np.ndarray]  #: channel -> (K,) sum of squared errors over the windows
    counts: dict[str, np.ndarray]  #: channel -> (K,) windows in that sum
    windows: int
    failed: int  #: windows in which the vehicle sank or the solver found no contact
    references: tuple[str, ...]  #: channels that are compared with reference columns

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square error of every channel; NaN where nothing can be compared."""
        return {name: _root(self.squares[name].sum(), self.counts[name].sum()) for name in self.squares}

    @property
    def growth(self) -> dict[str, np.ndarray]:
        """Root mean square error over the time since the start of a window, (K,) each."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return {name: np.sqrt(self.squares[name] / self.counts[name]) for name in self.squares}


@dataclass(frozen=True, kw_only=True)
class Reality:
    """What predictions are compared with, a row per instant."""

    values: dict[str, np.ndarray]  #: channel -> (K,); for "position" x and y, (2, K)
    references: tuple[str, ...]  #: channels that come from reference columns


def _root(squares: float, count: float) -> float:
    return math.sqrt(squares / count) if count > 0 else math.nan


def grid_of(log: Log) -> np.ndarray:
    """Instants on which a log is replayed, (K,) [s]: those of its IMU, made even.

    Raises
    ------
    DataError
        For a log of fewer than two samples.
    """
    times = log.imu_times
    if len(times) < 2:
        raise DataError(f"{log.name}: has {len(times)} samples of its IMU; a replay needs a drive")
    step = round(float(np.clip(np.median(np.diff(times)), _FINEST, _COARSEST)), 6)
    count = math.floor((times[-1] - times[0]) / step + 1e-6)
    return np.asarray(times[0] + step * np.arange(count + 1))


def windows_of(log: Log, t: np.ndarray, window: float) -> np.ndarray:
    """Instants at which the lead-ins begin, (W,): windows of ``window`` [s] follow without overlap.

    They lie between interruptions of the log, and a lead-in reaches back into the window before.

    Raises
    ------
    InvalidParameter
        For a window that is not between 0.1 and 600 s.
    DataError
        If the log has room for none.
    """
    if not _SHORTEST <= window <= _LONGEST:
        raise InvalidParameter(f"window must be in [{_SHORTEST:g}, {_LONGEST:g}] s, got {window:g}")
    step = float(t[1] - t[0])
    lead, count = round(LEAD_IN / step), round(window / step)
    usable = uninterrupted(log, 0.5 * (t[1:] + t[:-1]))
    firsts = [
        first
        for begin, end in stretches_of(usable, 0, lead + count)
        for first in range(begin, end - lead - count + 1, count)
    ]
    if not firsts:
        raise DataError(
            f"{log.name}: lasts {t[-1] - t[0]:.3g} s without interruption at most; windows of {window:g} s "
            f"need more than {window + LEAD_IN:g} s: choose a shorter one"
        )
    return np.array(firsts)


def _reality(log: Log, motion: PlanarMotion) -> Reality:
    """Reference columns, and the smoothed channels where a log has none."""
    found: dict[str, np.ndarray] = {}
    for name in CHANNELS:
        columns = [f"{REFERENCE}{part}" for part in (("x", "y") if name == "position" else (name,))]
        rows = [_reference(log, column, motion.t) for column in columns]
        kept = [row for row in rows if row is not None]
        if len(kept) == len(rows):
            found[name] = np.array(kept) if name == "position" else kept[0]
    values = {name: motion.states[:, i] for name, i in _SMOOTHED.items()}
    values |= {name: getattr(motion, name) for name in ("yaw_rate", "omega_f", "omega_r", "a_y")}
    for name in ("yaw_rate", "a_y"):
        if name not in log.channels:
            values[name] = np.full(len(motion.t), math.nan)
    values["position"] = motion.states[:, [X, Y]].T
    return Reality(values=values | found, references=tuple(found))


def _reference(log: Log, column: str, t: np.ndarray) -> np.ndarray | None:
    """A reference column at the instants ``t``, or None where the log has none."""
    values = log.references.get(column)
    if values is None or np.isnan(values).all():
        return None
    known = ~np.isnan(values)
    rows = np.unwrap(values[known]) if column.endswith("yaw") else values[known]
    return np.asarray(np.interp(t, log.times[known], rows))


def _errors(predicted: Predicted, reality: Reality, instants: np.ndarray) -> dict[str, np.ndarray]:
    """Errors by channel, (W, K); the distance for the position."""
    states = predicted.states
    errors = {name: states[:, :, i] - reality.values[name][instants] for name, i in _STATES.items()}
    errors["yaw"] = np.remainder(errors["yaw"] + math.pi, 2.0 * math.pi) - math.pi
    errors["a_y"] = predicted.a_y - reality.values["a_y"][instants]
    x, y = (states[:, :, i] - reality.values["position"][row][instants] for row, i in enumerate((at.X, at.Y)))
    errors["position"] = np.hypot(x, y)
    return {name: errors[name] for name in CHANNELS}


class WindowReplay:
    """What the replay of a log needs besides a model, made once.

    Parameters
    ----------
    window
        Length of the windows [s].
    hold : {"zoh", "linear"}, optional
        How inputs go on between their rows; default: as the log states.
    step
        Longest step of the solver [s].
    references
        Whether predictions are compared with the reference columns, where there are any.

    Raises
    ------
    DataError
        If the log is no drive, too short, or lacks inputs or pose.
    InvalidParameter
        For an impossible window.
    """

    def __init__(
        self,
        log: Log,
        window: float,
        *,
        hold: str | None = None,
        step: float = FULL_STEP,
        references: bool = True,
    ) -> None:
        self.log = log
        t = grid_of(log)
        self._firsts = windows_of(log, t, window)
        # Channels that were not measured are substituted to smooth the motion, and are not compared.
        complete, _ = substituted(log)
        self._motion = smooth_motion(complete, t)
        self._steps = max(math.ceil(self._motion.step / step - 1e-6), 1)
        self._inputs = input_rows(log, t, self._steps, hold)
        compared = log if references else replace(log, references={})
        self._reality = _reality(compared, self._motion)
        self._lengths = round(LEAD_IN / self.step), round(window / self.step)
        self._instants = self._firsts[:, None] + self._lengths[0] + np.arange(self._lengths[1] + 1)

    @property
    def step(self) -> float:
        """Time between instants [s]."""
        return self._motion.step

    @property
    def shape(self) -> tuple[int, int]:
        """Number of windows, and of instants in each."""
        windows, instants = self._instants.shape
        return windows, instants

    @property
    def references(self) -> tuple[str, ...]:
        """Channels that are compared with reference columns."""
        return self._reality.references

    @property
    def instants(self) -> np.ndarray:
        """Places of the windows' instants on the log's grid (`grid_of`), (W, K)."""
        return self._instants

    def errors(self, plant: Plant, windows: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Errors of a model by channel, (W, K); NaN where nothing can be compared or the model fails.

        Parameters
        ----------
        windows : (W,) bool, optional
            Which windows are predicted, each for itself; default: all. Others have no row.
        """
        firsts, instants = self._firsts, self._instants
        if windows is not None:
            firsts, instants = firsts[windows], instants[windows]
        try:
            predicted = predict_windows(plant, self._motion, self._inputs, firsts, self._lengths, self._steps)
        except SolverFailure:
            return {name: np.full(instants.shape, math.nan) for name in CHANNELS}
        return _errors(predicted, self._reality, instants)


def replay_log(
    log: Log, cases: Sequence[Case], *, window: float = 4.0, hold: str | None = None, step: float = FULL_STEP
) -> tuple[Replay, ...]:
    """Predict a log in windows by every model of ``cases``, and compare.

    Parameters
    ----------
    window, hold, step
        See `WindowReplay`.

    Raises
    ------
    DataError
        If the log is no drive, too short, or lacks inputs or pose.
    InvalidParameter
        For an impossible window or an unknown model.
    """
    prepared = WindowReplay(log, window, hold=hold, step=step)
    windows, instants = prepared.shape
    found = []
    for case in cases:
        errors = prepared.errors(plant_for(log, case))
        # A window that fails has no error at its end: none of it counts, and the table says how many.
        complete = np.isfinite(errors["v_x"]).all(axis=1)
        kept = {name: values[complete] for name, values in errors.items()}
        found.append(
            Replay(
                log=log.name,
                structure=case.structure,
                vehicle_model=case.vehicle_model,
                window_s=window,
                t=prepared.step * np.arange(instants),
                squares={name: np.nansum(values**2, axis=0) for name, values in kept.items()},
                counts={name: np.isfinite(values).sum(axis=0) for name, values in kept.items()},
                windows=windows,
                failed=int((~complete).sum()),
                references=prepared.references,
            )
        )
    return tuple(found)


def pooled(replays: Sequence[Replay]) -> Replay:
    """All samples of several logs under one model as one, those of another step at the nearest instants."""
    first = replays[0]
    nearest = [np.abs(replay.t[:, None] - first.t).argmin(axis=1) for replay in replays]

    def total(name: str, kind: str) -> np.ndarray:
        rows = np.zeros(len(first.t), dtype=getattr(first, kind)[name].dtype)
        for replay, places in zip(replays, nearest, strict=True):
            np.add.at(rows, places, getattr(replay, kind)[name])
        return rows

    return Replay(
        log="1 log" if len(replays) == 1 else f"{len(replays)} logs",
        structure=first.structure,
        vehicle_model=first.vehicle_model,
        window_s=first.window_s,
        t=first.t,
        squares={name: total(name, "squares") for name in CHANNELS},
        counts={name: total(name, "counts") for name in CHANNELS},
        windows=sum(replay.windows for replay in replays),
        failed=sum(replay.failed for replay in replays),
        references=tuple(name for name in CHANNELS if all(name in replay.references for replay in replays)),
    )
