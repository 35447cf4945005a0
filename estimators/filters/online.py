"""Choice of an online filter: which one runs, how often, and with what model of vehicle, soil and ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.filters.protocol import Estimate, Estimator, Pose
from estimators.filters.registry import FILTERS, ONLINE_FILTERS, SOIL_FILTERS, OnlineSetup, filter_id
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Ground, Soil, Vehicle
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import VEHICLE_MODELS, Plant, make_plant, plant_model

__all__ = ["KINDS", "OnBoard", "Thinned", "make_estimator"]

#: Ids of the online filters.
KINDS = (*ONLINE_FILTERS, *SOIL_FILTERS)


@dataclass(frozen=True, kw_only=True)
class OnBoard:
    """An online filter and its model. What is None is nominal; the ground is level.

    Raises
    ------
    InvalidParameter
        For an unknown kind or vehicle model, a rate outside [50, 1000] Hz, or ``changing`` or ``grade`` with
        a filter that has no setting for it.
    """

    kind: str = "online_joint_ukf"  #: one of `KINDS`, or a short name: "parameter", "joint", "bank", "belief"
    rate: float = 100.0  #: updates a second [Hz]; must divide the rate of the inertial unit
    vehicle: Vehicle | None = None  #: vehicle of the filter's model
    soil: Soil | None = None  #: its soil, all but n
    ground: Ground | None = None  #: its ground
    vehicle_model: str | None = None  #: "half_car" or "bicycle"
    changing: bool = False  #: n is known to change every few tens of metres; online_parameter_ukf only
    #: Standard deviation of the slope of the ground beyond that of its map [-], 0: the ground is known; None:
    #: that of `SoilBeliefSettings`. online_soil_belief only.
    grade: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", filter_id(self.kind, KINDS, label="kind"))
        if not 50.0 <= self.rate <= 1000.0:
            raise InvalidParameter(f"rate must be in [50, 1000] Hz, got {self.rate} - a period in s?")
        if self.changing and self.kind != "online_parameter_ukf":
            raise InvalidParameter(f'changing needs kind "online_parameter_ukf", got {self.kind!r}')
        if self.grade is not None and self.kind not in SOIL_FILTERS:
            raise InvalidParameter(f"grade needs kind {SOIL_FILTERS[0]!r}, got {self.kind!r}")
        if self.vehicle_model not in (None, *VEHICLE_MODELS):
            raise InvalidParameter(
                f"vehicle_model must be one of {', '.join(VEHICLE_MODELS)}, got {self.vehicle_model!r}"
            )

    def belief(self, plant: Plant) -> Plant:
        """``plant`` with the parts that this choice replaces; for a filter of n alone with rigid rims."""
        half_car = "half_car" if plant.half_car > 0.5 else "bicycle"
        return make_plant(
            self.vehicle or plant.vehicle,
            self.soil or plant.soil,
            self.ground or plant.ground,
            model=plant_model(plant),
            vehicle_model=self.vehicle_model or half_car,
            slip=plant.slip,
            structure=plant.structure if self.kind in SOIL_FILTERS else None,
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
        self._count, self._sampled, self._sum = 0, 0, np.zeros(5)
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
        """Take in one sample of every sensor; the inner estimator is updated at every ``every``-th."""
        self._count += 1
        if np.isfinite(imu).all():
            self._sum += imu
            self._sampled += 1
        if np.isfinite(rim_speeds).all():
            self._rims[:] = rim_speeds
        if np.isfinite(gnss).all():
            self._gnss[:] = gnss
        if self._count == self.every:
            mean = self._sum / self._sampled if self._sampled else np.full(5, np.nan)
            self._estimate = self.inner.update(command, mean, self._rims.copy(), self._gnss.copy())
            self._count = self._sampled = 0
            self._sum[:], self._rims[:], self._gnss[:] = 0.0, np.nan, np.nan
        return self._estimate

    @property
    def pose(self) -> Pose:
        """Of the inner estimator."""
        return self.inner.pose


def make_estimator(
    choice: OnBoard, plant: Plant, n_range: tuple[float, float], imu: ImuConfig, gnss: GnssConfig
) -> Estimator:
    """The estimator of a choice; not yet reset.

    Parameters
    ----------
    choice : OnBoard
    plant : Plant
        The nominal model.
    n_range : (float, float)
        Bounds of n [-].
    imu, gnss : ImuConfig, GnssConfig
        The sensors as far as they are known; ``imu.rate`` is that of the samples.

    Raises
    ------
    InvalidParameter
        When the rates do not divide, or the filter cannot work with the model.
    """
    every = round(imu.rate / choice.rate)
    if every < 1 or abs(every * choice.rate - imu.rate) > 1e-6 * imu.rate:
        raise InvalidParameter(
            f"rate must divide the {imu.rate:g} Hz of the inertial unit, got {choice.rate:g} Hz"
        )
    make = FILTERS[choice.kind].make
    assert make is not None  # `OnBoard` accepts online filters only
    setup = OnlineSetup(
        belief=choice.belief(plant),
        n_range=n_range,
        dt=every / imu.rate,
        imu=imu,
        gnss=gnss,
        changing=choice.changing,
        grade=choice.grade,
    )
    inner = make(setup)
    return inner if every == 1 else Thinned(inner, every)
