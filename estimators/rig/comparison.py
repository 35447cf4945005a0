"""Comparison of the wheel-soil model with the trials of a single-wheel rig.

Conventions of the trials are those of `estimators.rig.trials`. Residuals are measured less predicted.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from estimators.rig.trials import RigTrials
from offroad_env.errors import DataError, InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Structure, Wheel
from offroad_env.simulation.wheel import wheel_forces

__all__ = [
    "CHANNELS",
    "Channel",
    "ChannelScore",
    "ConditionTable",
    "Curve",
    "Prediction",
    "RigComparison",
    "compare",
    "predict",
]


class Channel(NamedTuple):
    """A quantity that a rig measures and the model predicts."""

    name: str  #: field of `RigTrials` and `Prediction`
    unit: str  #: SI unit
    title: str  #: for people


CHANNELS = (
    Channel("sinkage", "m", "sinkage"),
    Channel("drawbar", "N", "drawbar pull"),
    Channel("side_force", "N", "side force"),
)

_REASON_SIDEWAYS = "slip angle 90 deg: no speed along the wheel, so longitudinal slip does not exist"
_REASON_SUNK = "the soil of the model cannot carry the load above 0.95 of the wheel radius"


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Prediction of the model for each trial; arrays of shape (M,), NaN outside its domain."""

    sinkage: np.ndarray  #: [m]
    drawbar: np.ndarray  #: [N]
    side_force: np.ndarray  #: [N]
    outside: tuple[str, ...]  #: why this trial is outside of the model's domain; empty inside


@dataclass(frozen=True, kw_only=True)
class ChannelScore:
    """Error of one channel over the trials inside the model's domain, with 95 % intervals."""

    unit: str
    rmse: float
    rmse_interval: tuple[float, float]
    bias: float  #: mean of measured less predicted
    bias_interval: tuple[float, float]
    repeat_sd: float  #: pooled scatter between repeats: what a perfect model would leave


@dataclass(frozen=True, kw_only=True)
class ConditionTable:
    """Means over the repeats of each condition; arrays of shape (C,), or (C, 3) by `CHANNELS`."""

    condition: np.ndarray
    slip: np.ndarray
    slip_angle: np.ndarray  #: [rad]
    load: np.ndarray  #: [N]
    repeats: np.ndarray
    measured: np.ndarray  #: (C, 3)
    measured_sd: np.ndarray  #: (C, 3) standard deviation between repeats
    predicted: np.ndarray  #: (C, 3)
    residual: np.ndarray  #: (C, 3) mean of measured less predicted
    residual_sd: np.ndarray  #: (C, 3)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Model over slip at one slip angle and the mean load measured there."""

    slip_angle: float  #: [rad]
    load: float  #: [N]
    slip: np.ndarray  #: (K,)
    values: np.ndarray  #: (K, 3) by `CHANNELS`, NaN where the soil cannot carry the load


@dataclass(frozen=True, kw_only=True)
class RigComparison:
    """Measured against predicted: scores, conditions, model curves, and what was left out."""

    soil: Soil
    wheel: Wheel
    shear: str
    trials: int  #: all trials
    inside: int  #: trials inside the model's domain: the scores are over these
    outside: dict[str, int]  #: reason -> number of trials
    deeper_than_radius: int  #: trials inside whose measured sinkage exceeds the wheel's radius
    scores: dict[str, ChannelScore]
    conditions: ConditionTable
    curves: tuple[Curve, ...]

    def to_json(self) -> dict[str, Any]:
        """The comparison as plain numbers, lists and strings (NaN becomes None)."""
        return {
            "soil": self.soil._asdict(),
            "wheel": self.wheel._asdict(),
            "shear": self.shear,
            "trials": self.trials,
            "inside": self.inside,
            "outside": dict(self.outside),
            "deeper_than_radius": self.deeper_than_radius,
            "channels": [channel._asdict() for channel in CHANNELS],
            "scores": {name: asdict(score) for name, score in self.scores.items()},
            "conditions": {name: _plain(value) for name, value in vars(self.conditions).items()},
            "curves": [{name: _plain(value) for name, value in vars(curve).items()} for curve in self.curves],
        }

    def span(self, channel: str, slip_angle: float = 0.0) -> dict[str, tuple[float, float]]:
        """Smallest and largest condition mean, measured and predicted, at one slip angle [rad]."""
        column = [c.name for c in CHANNELS].index(channel)
        rows = self._rows_at(slip_angle)
        return {
            kind: (float(np.nanmin(values[rows, column])), float(np.nanmax(values[rows, column])))
            for kind, values in (
                ("measured", self.conditions.measured),
                ("predicted", self.conditions.predicted),
            )
        }

    def rmse_at(self, channel: str, slip_angle: float) -> float:
        """Error of the means of the conditions at one slip angle [rad], weighted by their repeats."""
        column = [c.name for c in CHANNELS].index(channel)
        rows = self._rows_at(slip_angle)
        squares = self.conditions.residual[rows, column] ** 2
        return float(np.sqrt(np.average(squares, weights=self.conditions.repeats[rows])))

    def _rows_at(self, slip_angle: float) -> np.ndarray:
        rows: np.ndarray = np.isclose(np.abs(self.conditions.slip_angle), abs(slip_angle), atol=1e-6)
        if not rows.any():
            raise InvalidParameter(f"no condition has a slip angle of {slip_angle:g} rad - degrees?")
        return rows


def predict(
    trials: RigTrials,
    soil: Soil,
    wheel: Wheel,
    *,
    shear: str = "independent",
    structure: str | Structure | None = None,
) -> Prediction:
    """Sinkage, drawbar pull and side force at the load, slip and slip angle of each trial.

    Parameters
    ----------
    trials
        Measured trials; only their inputs are used.
    soil, wheel
        What the model believes.
    shear, structure
        As in `wheel_forces`.

    Returns
    -------
    Prediction
        NaN and a reason where the model has no answer: at a slip angle of 90 degrees, and where
        the soil cannot carry the load.
    """
    outside = ["" if np.isfinite(slip) else _REASON_SIDEWAYS for slip in trials.slip]
    rows = np.flatnonzero(np.isfinite(trials.slip))
    values = np.full((len(trials), len(CHANNELS)), np.nan)
    model = _Model(soil, wheel, shear, structure)
    values[rows] = _predicted(model, trials.load[rows], trials.slip[rows], trials.slip_angle[rows])
    for row in rows:
        if not np.isfinite(values[row, 0]):
            outside[row] = _REASON_SUNK
    return Prediction(
        sinkage=values[:, 0], drawbar=values[:, 1], side_force=values[:, 2], outside=tuple(outside)
    )


class _Model(NamedTuple):
    """A wheel on its soil, and by which laws."""

    soil: Soil
    wheel: Wheel
    shear: str
    structure: str | Structure | None


def _predicted(model: _Model, load: np.ndarray, slip: np.ndarray, slip_angle: np.ndarray) -> np.ndarray:
    """(M, 3) by `CHANNELS`; NaN rows where the soil cannot carry the load."""
    if len(load) == 0:
        return np.empty((0, len(CHANNELS)))
    try:
        forces = wheel_forces(
            model.soil,
            model.wheel,
            load=load,
            slip=slip,
            slip_angle=slip_angle,
            shear=model.shear,
            structure=model.structure,
        )
    except SolverFailure:
        if len(load) == 1:
            return np.full((1, len(CHANNELS)), np.nan)
        # One failing trial fails the whole call: halve until it is alone.
        half = len(load) // 2
        parts = (slice(None, half), slice(half, None))
        return np.concatenate([_predicted(model, load[part], slip[part], slip_angle[part]) for part in parts])
    return np.stack([forces.sinkage, forces.F_x, forces.F_y], axis=1)


def compare(
    trials: RigTrials,
    soil: Soil,
    wheel: Wheel,
    *,
    shear: str = "independent",
    structure: str | Structure | None = None,
    resamples: int = 2000,
    seed: int = 0,
) -> RigComparison:
    """Predict every trial and score the prediction by channel.

    Parameters
    ----------
    trials, soil, wheel, shear, structure
        As in `predict`.
    resamples
        Bootstrap resamples behind the intervals.
    seed
        Seed of the bootstrap.

    Returns
    -------
    RigComparison
        Scores are over the trials inside the model's domain. Intervals are 95 % percentile
        intervals that resample whole conditions: repeats of one condition share the model's
        error, so resampling trials would make the intervals too narrow.

    Raises
    ------
    DataError
        When no trial is inside the model's domain.
    """
    if not (isinstance(resamples, int) and resamples >= 100):
        raise InvalidParameter(f"resamples must be an integer >= 100, got {resamples!r}")
    prediction = predict(trials, soil, wheel, shear=shear, structure=structure)
    inside = np.array([reason == "" for reason in prediction.outside])
    if not inside.any():
        raise DataError(f"no trial is inside the model's domain: {dict(Counter(prediction.outside))}")
    kept = trials.subset(inside)
    measured = np.stack([getattr(kept, channel.name) for channel in CHANNELS], axis=1)
    predicted = np.stack([getattr(prediction, channel.name)[inside] for channel in CHANNELS], axis=1)
    return RigComparison(
        soil=soil,
        wheel=wheel,
        shear=shear,
        trials=len(trials),
        inside=int(inside.sum()),
        outside=dict(Counter(reason for reason in prediction.outside if reason)),
        deeper_than_radius=int(np.sum(kept.sinkage > wheel.r)),
        scores=_scores(kept.condition, measured, predicted, resamples, np.random.default_rng(seed)),
        conditions=_condition_table(kept, measured, predicted),
        curves=_curves(kept, _Model(soil, wheel, shear, structure)),
    )


def _group_sums(condition: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum of ``values`` (M, K) over the rows of each condition, in the order of np.unique: (C, K)."""
    _, index = np.unique(condition, return_inverse=True)
    sums = np.zeros((index.max() + 1, values.shape[1]))
    np.add.at(sums, index, values)
    return sums


def _group_moments(condition: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(repeats (C,), mean (C, K), standard deviation between repeats (C, K), NaN for one repeat)."""
    _, index, counts = np.unique(condition, return_inverse=True, return_counts=True)
    mean = _group_sums(condition, values) / counts[:, None]
    squares = _group_sums(condition, (values - mean[index]) ** 2)
    freedom = np.where(counts > 1, counts - 1.0, np.nan)
    return counts, mean, np.sqrt(squares / freedom[:, None])


def _scores(
    condition: np.ndarray,
    measured: np.ndarray,
    predicted: np.ndarray,
    resamples: int,
    rng: np.random.Generator,
) -> dict[str, ChannelScore]:
    residual = measured - predicted
    counts, _, sd = _group_moments(condition, measured)
    sums = _group_sums(condition, residual)
    squares = _group_sums(condition, residual**2)
    draws = rng.integers(len(counts), size=(resamples, len(counts)))
    drawn = counts[draws].sum(axis=1)[:, None]
    rmse = np.sqrt(squares[draws].sum(axis=1) / drawn)
    bias = sums[draws].sum(axis=1) / drawn
    rmse_interval = np.percentile(rmse, [2.5, 97.5], axis=0)
    bias_interval = np.percentile(bias, [2.5, 97.5], axis=0)
    repeated = counts > 1
    freedom = counts[repeated] - 1
    pooled = np.sqrt((sd[repeated] ** 2 * freedom[:, None]).sum(axis=0) / max(freedom.sum(), 1))
    return {
        channel.name: ChannelScore(
            unit=channel.unit,
            rmse=float(np.sqrt(np.mean(residual[:, i] ** 2))),
            rmse_interval=(float(rmse_interval[0, i]), float(rmse_interval[1, i])),
            bias=float(np.mean(residual[:, i])),
            bias_interval=(float(bias_interval[0, i]), float(bias_interval[1, i])),
            repeat_sd=float(pooled[i]),
        )
        for i, channel in enumerate(CHANNELS)
    }


def _condition_table(trials: RigTrials, measured: np.ndarray, predicted: np.ndarray) -> ConditionTable:
    inputs = np.stack([trials.slip, trials.slip_angle, trials.load], axis=1)
    repeats, inputs_mean, _ = _group_moments(trials.condition, inputs)
    _, measured_mean, measured_sd = _group_moments(trials.condition, measured)
    _, predicted_mean, _ = _group_moments(trials.condition, predicted)
    _, residual_mean, residual_sd = _group_moments(trials.condition, measured - predicted)
    return ConditionTable(
        condition=np.unique(trials.condition),
        slip=inputs_mean[:, 0],
        slip_angle=inputs_mean[:, 1],
        load=inputs_mean[:, 2],
        repeats=repeats,
        measured=measured_mean,
        measured_sd=measured_sd,
        predicted=predicted_mean,
        residual=residual_mean,
        residual_sd=residual_sd,
    )


def _curves(trials: RigTrials, model: _Model, points: int = 121) -> tuple[Curve, ...]:
    slip = np.linspace(-1.0, 1.0, points)
    curves = []
    for angle in np.unique(np.round(trials.slip_angle, 9))[::-1]:
        rows = np.isclose(trials.slip_angle, angle, atol=1e-8)
        load = float(np.mean(trials.load[rows]))
        values = _predicted(model, np.full(points, load), slip, np.full(points, angle))
        curves.append(Curve(slip_angle=float(angle), load=load, slip=slip, values=values))
    return tuple(curves)


def _plain(value: Any) -> Any:
    """Arrays as nested lists, NaN as None: what JSON can hold."""
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
