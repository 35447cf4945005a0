"""Arguments of the environment and options of its reset, checked at the border."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from offroad_env.environment.episode_records import CONTROL_PERIOD, PAPER_FORCE, SAMPLES
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.simulation.drive import Command
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import make_vehicle

__all__ = [
    "Mismatch",
    "ResetOptions",
    "believed_range",
    "checked_range",
    "command_of",
    "require_bearing",
    "require_choice",
    "require_rate",
]


def require_choice(name: str, value: object, allowed: tuple[str | None, ...]) -> None:
    """Refuse a ``value`` that is none of the ``allowed`` ones."""
    if value not in allowed:
        raise InvalidParameter(f"{name} must be one of {', '.join(map(str, allowed))}, got {value!r}")


def require_rate(rate: float) -> None:
    """Refuse sensors whose clock is not that of the control period."""
    expected = SAMPLES / CONTROL_PERIOD
    if rate != expected:
        raise InvalidParameter(
            f"imu.rate of the environment's sensors must be {expected:g} Hz, got {rate:g} Hz"
        )


def checked_range(limits: Any, soil_name: str) -> tuple[float, float]:
    """``n_range`` as two floats, both of which the soil of that name accepts."""
    try:
        low, high = (float(value) for value in limits)
    except (TypeError, ValueError) as error:
        raise InvalidParameter(f"n_range must be (low, high), got {limits!r}") from error
    if not low <= high:
        raise InvalidParameter(f"n_range must be (low, high) with low <= high, got {limits!r}")
    for n in (low, high):
        make_soil(SOILS[soil_name], n=n)
    return low, high


def believed_range(limits: tuple[float, float]) -> tuple[float, float]:
    """``n_range``, widened to 0.1 where it holds a single soil: a filter needs something to estimate."""
    low, high = limits
    widen = max(0.05 - 0.5 * (high - low), 0.0)
    return max(low - widen, 0.06), high + widen


def command_of(vehicle: Vehicle, model: str, action: Sequence[float]) -> Command:
    """An action as a command: steering [rad], drive and brake torque [N m] (paper: force, NaN)."""
    steer, drive = action
    angle = steer * vehicle.steer_max
    if model == "paper":
        return angle, drive * PAPER_FORCE * vehicle.m, math.nan
    return angle, max(drive, 0.0) * vehicle.drive_torque_max, max(-drive, 0.0) * vehicle.brake_torque_max


def require_bearing(
    vehicle: Vehicle, soil_name: str, soil: Soil, n_range: tuple[float, float], model: str
) -> None:
    """Refuse a range of soils in which the standing vehicle drowns: a reset would fail much later."""
    for n in n_range:
        try:
            settled_state(make_plant(vehicle, make_soil(soil, n=n), flat(), model=model))
        except SolverFailure as error:
            raise InvalidParameter(
                f"n_range {n_range} of {soil_name!r} reaches soil that drowns it: {error}"
            ) from error


class Mismatch(NamedTuple):
    """Factors by which the truth differs from the nominal vehicle and soil."""

    mass: float
    k_phi: float
    lag: float  #: of the drive torque


@dataclass(frozen=True, kw_only=True)
class ResetOptions:
    """Options of `OffroadBekkerEnv.reset`."""

    n: float | None = None  #: sinkage exponent of the true soil [-]; None: drawn
    mismatch: Mismatch | None = None

    @classmethod
    def read(cls, options: Mapping[str, Any] | None) -> ResetOptions:
        """The options of a call; refuses other keys than "n" and "mismatch"."""
        options = options or {}
        unknown = set(options) - {"n", "mismatch"}
        if unknown:
            raise InvalidParameter(f'options may hold "n" and "mismatch", got {", ".join(sorted(unknown))}')
        mismatch = options.get("mismatch")
        if mismatch is not None:
            mass, k_phi, lag = (float(factor) for factor in mismatch)
            mismatch = Mismatch(mass, k_phi, lag)
        return cls(n=options.get("n"), mismatch=mismatch)

    def truth(self, vehicle: Vehicle, soil: Soil, drawn: float) -> tuple[Vehicle, Soil]:
        """The true vehicle and soil: nominal, but for n and the factors of a mismatch."""
        n = drawn if self.n is None else make_soil(soil, n=self.n).n
        if self.mismatch is None:
            return vehicle, make_soil(soil, n=n)
        mass, k_phi, lag = self.mismatch
        return (
            make_vehicle(vehicle, m=mass * vehicle.m, torque_lag=lag * vehicle.torque_lag),
            make_soil(soil, n=n, k_phi=k_phi * soil.k_phi),
        )
