"""What is never exactly as stated in a healthy run, with what is believed of it: fitted, but no cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.run_model import RunModel
from offroad_env.effects import Setup, apply

__all__ = ["NUISANCES", "Nuisance", "acts", "wheelbase", "with_nuisances"]


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """Something common to all windows that is never exactly as stated, with what is believed of it."""

    name: str
    change: Callable[[Setup, RunModel, float], Setup]  #: of a setup as stated, for a run and a value
    spread: float  #: standard deviation beforehand
    step: float  #: of its finite difference
    sensors_only: bool = False
    limits: tuple[float, float] = (-np.inf, np.inf)  #: nothing healthy lies beyond
    hard_limits: tuple[float, float] | None = None  #: the same on hard ground, where it differs
    hard: bool = False  #: of hard ground alone
    unknown: str = ""  #: what the log must call unknown
    unit: str = ""  #: of what the log calls unknown; lengths [m] are fitted in wheelbases
    pitching: bool = False  #: shows by the pitching alone, which springs and torques make


def acts(nuisance: Nuisance, run: RunModel) -> bool:
    """Whether there is such a thing in this run."""
    if nuisance.hard and run.setup.plant.soil.rigid < 0.5:
        return False
    unknown = run.log.config.unknown
    if nuisance.unknown and nuisance.unknown not in unknown:
        return False
    return not nuisance.pitching or (run.driven and _SPRINGS not in unknown)


def with_nuisances(run: RunModel, values: Sequence[float]) -> Setup:
    """The setup of a run with the nuisances at these values."""
    setup = run.setup
    for nuisance, value in zip(NUISANCES, values, strict=True):
        if acts(nuisance, run):
            setup = nuisance.change(setup, run, float(value))
    return setup


def wheelbase(run: RunModel) -> float:
    """Distance of the axles [m]."""
    vehicle = run.setup.plant.vehicle
    return vehicle.l_f + vehicle.l_r


def _ground(setup: Setup, run: RunModel, value: float) -> Setup:
    soil = run.setup.plant.soil
    if soil.rigid > 0.5:
        return setup.with_soil(C_alpha=soil.C_alpha * math.exp(value))
    return setup.with_soil(n=max(soil.n + value, 0.05))


def _along(setup: Setup, run: RunModel, value: float) -> Setup:
    return setup.with_soil(C_kappa=run.setup.plant.soil.C_kappa * math.exp(value))


def _balance(setup: Setup, run: RunModel, value: float) -> Setup:
    return apply(setup, [("front_grip", {"share": value})])


def _shift(setup: Setup, run: RunModel, value: float) -> Setup:
    delay = setup.inputs.delay + 0.5 * run.step / math.sqrt(3.0) * value
    return replace(setup, inputs=replace(setup.inputs, delay=delay))


def _wheel_age(setup: Setup, run: RunModel, value: float) -> Setup:
    return _with_errors(setup, wheel_delay=setup.errors.wheel_delay + run.period * value)


def _pose_age(setup: Setup, run: RunModel, value: float) -> Setup:
    told = setup.errors.pose_delay > 0.0
    return _with_errors(setup, pose_delay=setup.errors.pose_delay + told * value)


def _wheel(setup: Setup, run: RunModel, value: float) -> Setup:
    return _with_errors(setup, wheel_scale=setup.errors.wheel_scale + value)


def _wheel_split(setup: Setup, run: RunModel, value: float) -> Setup:
    return _with_errors(setup, wheel_split=setup.errors.wheel_split + value)


def _antenna(setup: Setup, run: RunModel, value: float) -> Setup:
    return _with_errors(setup, antenna=setup.errors.antenna + wheelbase(run) * value)


def _lean(setup: Setup, run: RunModel, value: float) -> Setup:
    return _with_errors(setup, lean=value)


def _with_errors(setup: Setup, **changes: float) -> Setup:
    return replace(setup, errors=replace(setup.errors, **changes))


def _moved_imu(axis: int) -> Callable[[Setup, RunModel, float], Setup]:
    def change(setup: Setup, run: RunModel, value: float) -> Setup:
        lever = setup.mount.lever.copy()
        lever[axis] += wheelbase(run) * value
        return replace(setup, mount=setup.mount._replace(lever=lever))

    return change


def _bias(channel: int) -> Callable[[Setup, RunModel, float], Setup]:
    def change(setup: Setup, run: RunModel, value: float) -> Setup:
        return replace(setup, errors=setup.errors.shifted(channel, value))

    return change


def _unstated(
    name: str,
    change: Callable[[Setup, RunModel, float], Setup],
    spread: float,
    limits: tuple[float, float],
    unknown: str,
) -> Nuisance:
    """One that there is only where the log calls something unknown."""
    return Nuisance(
        name=name,
        change=change,
        spread=spread,
        step=1e-3,
        sensors_only=True,
        limits=limits,
        unknown=unknown,
        unit="m",
    )


#: No tyre is stiffer, or softer, than stated by more than this: the logarithm of a factor of two. Tyres on
#: hard ground, of cars and of trucks, lie within that of each other for one load. Much softer ones turn
#: the car as late as a slow steering does.
_TYRES = (-0.7, 0.7)
#: Something of a vehicle lies on it: within so many wheelbases of the place that was assumed.
_ALONG, _ACROSS = (-0.7, 0.7), (-0.3, 0.3)
_IMU, _ANTENNA, _SPRINGS = "imu.position", "gnss.position", "suspension"
#: Beliefs about a healthy vehicle; a bias beyond them is an effect.
NUISANCES = (
    Nuisance(name="ground", change=_ground, spread=0.5, step=1e-4, hard_limits=_TYRES),
    # Tyres are known by one stiffness at best, and never in front as behind, nor along as across. A vehicle
    # whose front tyres hold much more than the rear ones does not go straight at speed; one whose front
    # tyres hold less than two thirds is taken for one that steers more than commanded.
    Nuisance(name="along", change=_along, spread=0.5, step=0.005, limits=_TYRES, hard=True),
    Nuisance(name="balance", change=_balance, spread=0.3, step=0.02, limits=(-0.33, 0.1), hard=True),
    # Half a sample either way, in standard deviations; inputs that are later than that are an effect.
    Nuisance(name="shift", change=_shift, spread=1.0, step=0.25, limits=(-(3.0**0.5), 3.0**0.5)),
    # Samples by which wheel speeds that move the car are older than the others: they come by another way.
    Nuisance(
        name="wheel_age",
        change=_wheel_age,
        spread=1.0,
        step=0.25,
        sensors_only=True,
        limits=(-2.0, 2.0),
        hard=True,
    ),
    # By how much the age of the pose that the sensors told is wrong [s]; nothing, if they told none.
    Nuisance(
        name="pose_age", change=_pose_age, spread=0.003, step=0.002, sensors_only=True, limits=(-0.005, 0.005)
    ),
    # Where sensors sit of which nobody knows [wheelbases].
    _unstated("imu_x", _moved_imu(0), 0.25, _ALONG, _IMU),
    _unstated("imu_y", _moved_imu(1), 0.1, _ACROSS, _IMU),
    replace(_unstated("imu_z", _moved_imu(2), 0.1, _ACROSS, _IMU), pitching=True),
    _unstated("antenna_x", _antenna, 0.25, _ALONG, _ANTENNA),
    # A body on unknown springs leans out of turns, and gravity adds this share to a_y: radians per g.
    replace(_unstated("lean", _lean, 0.1, (0.0, 0.3), _SPRINGS), step=0.01, unit="rad/g"),
    *(
        Nuisance(name=f"bias_{i}", change=_bias(i), spread=spread, step=step, sensors_only=True)
        for i, (spread, step) in enumerate([(0.02, 0.01)] * 3 + [(5e-4, 1e-3)] * 2)
    ),
    # Each axle's wheel speeds err by 0.2 %: their mean and half their difference by less.
    Nuisance(name="wheel", change=_wheel, spread=0.0014, step=0.002, sensors_only=True),
    Nuisance(name="wheel_split", change=_wheel_split, spread=0.0014, step=0.002, sensors_only=True),
)
