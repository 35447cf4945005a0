"""Soils: the validating factory `make_soil` and the catalogue `SOILS` of published soils."""

from __future__ import annotations

from functools import lru_cache
from typing import Unpack

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Soil
from offroad_env.world.catalogue import Catalogue
from offroad_env.world.published_soils import published_soils
from offroad_env.world.soil_fields import SOIL_RANGES, SoilFields, checked_soil
from offroad_env.world.yaml_text import shown

__all__ = ["SOILS", "SoilFields", "make_soil", "with_exponent"]


def make_soil(
    base: str | Soil | None = None, *, kind: str | None = None, **fields: Unpack[SoilFields]
) -> Soil:
    """Make a validated soil, from scratch or from another one.

    Parameters
    ----------
    base
        Name in `SOILS`, or a soil, with the values of all fields that are not given. Without it
        ``k_phi, n, c, phi`` are needed (hard ground needs nothing), and the rest has the default
        named below.
    kind
        "deformable" or "rigid" (hard ground); default: that of ``base``, else deformable.
    k_c
        Cohesive modulus of sinkage [N/m^(n+1)]; default 0. Tables print kN. May be negative where plates of
        several widths gave that; then narrow wheels are refused where they meet the soil.
    k_phi
        Frictional modulus of sinkage [N/m^(n+2)]. Tables print kN.
    n
        Sinkage exponent [-].
    c
        Cohesion [Pa]. Tables print kPa.
    phi
        Angle of internal shearing resistance [rad]. Tables print degrees.
    k_x, k_y
        Longitudinal and lateral shear deformation modulus [m]; default 0.01 (firm soil). ``k_y``
        follows a given ``k_x`` where there is no base.
    a_0, a_1
        theta_m / theta_f = a_0 + a_1 s [-]; default 0.43, 0.32 (compact sand).
    b_0, b_1
        theta_r / theta_f = b_0 + b_1 s [-]; default -0.1, 0 (contact ends a little behind the axle). From
        -0.5 to 0.1: beyond, the vertical force of a rolling wheel does not grow with its sinkage.
    mu
        Friction coefficient of hard ground [-]; default 0.8.
    C_alpha
        Cornering stiffness of hard ground per unit of wheel load [1/rad]; default 10.
    C_kappa
        Stiffness of hard ground against slip along the wheel per unit of wheel load [-]; default
        ``C_alpha``, or as many times that as in ``base``.

    Returns
    -------
    Soil
        Record of floats that the kernels trust.

    Raises
    ------
    InvalidParameter
        With name, value, allowed range and likely mistake.
    TypeError
        For a field that a soil does not have.

    Examples
    --------
    >>> soft = make_soil("clay", n=0.4)
    >>> soft.n, soft.c
    (0.4, 4140.0)
    """
    return checked_soil(_base_record(base), kind, **fields)


def with_exponent(soil: Soil, n: float) -> Soil:
    """``make_soil(soil, n=n)``, in a tenth of the time where the soil has been asked for before.

    Nothing else that a soil must fulfil depends on n.

    Raises
    ------
    InvalidParameter
        For an n out of range.
    """
    return _valid(soil)._replace(n=SOIL_RANGES["n"].check("n", n))


@lru_cache(maxsize=64)
def _valid(soil: Soil) -> Soil:
    return make_soil(soil)


def _base_record(base: str | Soil | None) -> Soil | None:
    if base is None or isinstance(base, Soil):
        return base
    if isinstance(base, str):
        return SOILS[base]
    raise InvalidParameter(f"base must be a name in SOILS or a Soil, got {shown(base)}")


#: Published soils by name; ``SOILS.entry(name)`` gives title, source and remark.
SOILS: Catalogue[Soil] = Catalogue("soil", published_soils())
