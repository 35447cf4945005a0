"""Which estimator a vehicle carries, how often it runs and what it believes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.embedded import CHANGING_SOIL, EmbeddedParameterUKF
from estimators.on_board import OnBoardFilter, OnBoardSettings
from estimators.protocol import Estimate, Estimator, Pose
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Ground, Soil, Vehicle
from offroad_env.sensors import GnssConfig, ImuConfig
from offroad_env.simulator import VEHICLE_MODELS, Plant, make_plant, plant_model

__all__ = ["KINDS", "OnBoard", "Thinned", "make_estimator"]

#: Parameter: the model's copies differ in n alone. Joint: state and n in one belief. Bank: a sum of these.
KINDS = ("parameter", "joint", "bank")
#: Hypotheses of a bank at the start: each covers a fifth of the prior.
_COMPONENTS = 5


@dataclass(frozen=True, kw_only=True)
class OnBoard:
    """An estimator to be carried. What is None is as the vehicle's own papers say: nominal, on level ground.

    Raises
    ------
    InvalidParameter
        For an unknown kind or vehicle model, a rate outside [50, 1000] Hz, or ``changing`` with a filter that
        cannot be told.
    """

    kind: str = "joint"  #: one of `KINDS`
    rate: float = 100.0  #: updates a second [Hz]; must divide the rate of the inertial unit
    vehicle: Vehicle | None = None  #: believed vehicle
    soil: Soil | None = None  #: believed soil, all but its n
    ground: Ground | None = None  #: believed ground
    vehicle_model: str | None = None  #: "half_car" or "bicycle"
    changing: bool = False  #: whether n is known to change every few tens of metres, kind "parameter" only

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidParameter(f"kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        if not 50.0 <= self.rate <= 1000.0:
            raise InvalidParameter(f"rate must be in [50, 1000] Hz, got {self.rate} - a period in s?")
        if self.changing and self.kind != "parameter":
            raise InvalidParameter(f'changing needs kind "parameter", got {self.kind!r}')
        if self.vehicle_model not in (None, *VEHICLE_MODELS):
            raise InvalidParameter(
                f"vehicle_model must be one of {', '.join(VEHICLE_MODELS)}, got {self.vehicle_model!r}"
            )

    def belief(self, plant: Plant) -> Plant:
        """``plant`` with what is believed otherwise."""
        half_car = "half_car" if plant.half_car > 0.5 else "bicycle"
        return make_plant(
            self.vehicle or plant.vehicle,
            self.soil or plant.soil,
            self.ground or plant.ground,
            model=plant_model(plant),
            vehicle_model=self.vehicle_model or half_car,
            slip=plant.slip,
        )


class Thinned:
    """An estimator that runs more slowly than the sensors: it gets the mean of the inertial samples.

    Parameters
    ----------
    inner : Estimator
        Made for ``every`` times the sensors' period.
    every : int
        Samples to an update.
    """

    def __init__(self, inner: Estimator, every: int) -> None:
        self.inner, self.every = inner, int(every)

    def reset(self, n_prior: float, sd: float, pose: Pose) -> Estimate:
        """As the inner estimator's."""
        self._count, self._sum = 0, np.zeros(5)
        self._rims, self._gnss = np.full(2, np.nan), np.full(4, np.nan)
        self._estimate = self.inner.reset(n_prior, sd, pose)
        return self._estimate

    def update(
        self,
        command: tuple[float, float, float],
        imu: np.ndarray,
        rim_speeds: np.ndarray,
        gnss: np.ndarray,
    ) -> Estimate:
        """Take in one sample of every sensor; the belief moves at every ``every``-th."""
        self._sum += imu
        self._count += 1
        if np.isfinite(rim_speeds).all():
            self._rims[:] = rim_speeds
        if np.isfinite(gnss).all():
            self._gnss[:] = gnss
        if self._count == self.every:
            mean = self._sum / self.every
            self._estimate = self.inner.update(command, mean, self._rims.copy(), self._gnss.copy())
            self._count = 0
            self._sum[:], self._rims[:], self._gnss[:] = 0.0, np.nan, np.nan
        return self._estimate


def make_estimator(
    choice: OnBoard, plant: Plant, n_range: tuple[float, float], imu: ImuConfig, gnss: GnssConfig
) -> Estimator:
    """The estimator of a choice; not yet reset.

    Parameters
    ----------
    choice : OnBoard
    plant : Plant
        The nominal belief.
    n_range : (float, float)
        Bounds of n [-].
    imu, gnss : ImuConfig, GnssConfig
        The sensors as far as they are known; ``imu.rate`` is that of the samples.

    Raises
    ------
    InvalidParameter
        When the rates do not divide, or the estimator cannot work with the belief.
    """
    every = round(imu.rate / choice.rate)
    if every < 1 or abs(every * choice.rate - imu.rate) > 1e-6 * imu.rate:
        raise InvalidParameter(
            f"rate must divide the {imu.rate:g} Hz of the inertial unit, got {choice.rate:g} Hz"
        )
    belief, dt = choice.belief(plant), every / imu.rate
    if choice.kind == "parameter":
        told = CHANGING_SOIL if choice.changing else None
        inner = EmbeddedParameterUKF(belief, n_range, dt=dt, imu=imu, settings=told)
    else:
        settings = OnBoardSettings(components=_COMPONENTS if choice.kind == "bank" else 1)
        inner = OnBoardFilter(belief, n_range, dt=dt, imu=imu, gnss=gnss, settings=settings)
    return inner if every == 1 else Thinned(inner, every)
