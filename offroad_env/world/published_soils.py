"""Soils of the literature: rows of published tables, with class values for what they do not print."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics.records import Soil
from offroad_env.world.catalogue import Entry
from offroad_env.world.soil_fields import checked_soil

__all__ = ["published_soils"]


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


class _Printed(NamedTuple):
    """A row of a table of Bekker parameters in the units of print."""

    n: float  #: [-]
    k_c: float  #: [kN/m^(n+1)]
    k_phi: float  #: [kN/m^(n+2)]
    c: float  #: [kPa]
    phi: float  #: [deg]


def _tabled(
    name: str, title: str, row: tuple[float, float, float, float, float], like: _Class, source: str = _WONG
) -> Entry[Soil]:
    """Entry from a row of a table (`_Printed`), with the class values for all other fields."""
    printed = _Printed(*row)
    record = checked_soil(
        k_c=1e3 * printed.k_c,
        k_phi=1e3 * printed.k_phi,
        n=printed.n,
        c=1e3 * printed.c,
        phi=math.radians(printed.phi),
        k_x=like.K,
        a_0=like.a_0,
        a_1=like.a_1,
        b_0=like.b_0,
    )
    return Entry(name=name, record=record, title=title, source=source, remark=like.remark)


def published_soils() -> tuple[Entry[Soil], ...]:
    """All entries, in the order of the catalogue."""
    return (*_sands(), *_loams(), *_clays(), *_snows(), *_space(), *_rig(), *_hard())


def _sands() -> tuple[Entry[Soil], ...]:
    lete = _FIRM._replace(
        K=0.012,
        remark="K = 1.2 cm is the value used with this soil in examples of Project Chrono, which print "
        f"n = 0.793; {_ANGLES_COMPACT}; {_EXIT}",
    )
    return (
        _tabled(
            "dry_sand",
            "dry sand, Land Locomotion Laboratory",
            (1.1, 0.99, 1528.43, 1.04, 28.0),
            _LOOSE,
        ),
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
            "grenville_loam",
            "Grenville loam, 24 % moisture, Wong",
            (1.01, 0.06, 5880.0, 3.1, 29.8),
            _FIRM,
        ),
    )


def _clays() -> tuple[Entry[Soil], ...]:
    return (
        _tabled("clay", "clayey soil of Thailand, 38 % moisture", (0.5, 13.19, 692.15, 4.14, 13.0), _CLAY),
        _tabled(
            "clay_wet",
            "clayey soil of Thailand, 55 % moisture",
            (0.7, 16.03, 1262.53, 2.07, 10.0),
            _CLAY,
        ),
        _tabled(
            "heavy_clay",
            "heavy clay, 25 % moisture, WES",
            (0.13, 12.70, 1555.95, 68.95, 34.0),
            _CLAY_HARD,
        ),
        _tabled(
            "heavy_clay_wet",
            "heavy clay, 40 % moisture, WES",
            (0.11, 1.84, 103.27, 20.69, 6.0),
            _CLAY,
        ),
        _tabled(
            "lean_clay",
            "lean clay, 22 % moisture, WES",
            (0.2, 16.43, 1724.69, 68.95, 20.0),
            _CLAY_HARD,
        ),
        _tabled("lean_clay_wet", "lean clay, 32 % moisture, WES", (0.15, 1.52, 119.61, 13.79, 11.0), _CLAY),
    )


def _snows() -> tuple[Entry[Soil], ...]:
    return (
        _tabled("snow", "snow, USA, first of two sites", (1.6, 4.37, 196.72, 1.03, 19.7), _SNOW),
        _tabled(
            "snow_harrison",
            "snow, USA, second site (Harrison)",
            (1.6, 2.49, 245.90, 0.62, 23.2),
            _SNOW,
        ),
        _tabled("snow_sweden", "snow, Sweden", (1.44, 10.55, 66.08, 6.0, 20.7), _SNOW),
    )


def _space() -> tuple[Entry[Soil], ...]:
    regolith = _LOOSE._replace(
        K=0.0178, remark=f"K = 1.78 cm is from the same source; {_ANGLES_LOOSE}, the nearest class; {_EXIT}"
    )
    simulant = checked_soil(
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
    record = checked_soil(
        k_phi=8e6,
        n=1.46,
        c=1.0e3,
        phi=math.radians(29.0),
        k_x=0.021,
        a_0=0.18,
        a_1=0.32,
        b_0=-0.1,
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
            record=checked_soil(kind="rigid", mu=0.8, C_alpha=10.0),
            title="hard, dry ground under a pneumatic tyre",
            source="J. Y. Wong, Theory of Ground Vehicles (Wiley, 4th ed. 2008), chapter 1, for the order of "
            "magnitude of dry pavement and of the cornering coefficient of car tyres",
            remark="round values of the class: C_alpha = 10 1/rad is 0.17 of the load per degree; the soil "
            "fields are unused",
        ),
        Entry(
            name="indoor_floor",
            record=checked_soil(kind="rigid", mu=1.0489, C_alpha=5.09),
            title="indoor floor under the foam tyres of a 1:10 car",
            source="default parameters of the F1TENTH gym (f1tenth/f1tenth_gym): mu 1.0489, C_Sf 4.718, "
            "C_Sr 5.4562",
            remark="C_alpha is the mean of the front and rear values, which are per unit of axle load; the "
            "soil fields are unused",
        ),
    )
