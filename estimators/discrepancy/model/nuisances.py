"""Nuisances of a drive, with their priors: what is never exactly as stated in an unmodified vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.protocol import ForwardModel, Nuisance
from estimators.discrepancy.model.tolerances import TOLERATED
from estimators.logs.log import Log
from offroad_env.effects import Setup, apply

__all__ = ["NUISANCES", "acts", "ground_changed", "nuisances_of", "wheelbase", "with_nuisances"]


def acts(nuisance: Nuisance, run: ForwardModel) -> bool:
    """Whether the nuisance exists in this run."""
    if nuisance.log and nuisance.log != run.log.hash:
        return False
    hard = run.setup.plant.soil.rigid > 0.5
    if (nuisance.hard and not hard) or (nuisance.soft and hard):
        return False
    # On hard ground what is uncertain of the tyres contains what tolerances of the vehicle would change.
    if nuisance.tolerated and (hard or run.log.config.exact):
        return False
    unknown = run.log.config.unknown
    if nuisance.unknown and nuisance.unknown not in unknown:
        return False
    return not nuisance.pitching or (run.driven and _SPRINGS not in unknown)


def with_nuisances(run: ForwardModel, values: Sequence[float] | np.ndarray) -> Setup:
    """The setup of a run with the nuisances at these values."""
    setup = run.setup
    for nuisance, value in zip(run.nuisances, values, strict=True):
        if acts(nuisance, run):
            setup = nuisance.change(setup, run, float(value))
    return setup


def wheelbase(run: ForwardModel) -> float:
    """Distance of the axles [m]."""
    vehicle = run.setup.plant.vehicle
    return vehicle.l_f + vehicle.l_r


def ground_changed(setup: Setup, run: ForwardModel, value: float) -> Setup:
    """Other ground: n of soil is larger by ``value``, the lateral stiffness on hard ground by a factor."""
    soil = run.setup.plant.soil
    if soil.rigid > 0.5:
        return setup.with_soil(C_alpha=soil.C_alpha * math.exp(value))
    return setup.with_soil(n=max(soil.n + value, 0.05))


def _along(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return setup.with_soil(C_kappa=run.setup.plant.soil.C_kappa * math.exp(value))


def _balance(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return apply(setup, [("front_grip", {"share": value})])


def _shift(setup: Setup, run: ForwardModel, value: float) -> Setup:
    delay = setup.inputs.delay + 0.5 * run.step / math.sqrt(3.0) * value
    return replace(setup, inputs=replace(setup.inputs, delay=delay))


def _wheel_age(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return replace(
        setup, errors=replace(setup.errors, wheel_delay=setup.errors.wheel_delay + run.period * value)
    )


def _pose_age(setup: Setup, run: ForwardModel, value: float) -> Setup:
    if setup.errors.pose_delay <= 0.0:
        return setup
    return replace(setup, errors=replace(setup.errors, pose_delay=setup.errors.pose_delay + value))


def _wheel(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return replace(setup, errors=replace(setup.errors, wheel_scale=setup.errors.wheel_scale + value))


def _wheel_split(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return replace(setup, errors=replace(setup.errors, wheel_split=setup.errors.wheel_split + value))


def _antenna(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return replace(setup, errors=replace(setup.errors, antenna=setup.errors.antenna + wheelbase(run) * value))


def _lean(setup: Setup, run: ForwardModel, value: float) -> Setup:
    return replace(setup, errors=replace(setup.errors, lean=value))


def _moved_imu(axis: int) -> Callable[[Setup, ForwardModel, float], Setup]:
    def change(setup: Setup, run: ForwardModel, value: float) -> Setup:
        lever = setup.mount.lever.copy()
        lever[axis] += wheelbase(run) * value
        return replace(setup, mount=setup.mount._replace(lever=lever))

    return change


def _bias(channel: int) -> Callable[[Setup, ForwardModel, float], Setup]:
    def change(setup: Setup, run: ForwardModel, value: float) -> Setup:
        return replace(setup, errors=setup.errors.shifted(channel, value))

    return change


def _unstated(
    name: str,
    change: Callable[[Setup, ForwardModel, float], Setup],
    spread: float,
    limits: tuple[float, float],
    unknown: str,
) -> Nuisance:
    """A nuisance that exists only where the log calls something unknown."""
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
#: Priors of an unmodified vehicle; a bias far beyond its prior is an effect.
NUISANCES = (
    Nuisance(name="ground", change=ground_changed, spread=0.5, step=1e-4, hard_limits=_TYRES),
    # The stiffness of tyres is stated once at best, and differs between front and rear, along and across. A
    # vehicle whose front tyres grip much better than the rear ones is unstable at speed; one whose front
    # tyres have less than two thirds of the grip is confounded with one that steers more than commanded.
    Nuisance(name="along", change=_along, spread=0.5, step=0.005, limits=_TYRES, hard=True),
    Nuisance(name="balance", change=_balance, spread=0.3, step=0.02, limits=(-0.33, 0.1), hard=True),
    # Half a sample either way, in standard deviations; inputs that are later than that are an effect.
    Nuisance(name="shift", change=_shift, spread=1.0, step=0.25, limits=(-(3.0**0.5), 3.0**0.5), own=True),
    # Delay of wheel speeds that move the car against other sensors [samples]: they take another line.
    Nuisance(
        name="wheel_age",
        change=_wheel_age,
        spread=1.0,
        step=0.25,
        sensors_only=True,
        limits=(-2.0, 2.0),
        hard=True,
        own=True,
    ),
    # Error of the age of the pose as found from the sensors [s]; 0 where they show none.
    Nuisance(
        name="pose_age",
        change=_pose_age,
        spread=0.003,
        step=0.002,
        sensors_only=True,
        limits=(-0.005, 0.005),
        own=True,
    ),
    # Positions of sensors that the log calls unknown [wheelbases].
    _unstated("imu_x", _moved_imu(0), 0.25, _ALONG, _IMU),
    _unstated("imu_y", _moved_imu(1), 0.1, _ACROSS, _IMU),
    replace(_unstated("imu_z", _moved_imu(2), 0.1, _ACROSS, _IMU), pitching=True),
    _unstated("antenna_x", _antenna, 0.25, _ALONG, _ANTENNA),
    # A body on unknown springs leans out of turns, and gravity adds this share to a_y: radians per g.
    replace(_unstated("lean", _lean, 0.1, (0.0, 0.3), _SPRINGS), step=0.01, unit="rad/g"),
    *(
        Nuisance(name=f"bias_{i}", change=_bias(i), spread=spread, step=step, sensors_only=True, own=True)
        for i, (spread, step) in enumerate([(0.02, 0.01)] * 3 + [(5e-4, 1e-3)] * 2)
    ),
    # Each axle's wheel speeds err by 0.2 %: their mean and half their difference by less.
    Nuisance(name="wheel", change=_wheel, spread=0.0014, step=0.002, sensors_only=True),
    Nuisance(name="wheel_split", change=_wheel_split, spread=0.0014, step=0.002, sensors_only=True),
    # Numbers of the description that are known to a tolerance.
    *TOLERATED,
)


def nuisances_of(logs: Sequence[Log]) -> tuple[Nuisance, ...]:
    """Nuisances of several drives of one vehicle: the common ones once, and every drive's own.

    Clocks and biases differ from day to day. Soil is common to drives that state the same soil.
    """
    first, *others = logs
    several = len({log.config.soil for log in logs}) > 1

    def own(nuisance: Nuisance) -> bool:
        return nuisance.own or (several and (nuisance.soft or nuisance.name == "ground"))

    if not others:
        return NUISANCES
    common = tuple(replace(one, log=first.hash) if own(one) else one for one in NUISANCES)
    more = (
        replace(one, name=f"{one.name} of {log.name}", log=log.hash)
        for log in others
        for one in NUISANCES
        if own(one)
    )
    return (*common, *more)
