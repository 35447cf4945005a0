"""Records that an environment hands out, in copies: to controllers, to logs, to pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.filters.protocol import Estimate
from offroad_env.environment.episode_records import CONTROL_PERIOD
from offroad_env.environment.observation import PREVIEW
from offroad_env.environment.scenarios import Course, Scenario
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.simulation.drive import Command
from offroad_env.simulation.simulator import Plant

__all__ = ["Briefing", "Measurements", "Snapshot"]


@dataclass(frozen=True, kw_only=True)
class Briefing:
    """What a controller may know before it starts; the same whatever the true soil is."""

    scenario: str
    vehicle: Vehicle  #: nominal vehicle
    soil: Soil  #: believed soil, with n at the middle of ``n_range``
    n_range: tuple[float, float]  #: prior of the sinkage exponent: uniform [-]
    corridor: float  #: half width [m]
    target_speed: float  #: [m/s], 0 = as fast as possible
    time_limit: float  #: [s]
    stop_zone: float  #: > 0: stand within this distance before the end of the path [m]
    shake_limit: float  #: largest running r.m.s. of the vertical acceleration [m/s^2]
    preview: tuple[float, ...] = PREVIEW  #: distances of the observed curvatures [m]
    dt: float = CONTROL_PERIOD  #: [s]
    shear: str = "resultant"  #: shear law of the model, for `wheel_forces`

    @classmethod
    def of(
        cls, scenario: Scenario, vehicle: Vehicle, soil: Soil, n_range: tuple[float, float], model: str
    ) -> Briefing:
        """The briefing of a scenario with a nominal vehicle and a believed soil."""
        return cls(
            scenario=scenario.name,
            vehicle=vehicle,
            soil=soil,
            n_range=n_range,
            corridor=scenario.corridor,
            target_speed=scenario.target_speed,
            time_limit=scenario.time_limit,
            stop_zone=scenario.stop_zone,
            shake_limit=scenario.shake_limit,
            shear="resultant" if model == "full" else "independent",
        )


@dataclass(frozen=True, kw_only=True)
class Measurements:
    """Command and sensor samples of the last control period, in copies."""

    command: Command  #: as the kernels take it, see `OffroadBekkerEnv.command`
    samples: np.ndarray  #: (S, 11) of every sensor, `physics.imu`; none where the period broke off
    period: float  #: time between samples [s]


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The truth at one moment, for pictures and logs: arrays are copies."""

    scenario: Scenario
    course: Course
    plant: Plant  #: true vehicle, soil and ground
    model: str
    terrain_info: str
    time: float  #: [s]
    state: np.ndarray  #: (15,) or (19,), see `offroad_env.physics.state`
    readings: np.ndarray  #: (32,) or (85,), see `offroad_env.physics.state`
    contact: np.ndarray  #: (wheels, numbers) contact state, with the ruts where the structure has any
    command: tuple[float, float]  #: the last action: steering, drive [-]
    progress: float  #: distance along the path [m]
    cross_track_error: float  #: [m], left positive
    n_range: tuple[float, float]  #: prior of the sinkage exponent: uniform [-]
    estimate: Estimate | None  #: None where no estimator runs
    ending: str  #: "" while the episode goes on, "goal", or the failure
