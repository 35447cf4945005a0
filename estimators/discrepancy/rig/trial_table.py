"""Trials of a wheel rig in one table: conditions, and which of them are for what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.model.windows import FIT, REPORT, SELECT
from estimators.logs.log import Log
from offroad_env.errors import DataError
from offroad_env.physics import state as at

__all__ = ["RIG_CHANNELS", "Trials", "condition_means"]

#: Channel of a rig -> its index in the readings of the model.
RIG_CHANNELS = {"sinkage": at.SINKAGE, "drawbar": at.F_L, "side_force": at.F_C, "torque": at.TORQUE}
#: Settings that lie no further apart are repeats of one: slip angle [rad], slip [-], share of the load. Steps
#: of 0.02 are meant.
_SAME_ANGLE, _SAME_SLIP, _SAME_LOAD = 0.019, 0.019, 0.15
#: Fewer conditions than this leave none for a hold-out test of the search.
_FEWEST = 15


@dataclass(frozen=True, kw_only=True)
class Trials:
    """Steady trials for which the model has a prediction, in one table; arrays of shape (M,)."""

    slip: np.ndarray
    slip_angle: np.ndarray  #: [rad]
    load: np.ndarray  #: [N]
    condition: np.ndarray  #: 0 ... C - 1 in the order of slip angle, slip and load
    channels: dict[str, np.ndarray]  #: measured, NaN = no sample
    left_out: int  #: trials without a slip along the wheel, or without load
    #: Standard deviations of what all repeats of the trial's condition have too much in common.
    load_error: np.ndarray  #: [N]
    slip_error: np.ndarray  #: [-]

    def __len__(self) -> int:
        return len(self.slip)

    def only(self, rows: np.ndarray) -> Trials:
        """Some of the trials; conditions keep their numbers."""
        return Trials(
            slip=self.slip[rows],
            slip_angle=self.slip_angle[rows],
            load=self.load[rows],
            condition=self.condition[rows],
            channels={name: values[rows] for name, values in self.channels.items()},
            left_out=self.left_out,
            load_error=self.load_error[rows],
            slip_error=self.slip_error[rows],
        )

    @classmethod
    def of(cls, logs: Sequence[Log]) -> Trials:
        """The trials of all logs together, settings as measured; see `settings.measured_trials`.

        Raises
        ------
        DataError
            If the logs are not of one wheel on one soil, or no trial can be used.
        """
        for log in logs[1:]:
            if (log.config.wheel, log.config.soil) != (logs[0].config.wheel, logs[0].config.soil):
                raise DataError(f"{log.name}: has another wheel or soil than {logs[0].name}")
        count = sum(len(log) for log in logs)
        table = {
            name: np.concatenate([log.channels.get(name, np.full(len(log), np.nan)) for log in logs])
            for name in ("slip", "slip_angle", "load", "condition", *RIG_CHANNELS)
        }
        angle = np.nan_to_num(table["slip_angle"])
        good = np.isfinite(table["slip"]) & (table["load"] > 0.0) & (np.abs(angle) < np.radians(89.9))
        if not good.any():
            raise DataError(f"{logs[0].name}: no trial has a slip along the wheel and a load")
        slip, angle, load = table["slip"][good], angle[good], table["load"][good]
        return cls(
            slip=slip,
            slip_angle=angle,
            load=load,
            condition=_conditions(angle, slip, load, table["condition"][good]),
            channels={
                name: table[name][good] for name in RIG_CHANNELS if np.isfinite(table[name][good]).any()
            },
            left_out=count - int(good.sum()),
            load_error=np.zeros(len(slip)),
            slip_error=np.zeros(len(slip)),
        )

    def levels(self) -> np.ndarray:
        """(M,) number of the slip angle's level, by its size."""
        return _clusters(np.abs(self.slip_angle), _SAME_ANGLE)

    def uses(self, held: int | None = None) -> np.ndarray:
        """What every trial is for: FIT, SELECT or REPORT, all repeats of a condition the same.

        Where there are three slip angles or more, a whole one is kept for the report: number ``held``,
        by default the middle one. Else every fifth condition is. A fifth of all is for the hold-out test.
        """
        count = int(self.condition.max()) + 1
        if count < _FEWEST:
            return np.full(len(self), FIT)
        levels = self.levels()
        use = np.full(count, FIT)
        if levels.max() < 2:
            use[3::5], use[1::5] = REPORT, SELECT
            return np.asarray(use[self.condition])
        held = (int(levels.max()) + 1) // 2 if held is None else held
        level_of = np.zeros(count, int)
        level_of[self.condition] = levels
        use[level_of == held] = REPORT
        others = np.flatnonzero(level_of != held)
        use[others[1::4]] = SELECT
        return np.asarray(use[self.condition])


def condition_means(condition: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of ``values`` (M,) over the trials of each trial's own condition, (M,)."""
    group = np.unique(condition, return_inverse=True)[1]
    mean = np.bincount(group, values) / np.bincount(group)
    return np.asarray(mean[group])


def _clusters(values: np.ndarray, gap: float) -> np.ndarray:
    """Number of the group of every value, by size; groups lie further apart than ``gap``."""
    order = np.argsort(values, kind="stable")
    number = np.concatenate([[0], np.cumsum(np.diff(values[order]) > gap)])
    found = np.empty(len(values), int)
    found[order] = number
    return found


def _conditions(angle: np.ndarray, slip: np.ndarray, load: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Number of the condition of every trial: by label where all have one, else by nearness."""
    if np.isfinite(label).all():
        groups = np.unique(label, return_inverse=True)[1]
    else:
        groups = _clusters(angle, _SAME_ANGLE)
        for values, gap in ((slip, _SAME_SLIP), (np.log(load), _SAME_LOAD)):
            parts = np.empty(len(groups), int)
            for group in np.unique(groups):
                rows = groups == group
                parts[rows] = _clusters(values[rows], gap)
            groups = groups * (parts.max() + 1) + parts
        groups = np.unique(groups, return_inverse=True)[1]
    count = np.bincount(groups)
    means = [np.bincount(groups, values) / count for values in (load, slip, angle)]
    rank = np.empty(len(count), int)
    rank[np.lexsort(means)] = np.arange(len(count))
    return rank[groups]
