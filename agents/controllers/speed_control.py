"""Longitudinal control: PI with feed-forward, anti-windup, drive/brake split and slip limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from offroad_env.physics._jit import kernel
from offroad_env.physics.numerics import AIR_DENSITY, GRAVITY
from offroad_env.physics.records import Vehicle

__all__ = ["SpeedController", "SpeedGains", "drive_share", "gentle_target", "slip_between", "slip_share"]

#: Deceleration that every soil of the project's tasks gives, and nobody minds [m/s^2].
_GENTLE = 1.5


def gentle_target(wanted: float, distance: float, stop_zone: float) -> float:
    """Speed [m/s] of a cautious driver without soil model: ``wanted``, or less before a line.

    Parameters
    ----------
    wanted
        Speed without a line [m/s].
    distance
        Way to the end of the path [m].
    stop_zone
        > 0: stand within this distance before the end [m]; the driver aims at the middle of it.
    """
    if stop_zone <= 0.0:
        return wanted
    return min(wanted, math.sqrt(2.0 * _GENTLE * max(distance - 0.5 * stop_zone, 0.0)))


@kernel
def drive_share(force: float, vehicle: Vehicle) -> float:
    """A force at the wheels [N] as a share of the largest drive or, if negative, brake torque; unclipped."""
    most = vehicle.drive_torque_max if force >= 0.0 else vehicle.brake_torque_max
    return force * vehicle.r / most


@dataclass(frozen=True, kw_only=True)
class SpeedGains:
    """Gains in units of acceleration, so that one set serves vehicles of any mass.

    ``k_p`` is 1/(2 T) of a torque lag T of 0.2 s, which damps the loop at 0.7; ``k_i`` acts an order
    of magnitude slower.
    """

    k_p: float = 2.5  #: acceleration per speed error [1/s]
    k_i: float = 1.0  #: acceleration per integrated speed error [1/s^2]
    integral_max: float = 3.0  #: largest acceleration of the integral part [m/s^2]
    whole_power: bool = (
        False  #: whether to ask for the torque too that the drive loses near its largest power
    )
    slip_limit: float = 0.4  #: drive slip at which the drive torque begins to be cut [-]
    slip_band: float = 0.2  #: slip over the limit at which no drive torque is left [-]
    brake_slip: float = math.inf  #: brake slip from which, over the same band, the brakes are let go [-]
    low_speed: float = 1.0  #: rim speed below which slip is referred to this speed [m/s]


def slip_between(slower: float, faster: float, gains: SpeedGains) -> float:
    """Slip [-] between two speeds [m/s], referred to the faster one."""
    return (faster - slower) / max(abs(faster), gains.low_speed)


def slip_share(slower: float, faster: float, limit: float, gains: SpeedGains) -> float:
    """Share of a torque that is left at a slip between two speeds [m/s].

    1 below ``limit``, falling smoothly to 0 across the band.
    """
    over = min(max((slip_between(slower, faster, gains) - limit) / gains.slip_band, 0.0), 1.0)
    return 0.5 * (1.0 + math.cos(math.pi * over))


class SpeedController:
    """Speed PI around a feed-forward of inertia, motion resistance and drag.

    The demand is a force at the wheels, F = m (a_ff + k_p e + k_i int e) + resistance + drag,
    turned into a share of the largest drive torque when it pushes, of the largest brake torque
    when it pulls. The integral stops where the command saturates in the direction of the error
    (conditional integration; Astrom & Hagglund, Advanced PID Control, 2006, section 3.5).

    Parameters
    ----------
    vehicle
        The controller's model of the vehicle.
    dt
        Control interval [s].
    gains
    """

    def __init__(self, vehicle: Vehicle, dt: float, gains: SpeedGains | None = None) -> None:
        self.vehicle = vehicle
        self.dt = dt
        self.gains = gains or SpeedGains()
        self._integral = 0.0

    def reset(self) -> None:
        """Forget the integral."""
        self._integral = 0.0

    def command(
        self,
        target: float,
        speed: float,
        *,
        acceleration: float = 0.0,
        resistance: float = 0.0,
        rim_speed: float | None = None,
        slip_limit: float | None = None,
        slowest_rim: float | None = None,
    ) -> float:
        """Drive command in [-1, 1], negative brakes.

        Parameters
        ----------
        target, speed
            Wanted and estimated speed [m/s].
        acceleration
            Wanted acceleration along the plan [m/s^2].
        resistance
            Motion resistance of the assumed soil [N].
        rim_speed
            Fastest rim speed r omega [m/s]; without it slip is not limited.
        slip_limit
            Another drive slip than that of the gains at which the torque begins to be cut [-].
        slowest_rim
            Slowest rim speed [m/s]; without it wheels may lock.
        """
        v, gains = self.vehicle, self.gains
        error = target - speed
        drag = 0.5 * AIR_DENSITY * v.drag_area * speed * abs(speed)
        rolling = v.rolling_resistance * v.m * GRAVITY
        force = v.m * (acceleration + gains.k_p * error + self._integral) + resistance + rolling + drag
        wanted = drive_share(force, v)
        if gains.whole_power and wanted > 0.0 and rim_speed is not None:
            wanted *= self._loss(force, rim_speed)
        command = min(max(wanted, -1.0), 1.0)
        if command == wanted or command * error < 0.0:
            step = gains.k_i * error * self.dt
            self._integral = min(max(self._integral + step, -gains.integral_max), gains.integral_max)
        if command > 0.0 and rim_speed is not None:
            limit = gains.slip_limit if slip_limit is None else slip_limit
            command *= slip_share(speed, rim_speed, limit, gains)
        if command < 0.0 and slowest_rim is not None and gains.brake_slip < math.inf:
            command *= slip_share(slowest_rim, speed, gains.brake_slip, gains)
        return command

    def _loss(self, force: float, rim_speed: float) -> float:
        """Factor on the command for ``force`` [N] to arrive at the wheels.

        Near its largest power P the drive gives T / sqrt(1 + (T omega / P)^2) of an asked torque T
        (`offroad_env.physics.full_vehicle`): T is the given torque / sqrt(1 - (given torque omega / P)^2).
        """
        share = force * max(rim_speed, 0.0) / self.vehicle.power_max
        return 1.0 / math.sqrt(1.0 - share * share) if share < 1.0 else math.inf
