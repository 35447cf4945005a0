"""Which values the fields of a soil may have, their defaults, and what they must fulfil together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TypedDict, Unpack, cast

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Soil
from offroad_env.world.argument_checks import is_one_of
from offroad_env.world.catalogue import Quantity, given_fields
from offroad_env.world.yaml_text import shown

__all__ = ["SOIL_DEFAULTS", "SOIL_RANGES", "SoilFields", "checked_soil", "require_positive_modulus"]

_SHEAR_MODULUS = Quantity(
    "in [1e-4, 0.5] m", 1e-4, 0.5, mistakes=((0.5000001, 6.0, "cm given as m"), (6.0, 1e3, "mm given as m"))
)
_ANGLE_SHARE = Quantity("in [-2, 2]", -2.0, 2.0, mistakes=((2.0000001, 90.0, "an angle in degrees"),))

#: Allowed range of every field; of k_c and k_phi see also `_check_moduli`.
SOIL_RANGES = MappingProxyType(
    {
        "k_c": Quantity("in [-1e8, 1e8] N/m^(n+1)", -1e8, 1e8),
        "k_phi": Quantity("in [0, 1e9] N/m^(n+2)", 0.0, 1e9),
        "n": Quantity("in (0.05, 2.5]", 0.05, 2.5, low_open=True),
        "c": Quantity("0 or in [100, 5e5] Pa", 0.0, 5e5, mistakes=((1e-9, 99.999999, "kPa given as Pa"),)),
        "phi": Quantity(
            "in [0, pi/2) rad", 0.0, 0.5 * math.pi, high_open=True, mistakes=((1.5707, 90.0, "degrees"),)
        ),
        "k_x": _SHEAR_MODULUS,
        "k_y": _SHEAR_MODULUS,
        "a_0": _ANGLE_SHARE,
        "a_1": _ANGLE_SHARE,
        "b_0": _ANGLE_SHARE,
        "b_1": _ANGLE_SHARE,
        "mu": Quantity("in (0, 3]", 0.0, 3.0, low_open=True, mistakes=((3.0000001, 300.0, "per cent"),)),
        "C_alpha": Quantity(
            "in (0, 200] 1/rad (per unit of wheel load)",
            0.0,
            200.0,
            low_open=True,
            mistakes=((200.0000001, 1e9, "N/rad, not divided by the wheel load"),),
        ),
        "C_kappa": Quantity(
            "in (0, 200] (per unit of wheel load)",
            0.0,
            200.0,
            low_open=True,
            mistakes=((200.0000001, 1e9, "N, not divided by the wheel load"),),
        ),
    }
)

#: Below both of these, a pair of moduli is taken for one in kN. Tables print k_phi of 43 ... 5880
#: kN/m^(n+2); k_c may be small or negative (plates of one soil have -44 and 49 kN/m^(n+1)), so that alone it
#: shows nothing.
_KN_K_C, _KN_K_PHI = 1e3, 1e4
#: |k_c| over k_phi [m] beyond which the two are not in one unit: published soils have up to 0.1.
_LARGEST_RATIO = 5.0
#: Widest wheel [m] that a soil with negative k_c has to bear.
_WIDEST = 3.0

#: No soil is like another in these: they have no default.
_ESSENTIAL = ("k_phi", "n", "c", "phi")

#: Class values for what is seldom published: K of firm soil (Wong, Theory of Ground Vehicles,
#: section 2.4), angles of compact sand (Wong & Reece 1967), a dry road.
SOIL_DEFAULTS = MappingProxyType(
    {
        "k_c": 0.0,
        "k_x": 0.01,
        "k_y": 0.01,
        "a_0": 0.43,
        "a_1": 0.32,
        "b_0": -0.1,
        "b_1": 0.0,
        "mu": 0.8,
        "C_alpha": 10.0,
    }
)

#: What the soil fields of hard ground hold. They are not used; zeros would divide.
_UNUSED = MappingProxyType({"k_phi": 1e9, "n": 1.0, "c": 0.0, "phi": 0.5})

#: Slips over which the order of the angles is demanded. Below -0.5 the straight lines of Wong &
#: Reece, fitted to driven wheels, may cross; the kernels then keep the order smoothly.
_ORDER_SLIPS = (-0.5, 0.0, 1.0)

#: Exit angle over entry angle at which a wheel still carries more the deeper it stands. Further back than
#: half the entry angle j_x changes its sign twice under a braked rim (small angles: a second zero of
#: a d = kappa (sin(theta_f) - sin(theta)) needs theta_r < -theta_f / 2), and shear behind the axle can pull
#: the wheel down. A contact that ends ahead of the axle leaves a rim that stands in front of the soil: its
#: force falls with depth. Of 40,000 random soils within, none has a falling load curve at slip 0, 0.3 or 1.
_EXIT_LOW, _EXIT_HIGH = -0.5, 0.1


class SoilFields(TypedDict, total=False):
    """Fields of a soil as `make_soil` takes them; their meaning stands there."""

    k_c: float | None
    k_phi: float | None
    n: float | None
    c: float | None
    phi: float | None
    k_x: float | None
    k_y: float | None
    a_0: float | None
    a_1: float | None
    b_0: float | None
    b_1: float | None
    mu: float | None
    C_alpha: float | None
    C_kappa: float | None


def checked_soil(start: Soil | None = None, kind: str | None = None, **fields: Unpack[SoilFields]) -> Soil:
    """A validated soil: the fields given, else those of ``start``, else the defaults; see `make_soil`."""
    given = given_fields("make_soil", cast("Mapping[str, float | None]", fields), SOIL_RANGES)
    rigid = _rigid(kind, start)
    values = _start_values(start, rigid, given) | given
    if "C_kappa" not in given:
        share = 1.0 if start is None else start.C_kappa / start.C_alpha
        values["C_kappa"] = share * values["C_alpha"]
    checked = {name: SOIL_RANGES[name].check(name, value) for name, value in values.items()}
    soil = Soil(**checked, rigid=1.0 if rigid else 0.0)
    if not rigid:
        _check_together(soil)
    return soil


def _rigid(kind: str | None, start: Soil | None) -> bool:
    if kind is None:
        return start is not None and start.rigid > 0.5
    if not is_one_of(kind, ("deformable", "rigid")):
        raise InvalidParameter(f"kind must be 'deformable' or 'rigid', got {shown(kind)}")
    return kind == "rigid"


def _start_values(start: Soil | None, rigid: bool, given: dict[str, float]) -> dict[str, float]:
    """Values for the fields that are not given: those of the base, else the defaults."""
    if start is not None and (rigid or start.rigid < 0.5):
        return {name: value for name, value in start._asdict().items() if name != "rigid"}
    values = dict(SOIL_DEFAULTS)
    if start is not None:
        values |= {"mu": start.mu, "C_alpha": start.C_alpha}
    if "k_x" in given:
        values["k_y"] = given["k_x"]
    if rigid:
        return values | _UNUSED
    missing = [name for name in _ESSENTIAL if name not in given]
    if missing:
        raise InvalidParameter(
            f"a deformable soil needs {', '.join(_ESSENTIAL)}; missing: {', '.join(missing)} "
            "- or name a base, as in make_soil('clay', n=0.4)"
        )
    return values


def _check_together(soil: Soil) -> None:
    """What one field alone cannot show: some stiffness, some strength, ordered angles."""
    _check_moduli(soil)
    if soil.c <= 0.0 and soil.phi <= 0.0:
        raise InvalidParameter("c and phi are both 0: the soil would have no strength; give one of them")
    for s in _ORDER_SLIPS:
        share_m = soil.a_0 + soil.a_1 * s
        share_r = soil.b_0 + soil.b_1 * s
        if not -1.0 < share_r < share_m < 1.0:
            raise InvalidParameter(
                f"contact angles must keep -theta_f < theta_r < theta_m < theta_f for slips -0.5 ... 1, "
                f"but at slip {s:g} theta_m/theta_f = a_0 + a_1 s = {share_m:.3g} and theta_r/theta_f = "
                f"b_0 + b_1 s = {share_r:.3g}, from a_0={soil.a_0:g}, a_1={soil.a_1:g}, b_0={soil.b_0:g}, "
                f"b_1={soil.b_1:g} - are a and b exchanged, or given in degrees?"
            )
    _check_load_curve(soil)


def _check_moduli(soil: Soil) -> None:
    """Refuse moduli that bear nothing, or that are most likely given in kN."""
    k_c, k_phi = soil.k_c, soil.k_phi
    if k_c == 0.0 and k_phi == 0.0:
        raise InvalidParameter("k_c and k_phi are both 0: the soil would carry no load; give at least k_phi")
    both = abs(k_c) < _KN_K_C
    if k_phi < _KN_K_PHI and (both or abs(k_c) > _LARGEST_RATIO * k_phi > 0.0):
        raise InvalidParameter(
            f"k_phi must be at least {_KN_K_PHI:g} N/m^(n+2) beside this k_c, got k_phi={k_phi:g}, "
            f"k_c={k_c:g} - {'both ' if both else ''}kN given as N?"
        )
    if k_c / _WIDEST + k_phi <= 0.0:
        raise InvalidParameter(
            f"k_c/b + k_phi must be positive for a wheel of some width b, got k_c={k_c:g}, k_phi={k_phi:g}: "
            f"not even one of {_WIDEST:g} m is borne"
        )


def require_positive_modulus(soil: Soil, b: float) -> None:
    """Refuse a soil whose k_c is so far below zero that a wheel of width ``b`` [m] presses on nothing.

    Raises
    ------
    InvalidParameter
        With the narrowest wheel that the soil bears.
    """
    if soil.rigid < 0.5 and soil.k_c / b + soil.k_phi <= 0.0:
        raise InvalidParameter(
            f"k_c/b + k_phi must be positive, but with k_c={soil.k_c:g}, k_phi={soil.k_phi:g} it is not for "
            f"a wheel {b:g} m wide: plates of other widths do not extend to wheels below "
            f"{-soil.k_c / soil.k_phi:.3g} m"
        )


def _check_load_curve(soil: Soil) -> None:
    """Refuse an exit angle for which the vertical force of a rolling wheel does not grow with its sinkage."""
    for s, high in ((-1.0, 1.0), (0.0, _EXIT_HIGH), (1.0, _EXIT_HIGH)):
        share_r = soil.b_0 + soil.b_1 * s
        if not _EXIT_LOW <= share_r <= high:
            where = "behind" if share_r < _EXIT_LOW else "ahead of"
            raise InvalidParameter(
                f"theta_r/theta_f = b_0 + b_1 s must be in [{_EXIT_LOW:g}, {_EXIT_HIGH:g}] (below slip 0 "
                f"only the lower bound), but is {share_r:.3g} at slip {s:g}, from b_0={soil.b_0:g}, "
                f"b_1={soil.b_1:g}: a contact that ends so far {where} the axle has no monotone load curve "
                "- published soils use -0.1 ... 0; is the sign right?"
            )
