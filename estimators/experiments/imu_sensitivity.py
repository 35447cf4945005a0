"""Sensitivity of every channel of the inertial unit to the sinkage exponent, and where it vanishes.

The longitudinal force of a rolling wheel need not be monotonic in n: a softer soil gives a deeper
rut and more resistance, but also a longer contact on which shear can pull. Where its slope
vanishes the longitudinal acceleration holds no information on n, and where it takes the truth's value again
it does not distinguish the two soils.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from estimators.experiments.buzhardt_tallapragada import CHOICES, ROWS, Row, row_plant
from estimators.models.imu_prediction import CHANNELS
from offroad_env.physics import state as at
from offroad_env.physics.axle import Plant, static_loads
from offroad_env.physics.records import Wheel
from offroad_env.simulation.simulator import settled_state, simulate
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.vehicles import VEHICLES

__all__ = [
    "ForceCurve",
    "Sensitivity",
    "channel_distance",
    "force_curve",
    "information_rate",
    "sensitivity_curves",
]

_N = np.linspace(0.36, 1.4, 53)
_SPEED = CHOICES["start_speed"].value
#: Drives over which channels are compared, and what is left out until heave and pitch have settled [s].
_DURATION, _FIRST = 8.0, 2.0
#: Half the step of the central difference in n [-].
_STEP = 2e-3
_NOISE = np.array([CHOICES["noise_acceleration"].value] * 3 + [CHOICES["noise_rate"].value] * 2)


@dataclass(frozen=True, kw_only=True)
class ForceCurve:
    """Longitudinal force of the rolling vehicle on level ground."""

    n: np.ndarray  #: (K,) sinkage exponents [-]
    acceleration: np.ndarray  #: (K,) force of all wheels over the mass [m/s^2]
    roots: tuple[float, ...]  #: exponents that pull like the true one, itself among them [-]
    turning_points: tuple[float, ...]  #: exponents at which the slope vanishes [-]


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """How far every channel is from what the true soil would give."""

    soil: str
    n_true: float
    force: ForceCurve
    n: np.ndarray  #: (K,) sinkage exponents [-]
    distances: dict[str, np.ndarray]  #: manoeuvre -> (K, 5) rms difference over the sensor's noise [-]


def force_curve(soil: str, n_true: float | None = None) -> ForceCurve:
    """F_x(n) of the paper's vehicle on level ground, with its roots and turning points.

    Parameters
    ----------
    soil : str
        Of the rows: "clay" or "dry_sand".
    n_true : float, optional
        Default: the soil's own exponent [-].
    """
    n_true = SOILS[soil].n if n_true is None else n_true
    vehicle, slip = VEHICLES["paper"], CHOICES[f"slip_{soil}"].value
    wheel, count = Wheel(vehicle.r, vehicle.b), vehicle.wheels_per_axle

    def pull(n: float) -> float:
        forces = (
            wheel_forces(make_soil(soil, n=float(n)), wheel, load=load / count, slip=slip).F_x
            for load in static_loads(vehicle)
        )
        return count * float(sum(forces)) / vehicle.m

    acceleration = np.array([pull(n) for n in _N])
    curve = CubicSpline(_N, acceleration)
    return ForceCurve(
        n=_N,
        acceleration=acceleration,
        # A root at a knot of the spline belongs to both of its neighbours.
        roots=tuple(np.unique(curve.solve(float(curve(n_true)), extrapolate=False).round(6)).tolist()),
        turning_points=tuple(float(n) for n in curve.derivative().roots(extrapolate=False)),
    )


def _channels(plant: Plant, row: Row) -> np.ndarray:
    """(T, 5) channels of a drive at constant speed; a_x is what the wheels give, not the held speed's."""
    state, warm = settled_state(plant, v_x=_SPEED)
    run = simulate(
        plant,
        state,
        warm,
        steer=row.steer,
        speed_rate=lambda t: 0.0,
        duration=_DURATION,
        dt=CHOICES["dt"].value,
    )
    r, x = run.readings, run.states
    steer = np.array([row.steer(t) for t in run.t])
    front = r[:, at.F_L] * np.cos(steer) - r[:, at.F_C] * np.sin(steer)
    a_x = (front + r[:, at.AXLE + at.F_L]) / plant.vehicle.m
    return np.stack([a_x, r[:, at.A_Y], r[:, at.A_Z], x[:, at.PITCH_RATE], x[:, at.YAW_RATE]], axis=1)


def channel_distance(row: Row, n: np.ndarray) -> np.ndarray:
    """How far the channels of a drive over a row's ground are from those on its true soil.

    Speed is held at that of the start, so that all soils see the same ground at the same time.

    Parameters
    ----------
    row : Row
        Its soil, ground and steering.
    n : array (K,)
        Sinkage exponents [-].

    Returns
    -------
    (K, 5) : rms difference over the drive, in standard deviations of the sensor's noise,
        `models.CHANNELS`.
    """
    late = round(_FIRST / CHOICES["dt"].value)
    truth = _channels(row_plant(row), row)[late:]
    distances = np.empty((len(n), len(CHANNELS)))
    for i, value in enumerate(n):
        apart = _channels(row_plant(row, n=float(value)), row)[late:] - truth
        distances[i] = np.sqrt(np.mean(apart**2, axis=0)) / _NOISE
    return distances


def information_rate(row: Row, n: np.ndarray) -> np.ndarray:
    """Fisher information about n that every channel gives in a second, the state being known.

    Parameters
    ----------
    row : Row
        Ground and steering; its soil with every exponent of ``n`` in turn as the truth.
    n : array (K,)
        Sinkage exponents [-].

    Returns
    -------
    (K, 5) : [1/s], `models.CHANNELS`; the standard deviation of n after a time T is (sum T)^-1/2.
    """
    dt = CHOICES["dt"].value
    late = round(_FIRST / dt)
    rate = np.empty((len(n), len(CHANNELS)))
    for i, value in enumerate(n):
        low, high = (_channels(row_plant(row, n=float(value) + side), row)[late:] for side in (-_STEP, _STEP))
        slope = (high - low) / (2.0 * _STEP)
        rate[i] = np.mean((slope / _NOISE) ** 2, axis=0) / dt
    return rate


def sensitivity_curves(soil: str) -> Sensitivity:
    """Force curve and channels of a soil: straight on both grounds of the table, and steered."""
    rows = [row for row in ROWS if row.soil == soil]
    names = ("straight, H0 = 0.05 m", "straight, H0 = 0.01 m", "0.2 sin t, H0 = 0.05 m")
    n = np.linspace(_N[0], _N[-1], 27)
    return Sensitivity(
        soil=soil,
        n_true=SOILS[soil].n,
        force=force_curve(soil),
        n=n,
        distances={name: channel_distance(row, n) for name, row in zip(names, rows, strict=False)},
    )
