"""Soils: the validating factory `make_soil` and the catalogue `SOILS` of published soils."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import NamedTuple

from offroad_env.catalogue import Catalogue, Entry, Quantity
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Soil

__all__ = ["SOILS", "make_soil"]

_SHEAR_MODULUS = Quantity(
    "in [1e-4, 0.5] m", 1e-4, 0.5, mistakes=((0.5000001, 6.0, "cm given as m"), (6.0, 1e3, "mm given as m"))
)
_ANGLE_SHARE = Quantity("in [-2, 2]", -2.0, 2.0, mistakes=((2.0000001, 90.0, "an angle in degrees"),))

#: Allowed range of every field. The "kN" traps lie where no published soil is: tables print
#: 43 ... 5880 kN/m^(n+2) and 0.06 ... 102 kN/m^(n+1).
_FIELDS = MappingProxyType(
    {
        "k_c": Quantity(
            "0 or in [50, 1e8] N/m^(n+1)", 0.0, 1e8, mistakes=((1e-9, 49.999999, "kN/m^(n+1) given as N"),)
        ),
        "k_phi": Quantity(
            "0 or in [1e4, 1e9] N/m^(n+2)", 0.0, 1e9, mistakes=((1e-9, 9999.999, "kN/m^(n+2) given as N"),)
        ),
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

#: No soil is like another in these: they have no default.
_ESSENTIAL = ("k_phi", "n", "c", "phi")

#: Class values for what is seldom published: K of firm soil (Wong, Theory of Ground Vehicles,
#: section 2.4), angles of compact sand (Wong & Reece 1967), a dry road.
_DEFAULTS = MappingProxyType(
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


def make_soil(  # noqa: PLR0913 - a misspelt name must be refused, so every field is spelt out
    base: str | Soil | None = None,
    *,
    kind: str | None = None,
    k_c: float | None = None,
    k_phi: float | None = None,
    n: float | None = None,
    c: float | None = None,
    phi: float | None = None,
    k_x: float | None = None,
    k_y: float | None = None,
    a_0: float | None = None,
    a_1: float | None = None,
    b_0: float | None = None,
    b_1: float | None = None,
    mu: float | None = None,
    C_alpha: float | None = None,
    C_kappa: float | None = None,
) -> Soil:
    """Make a validated soil, from scratch or from another one.

    Parameters
    ----------
    base
        Name in `SOILS`, or a soil, whose values stand for whatever is not given here. Without it
        ``k_phi, n, c, phi`` are needed (hard ground needs nothing), and the rest has the default
        named below.
    kind
        "deformable" or "rigid" (hard ground); default: that of ``base``, else deformable.
    k_c
        Cohesive modulus of sinkage [N/m^(n+1)]; default 0. Tables print kN.
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
        theta_r / theta_f = b_0 + b_1 s [-]; default -0.1, 0 (contact ends a little behind the axle).
    mu
        Friction coefficient of hard ground [-]; default 0.8.
    C_alpha
        Side-slip stiffness of hard ground per unit of wheel load [1/rad]; default 10.
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

    Examples
    --------
    >>> soft = make_soil("clay", n=0.4)
    >>> soft.n, soft.c
    (0.4, 4140.0)
    """
    given = {
        "k_c": k_c, "k_phi": k_phi, "n": n, "c": c, "phi": phi, "k_x": k_x, "k_y": k_y,
        "a_0": a_0, "a_1": a_1, "b_0": b_0, "b_1": b_1, "mu": mu, "C_alpha": C_alpha,
        "C_kappa": C_kappa,
    }  # fmt: skip
    given = {name: value for name, value in given.items() if value is not None}
    start = _base_record(base)
    rigid = _rigid(kind, start)
    values = _start_values(start, rigid, given) | given
    if C_kappa is None:
        share = 1.0 if start is None else start.C_kappa / start.C_alpha
        values["C_kappa"] = share * values["C_alpha"]
    checked = {name: _FIELDS[name].check(name, value) for name, value in values.items()}
    soil = Soil(**checked, rigid=1.0 if rigid else 0.0)
    if not rigid:
        _check_together(soil)
    return soil


def _base_record(base: str | Soil | None) -> Soil | None:
    if base is None or isinstance(base, Soil):
        return base
    if isinstance(base, str):
        return SOILS[base]
    raise InvalidParameter(f"base must be a name in SOILS or a Soil, got {base!r}")


def _rigid(kind: str | None, start: Soil | None) -> bool:
    if kind is None:
        return start is not None and start.rigid > 0.5
    if kind not in ("deformable", "rigid"):
        raise InvalidParameter(f"kind must be 'deformable' or 'rigid', got {kind!r}")
    return kind == "rigid"


def _start_values(start: Soil | None, rigid: bool, given: dict[str, float]) -> dict[str, float]:
    """Values for the fields that are not given: those of the base, else the defaults."""
    if start is not None and (rigid or start.rigid < 0.5):
        return {name: value for name, value in start._asdict().items() if name != "rigid"}
    values = dict(_DEFAULTS)
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
    if soil.k_c + soil.k_phi <= 0.0:
        raise InvalidParameter("k_c and k_phi are both 0: the soil would carry no load; give at least k_phi")
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


class _Class(NamedTuple):
    """Values that a table of Bekker parameters does not print, by class of soil."""

    K: float  #: shear deformation modulus, both directions [m]
    a_0: float
    a_1: float
    b_0: float
    remark: str


_ANGLES_LOOSE = "theta_m/theta_f = 0.18 + 0.32 s as Wong & Reece (1967) measured in loose sand"
_ANGLES_COMPACT = "theta_m/theta_f = 0.43 + 0.32 s as Wong & Reece (1967) measured in compact sand"
_EXIT = (
    "theta_r/theta_f = -0.1 is a choice: soil recovers a little behind the axle, so the exit angle is "
    "small and negative, and it is not published for this soil"
)
_NO_EXIT = "theta_r = 0 is a choice: compacted snow hardly recovers, so contact ends under the axle"

_LOOSE = _Class(
    0.025, 0.18, 0.32, -0.1, f"K = 2.5 cm is Wong's value for loose sand; {_ANGLES_LOOSE}; {_EXIT}"
)
_FIRM = _Class(
    0.010, 0.43, 0.32, -0.1, f"K = 1 cm is Wong's value for firm sandy ground; {_ANGLES_COMPACT}; {_EXIT}"
)
_WET = _Class(
    0.025,
    0.18,
    0.32,
    -0.1,
    f"K = 2.5 cm (loose soil) because wet, soft soil mobilises its strength slowly; {_ANGLES_LOOSE}; {_EXIT}",
)
_CLAY = _Class(
    0.010,
    0.43,
    0.32,
    -0.1,
    "K = 1 cm is a choice between Wong's 0.6 cm for clay at maximum compaction and 2.5 cm for loose soil; "
    f"{_ANGLES_COMPACT}, the nearest class for firm ground; {_EXIT}",
)
_CLAY_HARD = _Class(
    0.006,
    0.43,
    0.32,
    -0.1,
    f"K = 0.6 cm is Wong's value for clay at maximum compaction; {_ANGLES_COMPACT}, the nearest class; "
    f"{_EXIT}",
)
_SNOW = _Class(
    0.040,
    0.18,
    0.32,
    0.0,
    "K = 4 cm lies in Wong's range 2.5 ... 5 cm for undisturbed fresh snow; "
    f"{_ANGLES_LOOSE}, the nearest class for loose ground; {_NO_EXIT}",
)

_WONG = "J. Y. Wong, Theory of Ground Vehicles (Wiley, 4th ed. 2008), table of terrain values, chapter 2"


def _tabled(
    name: str, title: str, row: tuple[float, float, float, float, float], like: _Class, source: str = _WONG
) -> Entry[Soil]:
    """Entry from a row as the tables print it: n, k_c [kN], k_phi [kN], c [kPa], phi [deg]."""
    n, k_c, k_phi, c, phi = row
    record = make_soil(
        k_c=1e3 * k_c,
        k_phi=1e3 * k_phi,
        n=n,
        c=1e3 * c,
        phi=math.radians(phi),
        k_x=like.K,
        a_0=like.a_0,
        a_1=like.a_1,
        b_0=like.b_0,
    )
    return Entry(name=name, record=record, title=title, source=source, remark=like.remark)


def _soils() -> tuple[Entry[Soil], ...]:
    return (*_sands(), *_loams(), *_clays(), *_snows(), *_space(), *_rig(), *_hard())


def _sands() -> tuple[Entry[Soil], ...]:
    lete = _FIRM._replace(
        K=0.012,
        remark="K = 1.2 cm is the value used with this soil in examples of Project Chrono, which print "
        f"n = 0.793; {_ANGLES_COMPACT}; {_EXIT}",
    )
    return (
        _tabled("dry_sand", "dry sand, Land Locomotion Laboratory", (1.1, 0.99, 1528.43, 1.04, 28.0), _LOOSE),
        _tabled("lete_sand", "LETE sand, Wong's test site", (0.79, 102.0, 5301.0, 1.3, 31.1), lete),
    )


def _loams() -> tuple[Entry[Soil], ...]:
    rubicon = _FIRM._replace(remark="some reprints of the table give phi = 30.2 deg; " + _FIRM.remark)
    return (
        _tabled("sandy_loam", "sandy loam, 15 % moisture, LLL", (0.7, 5.27, 1515.04, 1.72, 29.0), _FIRM),
        _tabled("sandy_loam_wet", "sandy loam, 22 % moisture, LLL", (0.2, 2.56, 43.12, 1.38, 38.0), _WET),
        _tabled(
            "michigan_sandy_loam",
            "sandy loam of Michigan, 11 % moisture (Strong, Buchele)",
            (0.9, 52.53, 1127.97, 4.83, 20.0),
            _FIRM,
        ),
        _tabled(
            "michigan_sandy_loam_wet",
            "sandy loam of Michigan, 23 % moisture (Strong, Buchele)",
            (0.4, 11.42, 808.96, 9.65, 35.0),
            _WET,
        ),
        _tabled(
            "hanamoto_sandy_loam",
            "sandy loam, 26 % moisture (Hanamoto)",
            (0.3, 2.79, 141.11, 13.79, 22.0),
            _WET,
        ),
        _tabled(
            "upland_sandy_loam",
            "upland sandy loam, 51 % moisture, Wong",
            (1.10, 74.6, 2080.0, 3.3, 33.7),
            _FIRM,
        ),
        _tabled(
            "rubicon_sandy_loam",
            "Rubicon sandy loam, 43 % moisture, Wong",
            (0.66, 6.9, 752.0, 3.7, 29.8),
            rubicon,
        ),
        _tabled(
            "north_gower_clayey_loam",
            "North Gower clayey loam, 46 % moisture, Wong",
            (0.73, 41.6, 2471.0, 6.1, 26.6),
            _FIRM,
        ),
        _tabled(
            "grenville_loam", "Grenville loam, 24 % moisture, Wong", (1.01, 0.06, 5880.0, 3.1, 29.8), _FIRM
        ),
    )


def _clays() -> tuple[Entry[Soil], ...]:
    return (
        _tabled("clay", "clayey soil of Thailand, 38 % moisture", (0.5, 13.19, 692.15, 4.14, 13.0), _CLAY),
        _tabled(
            "clay_wet", "clayey soil of Thailand, 55 % moisture", (0.7, 16.03, 1262.53, 2.07, 10.0), _CLAY
        ),
        _tabled(
            "heavy_clay", "heavy clay, 25 % moisture, WES", (0.13, 12.70, 1555.95, 68.95, 34.0), _CLAY_HARD
        ),
        _tabled("heavy_clay_wet", "heavy clay, 40 % moisture, WES", (0.11, 1.84, 103.27, 20.69, 6.0), _CLAY),
        _tabled("lean_clay", "lean clay, 22 % moisture, WES", (0.2, 16.43, 1724.69, 68.95, 20.0), _CLAY_HARD),
        _tabled("lean_clay_wet", "lean clay, 32 % moisture, WES", (0.15, 1.52, 119.61, 13.79, 11.0), _CLAY),
    )


def _snows() -> tuple[Entry[Soil], ...]:
    return (
        _tabled("snow", "snow, USA, first of two sites", (1.6, 4.37, 196.72, 1.03, 19.7), _SNOW),
        _tabled("snow_harrison", "snow, USA, second site (Harrison)", (1.6, 2.49, 245.90, 0.62, 23.2), _SNOW),
        _tabled("snow_sweden", "snow, Sweden", (1.44, 10.55, 66.08, 6.0, 20.7), _SNOW),
    )


def _space() -> tuple[Entry[Soil], ...]:
    regolith = _LOOSE._replace(
        K=0.0178, remark=f"K = 1.78 cm is from the same source; {_ANGLES_LOOSE}, the nearest class; {_EXIT}"
    )
    simulant = make_soil(
        k_c=1.37e3,
        k_phi=8.14e5,
        n=1.0,
        c=0.80e3,
        phi=math.radians(37.2),
        k_x=0.036,
        k_y=0.013,
        a_0=0.40,
        a_1=0.15,
    )
    return (
        _tabled(
            "lunar_regolith",
            "lunar regolith, trafficability values",
            (1.0, 1.4, 820.0, 0.17, 35.0),
            regolith,
            "G. H. Heiken et al. (eds.), Lunar Sourcebook (Cambridge, 1991), section 9.1, trafficability",
        ),
        Entry(
            name="lunar_simulant",
            record=simulant,
            title="lunar soil simulant of the Tohoku rover tests",
            source="G. Ishigami et al., Terramechanics-based model for steering maneuver of planetary "
            "exploration rovers on loose soil, J. Field Robotics 24 (2007)",
            remark="k_x and k_y grow with the slip angle there (0.043 beta + 0.036 m, 0.020 beta + 0.013 m); "
            f"the values of a wheel that runs straight are used; {_EXIT}",
        ),
    )


def _rig() -> tuple[Entry[Soil], ...]:
    record = make_soil(
        k_phi=8e6, n=1.46, c=1.0e3, phi=math.radians(29.0), k_x=0.021, a_0=0.18, a_1=0.32, b_0=-0.1
    )
    return (
        Entry(
            name="cmu_sand",
            record=record,
            title="dry sand of the Carnegie Mellon soil bin",
            source="C. Pavlov, github.com/robomechanics/3d-terramechanics (2022), file set_soil_params.m",
            remark="k = 8e3 kN/m^(n+2), n = 1.46 reproduce the median pressure of the same authors' 18 plate "
            "tests at 10 ... 20 mm within 7 %; single tests fit n = 1.15 ... 1.45 with a smaller k. Plates "
            "do not separate k_c from k_phi here, so k_c = 0; phi is the angle of repose; c and K were tuned "
            f"by hand to wheel tests, so they are not independent of these; {_ANGLES_LOOSE}; {_EXIT}",
        ),
    )


def _hard() -> tuple[Entry[Soil], ...]:
    return (
        Entry(
            name="hard_ground",
            record=make_soil(kind="rigid", mu=0.8, C_alpha=10.0),
            title="hard, dry ground under a pneumatic tyre",
            source="J. Y. Wong, Theory of Ground Vehicles (Wiley, 4th ed. 2008), chapter 1, for the order of "
            "magnitude of dry pavement and of the cornering coefficient of car tyres",
            remark="round values of the class: C_alpha = 10 1/rad is 0.17 of the load per degree; the soil "
            "fields are unused",
        ),
        Entry(
            name="indoor_floor",
            record=make_soil(kind="rigid", mu=1.0489, C_alpha=5.09),
            title="indoor floor under the foam tyres of a 1:10 car",
            source="default parameters of the F1TENTH gym (f1tenth/f1tenth_gym): mu 1.0489, C_Sf 4.718, "
            "C_Sr 5.4562",
            remark="C_alpha is the mean of the front and rear values, which are per unit of axle load; the "
            "soil fields are unused",
        ),
    )


#: Published soils by name; ``SOILS.entry(name)`` gives title, source and remark.
SOILS: Catalogue[Soil] = Catalogue("soil", _soils())
