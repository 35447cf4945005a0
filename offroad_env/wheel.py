"""Terramechanics of a single wheel, for people who want nothing else of this project."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK, slope_frame, solve_contact
from offroad_env.physics.records import Soil, Wheel
from offroad_env.physics.wheel_soil import contact_angle_shares, entry_angle, rigid_forces, wheel_reaction

__all__ = ["WheelForces", "wheel_forces"]

_COLUMNS = 8


class WheelForces(NamedTuple):
    """Forces of the ground on one wheel; every field has the broadcast shape of the inputs."""

    F_x: np.ndarray  #: longitudinal force, forward positive (drawbar pull) [N]
    F_y: np.ndarray  #: side force, left positive; opposes the slip angle [N]
    F_z: np.ndarray  #: vertical force, up positive [N]
    torque: np.ndarray  #: torque of the soil against the wheel's rotation [N m]
    sinkage: np.ndarray  #: depth of the lowest point of the rim below the surface [m]
    theta_f: np.ndarray  #: entry angle, ahead of the vertical positive [rad]
    theta_m: np.ndarray  #: angle of the largest pressure [rad]
    theta_r: np.ndarray  #: exit angle, negative behind the vertical [rad]


@kernel
def _wheel_motion(slip, slip_angle):
    """(r omega, v_l, v_c) over the larger of rim and travel speed."""
    tan_beta = math.tan(slip_angle)
    if slip >= 0.0:
        return 1.0, 1.0 - slip, (1.0 - slip) * tan_beta
    return 1.0 + slip, 1.0, tan_beta


@kernel
def _many_wheels(soil, wheel, values, by_load, resultant, out, status):
    """Row by row: ``values`` (M, 3) = load or sinkage, slip, slip angle; ``out`` (M, 8)."""
    frame = slope_frame(0.0, 0.0)
    warm = np.zeros(3)
    for i in range(values.shape[0]):
        size, slip, slip_angle = values[i, 0], values[i, 1], values[i, 2]
        motion = _wheel_motion(slip, slip_angle)
        share_m, share_r = contact_angle_shares(soil, slip)
        if by_load:
            warm[:] = 0.0
            support = (size, 0.0, 1.0)
            result = solve_contact(soil, wheel, motion, frame, support, warm, (0.0, resultant, True))
            status[i], out[i, 0], out[i, 1], out[i, 2], out[i, 3], h = result
        elif soil.rigid > 0.5:
            h = 0.0
            out[i, 0], out[i, 1], out[i, 3] = rigid_forces(soil, wheel.r, 0.0, motion, 0.0)
        else:
            h = size
            F = wheel_reaction(soil, wheel, h, motion, 0.0, (resultant, True))
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = F
        theta_f = entry_angle(h, wheel.r)
        out[i, 4], out[i, 5] = h, theta_f
        out[i, 6], out[i, 7] = share_m * theta_f, share_r * theta_f


def _checked(name: str, value, low: float, high: float, unit: str, hint: str) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    bad = ~((array >= low) & (array <= high))
    if bad.any():
        first = np.atleast_1d(array)[np.atleast_1d(bad)][0]
        raise InvalidParameter(f"{name} must be in [{low:g}, {high:g}] {unit}, got {first:g} - {hint}")
    return array


def wheel_forces(
    soil: Soil,
    wheel: Wheel,
    *,
    load=None,
    sinkage=None,
    slip,
    slip_angle=0.0,
    shear: str = "independent",
) -> WheelForces:
    """Forces of a rigid wheel on soil, at a given load or a given sinkage.

    Parameters
    ----------
    soil : Soil
        From `make_soil` or `SOILS`.
    wheel : Wheel
        From `make_wheel`.
    load : array_like, optional
        Vertical load on the wheel [N]; the sinkage is solved for. Give this or ``sinkage``.
    sinkage : array_like, optional
        Sinkage [m], less than the radius.
    slip : array_like
        (r omega - v) / max(|r omega|, |v|) [-], -1 (locked) ... 1 (spinning on the spot), with v
        the speed along the wheel.
    slip_angle : array_like
        Angle of the travel from the wheel's heading [rad], -pi/2 ... pi/2; positive when the wheel
        slides to its left, which gives a negative side force.
    shear : {"independent", "resultant"}
        "independent": longitudinal and lateral shear each have the whole Mohr-Coulomb strength
        (Buzhardt & Tallapragada, ACC 2021). "resultant": one strength along the displacement.

    Returns
    -------
    WheelForces
        Arrays of the broadcast shape of the inputs (scalars give 0-d arrays), SI units.

    Raises
    ------
    InvalidParameter
        For inputs out of range.
    SolverFailure
        When the soil cannot carry the load at any sinkage below 0.95 of the radius.

    Notes
    -----
    Relative accuracy of forces against the load and of the sinkage: 1e-6 or better, tested
    against adaptive quadrature.
    """
    if (load is None) == (sinkage is None):
        raise InvalidParameter("give exactly one of load [N] and sinkage [m]")
    if shear not in ("independent", "resultant"):
        raise InvalidParameter(f'shear must be "independent" or "resultant", got {shear!r}')
    by_load = load is not None
    if by_load:
        size = _checked("load", load, 0.0, 1e7, "N", "a load pulls the wheel down and is positive")
    else:
        size = _checked("sinkage", sinkage, 0.0, wheel.r, "m", "deeper than the radius, or in mm?")
    slip = _checked("slip", slip, -1.0, 1.0, "", "in percent?")
    slip_angle = _checked("slip_angle", slip_angle, -1.5708, 1.5708, "rad", "in degrees?")
    size, slip, slip_angle = np.broadcast_arrays(size, slip, slip_angle)
    shape = size.shape
    values = np.stack([size.ravel(), slip.ravel(), slip_angle.ravel()], axis=1)
    out, status = np.zeros((len(values), _COLUMNS)), np.zeros(len(values))
    _many_wheels(soil, wheel, values, by_load, 1.0 if shear == "resultant" else 0.0, out, status)
    failed = np.flatnonzero(status >= SUNK)
    if failed.size:
        worst = values[failed[0]]
        raise SolverFailure(
            f"the soil cannot carry a load of {worst[0]:g} N on a wheel of radius {wheel.r:g} m and width "
            f"{wheel.b:g} m at slip {worst[1]:g}, slip angle {worst[2]:g} rad with a sinkage below "
            f"0.95 of the radius ({failed.size} of {len(values)} inputs) - load in kg, or k_phi in kN?"
        )
    return WheelForces(*(out[:, i].reshape(shape) for i in range(_COLUMNS)))
