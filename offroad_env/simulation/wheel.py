"""Terramechanics of a single wheel: forces at a given load or sinkage, for arrays of inputs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact import SUNK, Support, slope_frame
from offroad_env.physics.contact_angles import AngleShares, entry_angle, wong_reece_angles
from offroad_env.physics.hard_ground import hard_ground_forces
from offroad_env.physics.records import ContactOptions, RutSection, Soil, Structure, Tyre, Wheel, WheelMotion
from offroad_env.physics.structured_contact import (
    contact_solution,
    deflection_on_soil,
    exit_angle,
    reaction_at_sinkage,
)
from offroad_env.world.argument_checks import is_one_of, numbers, require_record
from offroad_env.world.soil_fields import require_positive_modulus
from offroad_env.world.structures import read_structure
from offroad_env.world.tyres import read_tyre, require_fitting_tyre, with_tyre
from offroad_env.world.yaml_text import shown

__all__ = ["WheelForces", "wheel_forces"]

_COLUMNS = 9


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
    deflection: np.ndarray  #: of a tyre, by which its hub comes down besides the sinkage [m]


@kernel
def _wheel_motion(slip: float, slip_angle: float) -> WheelMotion:
    """Speeds over the larger of rim and travel speed."""
    tan_beta = math.tan(slip_angle)
    if slip >= 0.0:
        return WheelMotion(1.0, 1.0 - slip, (1.0 - slip) * tan_beta)
    return WheelMotion(1.0 + slip, 1.0, tan_beta)


@inline_kernel
def _other_angles(
    structure: Structure | None, soil: Soil, wheel: Wheel, h: float, load: float, shares: AngleShares
) -> tuple[float, float]:
    """(theta_m, theta_r) [rad] at sinkage ``h`` [m] under ``load`` [N]."""
    theta_f = entry_angle(h, wheel.r)
    if structure is None:
        return shares.m * theta_f, shares.r * theta_f
    if structure.own_sinkage < 0.5:
        return shares.m * theta_f, shares.r * theta_f
    return 0.0, -exit_angle(structure, soil, wheel, h, load)


@kernel
def _load_at(
    structure: Structure | None,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    h: float,
    options: ContactOptions,
) -> float:
    """Load [N] of a wheel at sinkage ``h`` [m]: a tyre's deflection and load follow from each other."""
    load, rut = 0.0, RutSection(0.0, 0.0, 0.0)
    # The patch grows like the root of the deflection: each round halves the error at least.
    for _ in range(60):
        before = load
        load = reaction_at_sinkage(structure, soil, wheel, motion, h, load, rut, options).F_z
        if abs(load - before) <= 1e-13 * load:
            break
    return load


@kernel
def _many_wheels(
    soil: Soil,
    wheel: Wheel,
    values: np.ndarray,
    by_load: bool,
    resultant: float,
    structure: Structure | None,
    out: np.ndarray,
    status: np.ndarray,
) -> None:
    """Row by row: ``values`` (M, 3) = load or sinkage, slip, slip angle; ``out`` (M, 9)."""
    frame, options = slope_frame(0.0, 0.0), ContactOptions(0.0, resultant, True)
    warm, rut = np.zeros(at.STRUCTURED_CONTACT_SIZE), RutSection(0.0, 0.0, 0.0)
    for i in range(values.shape[0]):
        size, slip, slip_angle = values[i, 0], values[i, 1], values[i, 2]
        motion = _wheel_motion(slip, slip_angle)
        shares = wong_reece_angles(soil, slip)
        if by_load:
            warm[:] = 0.0
            support = Support(size, 0.0, 1.0)
            found = contact_solution(structure, soil, wheel, motion, frame, support, warm, options)
            status[i], h = found.status, found.sinkage
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = found.F_l, found.F_c, found.F_n, found.torque
        elif soil.rigid > 0.5:
            h = 0.0
            out[i, 0], out[i, 1], out[i, 3] = hard_ground_forces(soil, wheel.r, 0.0, motion, 0.0)
        else:
            h = size
            load = _load_at(structure, soil, wheel, motion, h, options)
            one = reaction_at_sinkage(structure, soil, wheel, motion, h, load, rut, options)
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = one
        f = deflection_on_soil(structure, soil, wheel, out[i, 2])
        theta_f = entry_angle(h + f, wheel.r)
        out[i, 4], out[i, 5], out[i, 8] = h, theta_f, f
        out[i, 6], out[i, 7] = _other_angles(structure, soil, wheel, h, out[i, 2], shares)


def _checked(name: str, value: ArrayLike, low: float, high: float, unit: str, hint: str) -> np.ndarray:
    array = numbers(name, value)
    bad = ~((array >= low) & (array <= high))
    if bad.any():
        first = np.atleast_1d(array)[np.atleast_1d(bad)][0]
        raise InvalidParameter(f"{name} must be in [{low:g}, {high:g}] {unit}, got {first:g} - {hint}")
    return array


def wheel_forces(  # noqa: PLR0913 - likewise for one wheel
    soil: Soil,
    wheel: Wheel,
    *,
    load: ArrayLike | None = None,
    sinkage: ArrayLike | None = None,
    slip: ArrayLike,
    slip_angle: ArrayLike = 0.0,
    shear: str = "independent",
    structure: str | Structure | None = None,
    tyre: str | Tyre | None = None,
    errors: str = "raise",
) -> WheelForces:
    """Forces of a wheel on soil, at a given load or a given sinkage.

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
        ``(r omega - v) / max(|r omega|, |v|)`` [-], -1 (locked) ... 1 (on the spot), v along the wheel.
    slip_angle : array_like
        Angle of the travel from the wheel's heading [rad], -pi/2 ... pi/2; positive when the wheel
        slides to its left, which gives a negative side force.
    shear : {"independent", "resultant"}
        "independent": longitudinal and lateral shear each have the whole Mohr-Coulomb strength
        (Buzhardt & Tallapragada, ACC 2021). "resultant": one strength along the displacement.
    structure : str or Structure, optional
        All laws of the wheel together instead (`world.structures`), such as "grid" on virgin soil; its
        shear strength then counts, ``shear`` does not.
    tyre : str or Tyre, optional
        A flexible tyre, by its name in `world.tyres.TYRES` or from `make_tyre`, with ``structure`` "grid" or
        "field"; slip then refers to its effective rolling radius. None: a rigid rim.
    errors : {"raise", "nan"}
        What becomes of loads that the soil cannot carry: "raise" refuses all, "nan" gives NaN in their place.

    Returns
    -------
    WheelForces
        Arrays of the broadcast shape of the inputs, SI units.

    Raises
    ------
    InvalidParameter, SolverFailure
        For inputs out of range; where no sinkage below 0.95 r carries the load, unless ``errors="nan"``.

    Notes
    -----
    Relative accuracy of forces against the load and of the sinkage: 1e-6, tested by adaptive quadrature.
    """
    _require_kinds(soil, wheel, shear, errors)
    require_positive_modulus(soil, wheel.b)
    size, by_load = _load_or_sinkage(load, sinkage, wheel)
    slip = _checked("slip", slip, -1.0, 1.0, "", "in percent?")
    slip_angle = _checked("slip_angle", slip_angle, -1.5708, 1.5708, "rad", "in degrees?")
    # What is rounded to beyond a right angle would slide the other way.
    inputs = np.broadcast_arrays(size, slip, np.clip(slip_angle, -0.5 * math.pi, 0.5 * math.pi))
    values, shape = np.stack([array.ravel() for array in inputs], axis=1), inputs[0].shape
    out, status = np.zeros((len(values), _COLUMNS)), np.zeros(len(values))
    flexible, resultant = read_tyre(tyre), 1.0 if shear == "resultant" else 0.0
    laws = _laws(structure, flexible, wheel)
    _many_wheels(soil, wheel, values, by_load, resultant, laws, out, status)
    _require_support(wheel, values, status if errors == "raise" else status[:0])
    out[status >= SUNK] = np.nan
    if flexible is not None and soil.rigid < 0.5:  # hard ground acts on the unloaded circle
        out[:, 3] *= 1.0 - flexible.rolling * out[:, 8] / wheel.r
    return WheelForces(*(out[:, i].reshape(shape) for i in range(_COLUMNS)))


def _require_kinds(soil: Soil, wheel: Wheel, shear: str, errors: str) -> None:
    require_record("soil", soil, Soil, "make_soil or SOILS")
    require_record("wheel", wheel, Wheel, "make_wheel")
    _require_word("shear", shear, ("independent", "resultant"))
    _require_word("errors", errors, ("raise", "nan"))


def _quoted(word: str) -> str:
    return f'"{word}"'


def _require_word(name: str, value: str, words: tuple[str, str]) -> None:
    if not is_one_of(value, words):
        raise InvalidParameter(f"{name} must be {' or '.join(map(_quoted, words))}, got {shown(value)}")


def _laws(structure: str | Structure | None, tyre: Tyre | None, wheel: Wheel) -> Structure | None:
    """The structure by which a wheel is computed; None for the plain rigid wheel."""
    laws = read_structure(structure) if isinstance(structure, str) else structure
    if laws is not None:
        require_record("structure", laws, Structure, "make_structure, or a name")
    if tyre is None:
        return laws
    require_fitting_tyre(tyre, wheel)
    # The slip that is given is that of the belt: it runs at the rim speed, whatever the deflection.
    return with_tyre(laws, tyre._replace(rolling=0.0))


def _load_or_sinkage(
    load: ArrayLike | None, sinkage: ArrayLike | None, wheel: Wheel
) -> tuple[np.ndarray, bool]:
    """What presses the wheel down, and whether it is a load."""
    if load is not None and sinkage is None:
        return _checked("load", load, 0.0, 1e7, "N", "a load pulls the wheel down and is positive"), True
    if sinkage is not None and load is None:
        return _checked("sinkage", sinkage, 0.0, wheel.r, "m", "deeper than the radius, or in mm?"), False
    raise InvalidParameter("give exactly one of load [N] and sinkage [m]")


def _require_support(wheel: Wheel, values: np.ndarray, status: np.ndarray) -> None:
    """Refuse loads under which the wheel sinks without limit."""
    failed = np.flatnonzero(status >= SUNK)
    if failed.size:
        load, slip, slip_angle = values[failed[0]]
        raise SolverFailure(
            f"the soil cannot carry a load of {load:g} N on a wheel of radius {wheel.r:g} m and width "
            f"{wheel.b:g} m at slip {slip:g}, slip angle {slip_angle:g} rad with a sinkage below "
            f"0.95 of the radius ({failed.size} of {len(values)} inputs) - load in kg, or k_phi in kN?"
        )
