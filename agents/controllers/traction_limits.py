"""Traction limits of a soil: cornering, braking, driving and slip angles as functions of n.

A controller looks up here, for the n that it assumes, how hard it may drive. All entries come
from the same single-wheel function that users see (`offroad_env.simulation.wheel.wheel_forces`) at the static
axle loads, once for a grid of n, and are then interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from offroad_env.errors import SolverFailure
from offroad_env.physics._jit import kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray, Soil, Vehicle, Wheel
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import make_soil
from offroad_env.world.vehicles import make_wheel, static_loads

__all__ = [
    "Capability",
    "SlipAngles",
    "SlipTable",
    "SoilRow",
    "WheelLaws",
    "anticipated_slip",
    "soil_capability",
    "soil_row",
    "table_of",
]

_N_NODES = 15
_DENSE = 161
#: Drive slips: dense where the force rises steeply.
_SLIPS = np.concatenate((np.linspace(0.0, 0.3, 13), np.linspace(0.35, 0.95, 13)))
#: Drive slips among which the best is sought.
_FINE_SLIPS = np.linspace(0.0, 0.9, 46)
#: Brake slips: beyond -0.4 the wheels hardly steer any more.
_BRAKE_SLIPS = np.linspace(-0.4, 0.0, 9)
_ANGLES = np.radians(np.linspace(0.0, 30.0, 21))
#: Share of the best drive force at which a controller stops asking for more slip.
_NEAR_BEST = 0.95


class SlipAngles(NamedTuple):
    """Slip angles of the axles [rad], of the sign of the lateral acceleration."""

    front: float
    rear: float


class SlipTable(NamedTuple):
    """Lateral acceleration that each axle holds, over n and slip angle: part of `Capability`, for kernels."""

    grid: FloatArray  #: (D,) even grid of n [-]
    angles: FloatArray  #: (B,) slip angles [rad], ascending from 0
    side: FloatArray  #: (2, D, B) front and rear: lateral acceleration held [m/s^2]


class WheelLaws(NamedTuple):
    """Laws of the wheels that a controller assumes."""

    shear: str = "resultant"  #: of `wheel_forces`, where no structure is given
    structure: str | None = None  #: all laws together instead, a name of `world.structures`
    tyre: str | None = None  #: flexible tyre, a name in `world.tyres.TYRES`; None: a rigid rim


class SoilRow(NamedTuple):
    """What one soil holds for one vehicle: a row of the table."""

    scalars: np.ndarray  #: (4,) braking, driving [m/s^2], drive slip [-], resistance [N]
    bends: np.ndarray  #: (2, 2, B) lateral acceleration [m/s^2], and resistance [N], of the axles over angles
    pull: np.ndarray  #: (S,) acceleration over drive slips [m/s^2]
    angles: np.ndarray  #: (B,) slip angles [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Capability:
    """Limits of one vehicle on one soil over the sinkage exponent; from `soil_capability`.

    Beliefs outside the grid are clipped to it.
    """

    grid: np.ndarray  #: (D,) dense grid of n [-]
    braking: np.ndarray  #: (D,) largest deceleration with rolling wheels [m/s^2]
    driving: np.ndarray  #: (D,) largest acceleration [m/s^2]
    drive_slip: np.ndarray  #: (D,) slip that gives 95 % of it [-]
    resistance: np.ndarray  #: (D,) motion resistance of the soil straight on [N]
    angles: np.ndarray  #: (B,) slip angles [rad], ascending from 0
    slips: np.ndarray  #: (S,) drive slips [-], ascending from 0
    pull: np.ndarray  #: (D, S) acceleration at a drive slip; -g where the wheel digs itself in [m/s^2]
    side: np.ndarray  #: (2, D, B) front and rear: lateral acceleration held at a slip angle [m/s^2]
    turning: np.ndarray  #: (2, D, B) front and rear: resistance at a slip angle beyond that straight on [N]

    def lateral_limit(self, n_low: float, n_high: float, slip_angle: float) -> float:
        """Largest steady lateral acceleration [m/s^2] that every n in the interval holds.

        Parameters
        ----------
        n_low, n_high
            Believed interval of n; both ends may be equal.
        slip_angle
            Largest slip angle that the controller lets either axle take [rad].
        """
        limits = self._limits(slip_angle)
        inside = limits[(self.grid > n_low) & (self.grid < n_high)]
        ends = min(float(np.interp(n_low, self.grid, limits)), float(np.interp(n_high, self.grid, limits)))
        return min(ends, float(inside.min())) if inside.size else ends

    def worst_lateral(self, slip_angle: float) -> float:
        """The n of the grid with the smallest lateral limit at that slip angle [rad]."""
        return float(self.grid[int(np.argmin(self._limits(slip_angle)))])

    def braking_limit(self, n_low: float, n_high: float) -> float:
        """Largest deceleration [m/s^2] that both ends of the interval hold."""
        return min(self.at("braking", n_low), self.at("braking", n_high))

    def best_slip(self, n_low: float, n_high: float) -> float:
        """Drive slip with the least regret [-]: the pull that is lost at the worst n of the interval.

        For a single n it is the slip of the largest pull.
        """
        inside = (self.grid >= n_low - 1e-9) & (self.grid <= n_high + 1e-9)
        inside[int(np.argmin(np.abs(self.grid - 0.5 * (n_low + n_high))))] = True
        pull = self.pull[inside]
        regret = (pull.max(axis=1, keepdims=True) - pull).max(axis=0)
        return float(self.slips[int(np.argmin(regret))])

    def worst_pull(self) -> float:
        """The n of the grid with the smallest drawbar pull."""
        return float(self.grid[int(np.argmin(self.driving))])

    def worst_braking(self) -> float:
        """The n of the grid with the least braking."""
        return float(self.grid[int(np.argmin(self.braking))])

    def at(self, name: str, n: float) -> float:
        """Entry ``name`` ("braking", "driving", "drive_slip" or "resistance") at n."""
        return float(np.interp(n, self.grid, getattr(self, name)))

    @property
    def slip_table(self) -> SlipTable:
        """What `anticipated_slip` reads."""
        return SlipTable(self.grid, self.angles, self.side)

    def slip_angles(self, n: float, lateral: float) -> SlipAngles:
        """Size of the slip angles of front and rear axle [rad] at a lateral acceleration [m/s^2].

        The sign is that of ``lateral``; beyond what the soil holds the largest tabled angle.
        """
        return anticipated_slip(self.slip_table, n, lateral, 1.0)

    def turning_resistance(self, n: float, lateral: float) -> float:
        """Resistance of a bend beyond that straight on [N] at a lateral acceleration [m/s^2].

        In a steady bend the axles travel at their slip angles, and every wheel drives against the drag of
        its own. Beyond what the soil holds the value at the largest tabled angle.
        """
        place = float(np.interp(n, self.grid, np.arange(self.grid.size, dtype=np.float64)))
        low = min(int(place), self.grid.size - 2)
        found = 0.0
        for axle, angle in enumerate(self.slip_angles(n, abs(lateral))):
            ends = [float(np.interp(angle, self.angles, row)) for row in self.turning[axle, low : low + 2]]
            found += ends[0] + (place - low) * (ends[1] - ends[0])
        return found

    def _limits(self, slip_angle: float) -> np.ndarray:
        """(D,) lateral acceleration at a slip angle of both axles, the weaker one counting."""
        column = float(np.interp(slip_angle, self.angles, np.arange(self.angles.size, dtype=np.float64)))
        low = min(int(column), self.angles.size - 2)
        held = self.side[..., low] + (column - low) * (self.side[..., low + 1] - self.side[..., low])
        weaker: np.ndarray = held.min(axis=0)
        return weaker


@kernel
def anticipated_slip(table: SlipTable, n: float, lateral: float, share: float) -> SlipAngles:
    """``share`` of the slip angles that hold the acceleration ``lateral`` [m/s^2] on soil n."""
    grid, angles, side, size = table.grid, table.angles, table.side, abs(lateral)
    # The grid is even.
    place = (min(max(n, grid[0]), grid[-1]) - grid[0]) / (grid[1] - grid[0])
    low = min(int(place), grid.shape[0] - 2)
    found = np.empty(2)
    for axle in range(2):
        before, found[axle] = 0.0, angles[-1]
        for i in range(angles.shape[0]):
            held = side[axle, low, i] + (place - low) * (side[axle, low + 1, i] - side[axle, low, i])
            if held >= size:
                part = (size - before) / (held - before) if held > before else 0.0
                found[axle] = angles[i] if i == 0 else angles[i - 1] + part * (angles[i] - angles[i - 1])
                break
            before = held
    signed = share if lateral >= 0.0 else -share
    return SlipAngles(signed * found[0], signed * found[1])


@lru_cache(maxsize=16)
def soil_capability(
    vehicle: Vehicle, soil: Soil, n_range: tuple[float, float], shear: str = "resultant"
) -> Capability:
    """Tabulate the limits of ``vehicle`` on ``soil`` over ``n_range``; cached.

    Cornering counts as steady when the wheel's force along its travel is zero: the wheel then
    drives just enough to overcome its own motion resistance and the drag of its slip angle
    (J. Y. Wong, Theory of Ground Vehicles, section 2.9 for resistance against thrust). Where no
    slip does that, the slip of the largest force along the travel stands in.

    Parameters
    ----------
    vehicle, soil
        What the controller believes; ``soil.n`` is ignored.
    n_range
        (lowest, highest) exponent of the table; a single n is widened by 0.001.
    shear
        Shear law of `wheel_forces`.

    Raises
    ------
    SolverFailure
        When the soil cannot carry the vehicle somewhere in ``n_range``.
    """
    low, high = n_range[0], max(n_range[1], n_range[0] + 1e-3)
    nodes = np.linspace(low, high, _N_NODES)
    laws = WheelLaws(shear=shear)
    return table_of(nodes, [soil_row(vehicle, make_soil(soil, n=float(n)), laws) for n in nodes])


def table_of(nodes: np.ndarray, rows: Sequence[SoilRow]) -> Capability:
    """The table through the ``rows`` of soils at ``nodes`` (N,), which rise evenly."""
    dense = np.linspace(nodes[0], nodes[-1], _DENSE)
    scalars = PchipInterpolator(nodes, np.array([row.scalars for row in rows]))(dense)
    bends = PchipInterpolator(nodes, np.array([row.bends for row in rows]))(dense)
    side, turning = bends[:, 0], bends[:, 1]
    side = np.maximum.accumulate(np.maximum(side, 0.0), axis=2)
    return Capability(
        grid=dense,
        braking=scalars[:, 0],
        driving=scalars[:, 1],
        drive_slip=scalars[:, 2],
        resistance=scalars[:, 3],
        angles=_ANGLES,
        slips=_FINE_SLIPS,
        pull=PchipInterpolator(nodes, np.array([row.pull for row in rows]))(dense),
        side=np.ascontiguousarray(side.transpose(1, 0, 2)),
        turning=np.ascontiguousarray(turning.transpose(1, 0, 2)),
    )


def soil_row(vehicle: Vehicle, soil: Soil, laws: WheelLaws) -> SoilRow:
    """What one soil holds.

    Bends: lateral acceleration, and resistance beyond that straight on, of each axle at the slip angles.

    Raises
    ------
    SolverFailure
        When the soil cannot carry the rolling vehicle.
    """
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    axles = static_loads(vehicle)
    wheels = vehicle.wheels_per_axle
    rolling = [_rolling_wheel(soil, wheel, load / wheels, laws) for load in axles]
    slips = min((row[0] for row in rolling), key=len)
    brake = resistance = 0.0
    drive = np.zeros(slips.size)
    bends = np.zeros((2, 2, _ANGLES.size))
    for axle, (_, F_x, F_y, torque) in enumerate(rolling):
        load = axles[axle] / wheels
        braked = wheel_forces(soil, wheel, load=load, slip=_BRAKE_SLIPS, **laws._asdict())
        brake -= wheels * float(braked.F_x.min())
        along = F_x * np.cos(_ANGLES) + F_y * np.sin(_ANGLES)
        across = F_x * np.sin(_ANGLES) - F_y * np.cos(_ANGLES)
        bends[0, axle] = GRAVITY * _at_balance(along, across) / load
        dragged = wheels * _at_balance(along, torque / vehicle.r - along)
        bends[1, axle] = dragged - dragged[0]
        drive += wheels * F_x[: slips.size, 0]
        straight = F_x[:, :1]
        resistance += wheels * float(_at_balance(straight, torque[:, :1] / vehicle.r - straight)[0])
    best = float(drive.max())
    enough = slips[int(np.argmax(drive >= best - (1.0 - _NEAR_BEST) * abs(best)))]
    pull = np.interp(_FINE_SLIPS, slips, drive / vehicle.m, right=-GRAVITY)
    scalars = np.array([brake / vehicle.m, best / vehicle.m, enough, resistance])
    return SoilRow(scalars, bends, pull, _ANGLES)


def _rolling_wheel(soil: Soil, wheel: Wheel, load: float, laws: WheelLaws) -> tuple[np.ndarray, ...]:
    """Drive slips (S,), F_x, F_y [N] and torque [N m] (S, B) over slip and slip angle.

    A spinning wheel can sink without end where the same wheel, rolling, is carried: the highest
    slips are then left out.
    """
    for count in range(_SLIPS.size, 0, -4):
        slips = _SLIPS[:count]
        try:
            at = wheel_forces(
                soil, wheel, load=load, slip=slips[:, None], slip_angle=_ANGLES, **laws._asdict()
            )
        except SolverFailure:
            continue
        return slips, at.F_x, at.F_y, at.torque
    raise SolverFailure(f"the soil (n = {soil.n:g}) does not carry a rolling wheel under {load:g} N")


def _at_balance(along: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(B,) ``value`` (S, B) at the least slip for which ``along`` (S, B) is zero, column by column."""
    out = np.empty(along.shape[1])
    for j in range(along.shape[1]):
        up = np.flatnonzero(along[:, j] >= 0.0)
        if up.size == 0:
            out[j] = value[int(np.argmax(along[:, j])), j]
        elif up[0] == 0:
            out[j] = value[0, j]
        else:
            i = up[0]
            share = along[i - 1, j] / (along[i - 1, j] - along[i, j])
            out[j] = value[i - 1, j] + share * (value[i, j] - value[i - 1, j])
    return out
