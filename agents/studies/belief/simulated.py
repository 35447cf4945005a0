"""Drives of this project's own models on soils of the population, described with errors.

Soil, vehicle and sensors are drawn as the belief supposes them to be (`estimators.belief.unknowns`): over
many drives its intervals must hold the truth as often as they state.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.belief.unknowns import MODULUS, UNKNOWN_NAMES, N, applied, unknowns_of
from estimators.logs import Log
from estimators.logs.config import StartSpec
from estimators.logs.runs import config_of, log_of_drive
from estimators.replay.inputs import InputRows
from offroad_env.errors import SolverFailure
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.drive import Driver, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.simulation.soil_holds import what_soil_holds
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = ["STRUCTURES", "clean_log"]

#: Structures of the truth, one after the other.
STRUCTURES = ("grid", "full", "field")
_DURATION, _TRIES = 30.0, 200
#: A drive is worth a trial where rolling resistance takes less than this share of the largest pull.
_PASSABLE = 0.5
#: Speeds that are asked for [m/s], share of the lateral limit that is steered to, gain [N m s/m].
_SPEEDS, _LATERAL, _GAIN = (2.5, 5.5), 0.6, 1500.0


def clean_log(seed: int) -> tuple[Log, Plant]:
    """A drive of 30 s and the true vehicle on its soil; the description errs by the belief's tolerances.

    Raises
    ------
    SolverFailure
        Where no drawn soil lets the vehicle drive.
    """
    rng = np.random.default_rng((18, seed))
    prior, structure = SoilPrior.fitted(), STRUCTURES[seed % len(STRUCTURES)]
    vehicle = VEHICLES["mrzr"]
    for _ in range(_TRIES):
        stated = make_plant(vehicle, prior.sample(rng), flat(), structure=structure)
        truth, departure = _departed(stated, rng)
        limits = what_soil_holds(truth)
        if not limits.carried or limits.resistance > _PASSABLE * limits.pull or limits.pull <= 0.0:
            continue
        sensors = SensorSuite(
            imu=ImuConfig(),
            wheel=WheelSpeedConfig(rate=100.0, noise=0.01, scale_sd=0.0),
            gnss=GnssConfig(rate=5.0, position_sd=0.03, velocity_sd=0.03),
        )
        driver = _driver(rng, truth, limits.lateral, limits.resistance, departure.steer)
        try:
            drive = simulate_drive(truth, driver, sensors, rng, duration=_DURATION, speed=3.0)
        except SolverFailure:
            continue
        config = config_of(stated, sensors, StartSpec(x=0.0, y=0.0, yaw=0.0, v_x=3.0))
        log = log_of_drive(
            replace(drive, commands=departure.logged(drive.commands)), config, f"clean_{seed:03d}"
        )
        return log, truth
    raise SolverFailure(f"{_TRIES} soils of the population and no drive on any of them")


class _Departure(NamedTuple):
    """What acts on the vehicle where its log states something else."""

    steer: float  #: true less logged steering [rad]
    torque: float  #: true over logged torque [-]

    def logged(self, commands: FloatArray) -> FloatArray:
        """Commands (T, 3) as they are logged where ``commands`` act."""
        found: FloatArray = (commands - np.array([self.steer, 0.0, 0.0])) / np.array(
            [1.0, *2 * (self.torque,)]
        )
        return found


def _departed(stated: Plant, rng: np.random.Generator) -> tuple[Plant, _Departure]:
    """(what is true where ``stated`` is believed, what acts where something else is logged)."""
    unknowns = unknowns_of()
    values = unknowns.mean + unknowns.sd * rng.standard_normal(len(UNKNOWN_NAMES))
    values[:MODULUS] = stated.soil.n, stated.soil.phi
    one = InputRows(*(np.ones((1, columns)) for columns in (3, 3, 2, 3)))
    truth, inputs = applied(stated, one, values)
    assert truth.soil.n == values[N]  # what is drawn is what drives
    acting = inputs.begin[0]
    return truth, _Departure(float(acting[0]) - 1.0, float(acting[1]))


def _driver(
    rng: np.random.Generator, plant: Plant, lateral: float, resistance: float, offset: float
) -> Driver:
    """Weaves between what the soil holds, with speeds that change."""
    base, swing = np.mean(_SPEEDS), 0.5 * np.ptp(_SPEEDS)
    rates, phases = rng.uniform(0.4, 1.6, 3), rng.uniform(0.0, 2.0 * math.pi, 4)
    slow, v = rng.uniform(0.2, 0.5), plant.vehicle
    torque = resistance * v.r

    def drive(t: float, speed: float) -> tuple[float, float, float]:
        wanted = base + swing * math.sin(slow * t + phases[3])
        weave = sum(math.sin(rate * t + phase) for rate, phase in zip(rates, phases, strict=False)) / 3.0
        steer = _LATERAL * lateral * (v.l_f + v.l_r) / max(speed, 2.0) ** 2 * weave
        effort = torque + _GAIN * (wanted - speed)
        return float(np.clip(steer, -0.35, 0.35)) + offset, max(effort, 0.0), max(-effort, 0.0)

    return drive
