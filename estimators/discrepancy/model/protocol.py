"""What the fit, the search and the checks need of data, of a model of them, and of their noise.

A drive of a vehicle and a set of steady trials of a wheel are fitted by the same code. Each is a
`ForwardModel` with nuisances of its own, and each has its own `NoiseModel`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from estimators.discrepancy.model.windows import Windows
from estimators.logs.log import Log
from offroad_env.effects import Setup

__all__ = ["Channel", "ForwardModel", "NoiseModel", "Nuisance", "Records"]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """Samples of one sensor that lie in windows; they are the ``rows`` of the run's data."""

    name: str
    rows: slice
    t: np.ndarray  #: (M,) [s]
    window: np.ndarray  #: (M,)
    record: np.ndarray  #: (M,) the record before the sample
    weight: np.ndarray  #: (M,) share of the record after it [-]
    lever: np.ndarray | None = None  #: (M,) factor of the residuals: the speed of a course [m/s]


@dataclass(frozen=True, kw_only=True)
class Records:
    """Simulated windows, one record an instant of the grid; of trials, one record a trial."""

    states: np.ndarray  #: (R, 15)
    readings: np.ndarray  #: (R, 32)


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """A parameter common to all windows that is never exactly as stated, with its prior; mean 0."""

    name: str
    change: Callable[[Setup, ForwardModel, float], Setup]  #: of a setup as stated, for a run and a value
    spread: float  #: standard deviation of the prior
    step: float  #: of its finite difference
    sensors_only: bool = False  #: the motion of the vehicle does not depend on it
    limits: tuple[float, float] = (-np.inf, np.inf)  #: of an unmodified vehicle
    hard_limits: tuple[float, float] | None = None  #: the same on hard ground, where it differs
    hard: bool = False  #: of hard ground alone
    soft: bool = False  #: of soil alone
    tolerated: bool = False  #: a number that is stated to a tolerance, where the log does not call it exact
    effect: str = ""  #: what is beyond that tolerance, by its name in the library; empty: nothing
    own: bool = False  #: of every drive its own, where several drives of one vehicle are fitted together
    log: str = ""  #: hash of the only log in which it acts; empty: in all
    unknown: str = ""  #: what the log must call unknown
    unit: str = ""  #: of what the log calls unknown; lengths [m] are fitted in wheelbases
    pitching: bool = False  #: is observable by the pitching alone, which springs and torques make


class ForwardModel(Protocol):
    """The data of one run, and the model that predicts them."""

    @property
    def log(self) -> Log:
        """The measured run."""

    @property
    def setup(self) -> Setup:
        """Vehicle or wheel, soil, inputs and sensors as stated."""

    @property
    def step(self) -> float:
        """Step of the grid of records [s]; 0 for steady trials."""

    @property
    def period(self) -> float:
        """Usual time between samples [s]; 0 for steady trials."""

    @property
    def driven(self) -> bool:
        """Whether drive and brake inputs are known; else the wheels turn as measured."""

    @property
    def windows(self) -> Windows:
        """Pieces that are simulated one by one."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Where the samples of every sensor are in the data."""

    @property
    def y(self) -> np.ndarray:
        """(M,) data."""

    @property
    def free(self) -> tuple[int, ...]:
        """Indices of the states that are free at the start of every window."""

    @property
    def spread(self) -> np.ndarray:
        """(W, S) standard deviations of their priors."""

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisances of this kind of run."""

    @property
    def renews_derivatives(self) -> bool:
        """Whether every step of a descent takes new derivatives."""

    def size_limits(self, effect: str) -> tuple[float, float]:
        """Smallest and largest size of an effect that the model takes."""

    def refined(self) -> Self:
        """The same with a finer solver."""

    def coarse(self) -> Self:
        """The same with a coarser solver, enough for derivatives."""

    def rough(self) -> Self:
        """A coarser one still, enough for derivatives by what is no input."""

    def first_starts(self, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
        """States (W, 15) and warm starts (W, 2, 3) at the beginning of the windows, from the sensors."""

    def moved_by(self, setup: Setup, other: Setup) -> bool:
        """Whether the motion differs between two setups that differ in their sensors alone."""

    def displaced(self, setup: Setup, records: Records, state: int, by: float) -> Records | None:
        """The records where a free state differs ``by`` so much at every start; None: to be simulated."""

    def simulate(self, setup: Setup, starts: np.ndarray, warm: np.ndarray, windows: Windows) -> Records:
        """Simulate all ``windows`` from their ``starts`` (W, 15) and warm starts (W, 2, 3)."""

    def predict(self, setup: Setup, records: Records) -> np.ndarray:
        """Samples (M,) that the sensors should read."""

    def residual(self, prediction: np.ndarray) -> np.ndarray:
        """Measured less predicted, (M,)."""


class NoiseModel(Protocol):
    """Noise of every channel; immutable."""

    @property
    def pieces(self) -> Mapping[str, Sequence[slice]]:
        """Channel -> rows of the data of all runs whose noise is correlated, piece by piece."""

    @property
    def orders(self) -> dict[str, int]:
        """Channel -> number of earlier samples that the noise of one depends on."""

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Copy of (M,) or (M, k) in which the noise has unit variance and no correlation."""

    def log_scale(self) -> float:
        """Logarithm of the determinant of the whitening, with its sign changed: part of -log L."""

    def learned(self, residual: np.ndarray, freedom: Mapping[str, float], *, white: bool = False) -> Self:
        """Noise estimated from residuals (M,).

        Parameters
        ----------
        freedom
            Channel -> number of parameters that the fit has spent on its residuals.
        white
            Take the noise for white.
        """
