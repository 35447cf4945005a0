"""Prediction after a few seconds on a soil that nobody has seen, by the physical models.

All start from the true motion, so no error of navigation counts; what they know of the soil they have from
the sensors until then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from estimators.belief.drive_fit import DriveFit, fit_drive
from estimators.belief.drive_problem import Surroundings
from estimators.belief.drive_samples import DriveSamples
from estimators.experiments.motion_sequences import AT, HORIZON
from estimators.experiments.unknown_soils import VEHICLE, SoilRun, sloping
from estimators.filters.online import OnBoard, Thinned, make_estimator
from estimators.filters.online_soil_belief import POPULATION_RANGE, OnlineSoilBelief, population_n
from estimators.filters.protocol import Estimate, Estimator
from estimators.filters.registry import SOIL_FILTERS
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.records import Soil
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import Plant, make_plant, settled_state, simulate_commands
from offroad_env.world.natural_soil import SoilSpread
from offroad_env.world.soil_prior import ANGLE_SLOPE, EXIT_SHARE, LARGEST_PRESSURE_SHARE, SoilPrior
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = [
    "base_soil",
    "believed",
    "continued",
    "filtered_n",
    "fitted",
    "nominal_plant",
    "predicted",
    "samples_until",
    "true_plant",
]

#: What belongs to the vehicle's motion; heave and pitch settle on the soil that a model believes in.
_TAKEN = (
    *(at.X, at.Y, at.YAW, at.V_X, at.V_Y, at.YAW_RATE),
    *(at.OMEGA_F, at.OMEGA_R, at.STEER, at.DRIVE, at.BRAKE),
)


def base_soil(name: str) -> Soil:
    """The soil that a method assumes until it knows better: a name of the catalogue, or "population"."""
    if name != "population":
        return SOILS[name]
    prior = SoilPrior.fitted()
    pressure, n, c, phi, K = prior.mean.tolist()
    return make_soil(
        k_phi=math.exp(pressure) / 0.05**n,
        n=n,
        c=math.exp(c),
        phi=phi,
        k_x=math.exp(K),
        a_0=0.5 * sum(LARGEST_PRESSURE_SHARE),
        a_1=ANGLE_SLOPE,
        b_0=0.5 * sum(EXIT_SHARE),
        b_1=0.0,
    )


def nominal_plant(soil: str) -> Plant:
    """The nominal vehicle on level ground, on a soil of `base_soil`."""
    return make_plant(VEHICLES[VEHICLE], base_soil(soil), flat())


def true_plant(run: SoilRun) -> Plant:
    """True vehicle, soil and slope of the ground; road and scatter of the soil are in nobody's model."""
    plant = run.record.plant
    return make_plant(plant.vehicle, plant.soil, sloping(run.slopes))


def predicted(plants: Sequence[Plant], run: SoilRun, start: float) -> np.ndarray:
    """(4,) X, Y [m], heading [rad] and speed [m/s] `HORIZON` after ``start`` [s]: the mean over some models.

    Where its soil does not carry the vehicle, or ceases to, a model says that it stops at once.
    """
    found: np.ndarray = np.mean([_predicted(plant, run, start) for plant in plants], axis=0)
    return found


def continued(plant: Plant, run: SoilRun, start: float, duration: float) -> np.ndarray:
    """(T, S) states by a model from the true motion at ``start`` [s] under the commands that follow.

    Raises
    ------
    SolverFailure
        Where its soil does not carry the vehicle, or ceases to.
    """
    record, k = run.record, round(start / run.record.timing.period)
    state, steps = record.states[k], round(duration / record.timing.period)
    own, warm = settled_state(
        plant, x=float(state[at.X]), y=float(state[at.Y]), yaw=float(state[at.YAW]), v_x=state[at.V_X]
    )
    own[list(_TAKEN)] = state[list(_TAKEN)]
    commands = record.commands[k + 1 : k + 1 + steps]
    return simulate_commands(plant, own, warm, commands, interval=record.timing.period).states


def _predicted(plant: Plant, run: SoilRun, start: float) -> np.ndarray:
    """`predicted` by one model."""
    state = run.record.states[round(start / run.record.timing.period)]
    halted = np.array([state[at.X], state[at.Y], state[at.YAW], 0.0])
    try:
        end = continued(plant, run, start, HORIZON)[-1]
    except SolverFailure:
        return halted
    found: np.ndarray = end[[at.X, at.Y, at.YAW, at.V_X]]
    return found


def _watched(run: SoilRun, filter_: Estimator, look: Callable[[Estimate], list[Plant]]) -> list[list[Plant]]:
    """The models that a filter believes in at each of `AT`."""
    record, found = run.record, []
    filter_.reset(*population_n(), run.pose)
    rows = [round(start / record.timing.period) for start in AT]
    for k in range(1, rows[-1] + 1):
        steer, drive, brake = record.commands[k].tolist()
        estimate = filter_.update((steer, drive, brake), record.imu[k], record.wheel[k], record.gnss[k])
        if k in rows:
            found.append(look(estimate))
    return found


def _estimator(kind: str, soil: str) -> Estimator:
    """Every method knows that the ground is level."""
    unit, receiver = ImuConfig(kind="specific_force"), GnssConfig(position_sd=1.5)
    choice = OnBoard(kind=kind, rate=50.0, grade=0.0 if kind in SOIL_FILTERS else None)
    return make_estimator(choice, nominal_plant(soil), POPULATION_RANGE, unit, receiver)


def filtered_n(run: SoilRun, soil: str) -> list[list[Plant]]:
    """The model with the n of the filter for n alone, all else as nominal, at each of `AT`."""
    nominal = nominal_plant(soil)
    return _watched(
        run,
        _estimator("online_parameter_ukf", soil),
        lambda estimate: [nominal._replace(soil=nominal.soil._replace(n=estimate.mean))],
    )


def believed(run: SoilRun) -> list[list[Plant]]:
    """Models of the sigma points of the belief over whole soils, at each of `AT`."""
    filter_ = _estimator("online_soil_belief", "dry_sand")
    inner = filter_.inner if isinstance(filter_, Thinned) else filter_
    assert isinstance(inner, OnlineSoilBelief)
    return _watched(run, filter_, lambda _: inner.believed_plants)


def samples_until(run: SoilRun, end: float) -> DriveSamples:
    """What the sensors of a drive have measured until a time [s]."""
    record = run.record
    rows = slice(1, round(end / record.timing.period) + 1)
    return DriveSamples(
        period=record.timing.period,
        commands=record.commands[rows],
        imu=record.imu[rows],
        wheel=record.wheel[rows],
        gnss=record.gnss[rows],
        pose=run.pose,
        unit=ImuConfig(kind="specific_force"),
    )


def fitted(run: SoilRun) -> list[DriveFit]:
    """The belief fitted to all samples until each of `AT`: the ground is level, and the soil scatters."""
    plant, found = nominal_plant("population"), list[DriveFit]()
    surroundings = Surroundings(scatter=SoilSpread())
    for end in AT:
        earlier = found[-1] if found else None
        found.append(fit_drive(plant, samples_until(run, end), earlier, surroundings))
    return found
