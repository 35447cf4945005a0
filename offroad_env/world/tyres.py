"""Tyres: the validating factory `make_tyre` and the catalogue `TYRES`."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TypedDict, Unpack

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Structure, Tyre, Wheel
from offroad_env.world.catalogue import Catalogue, Entry, Quantity, given_fields
from offroad_env.world.yaml_text import shown

__all__ = [
    "TYRES",
    "TYRE_RANGES",
    "TyreFields",
    "make_tyre",
    "read_tyre",
    "require_fitting_tyre",
    "with_tyre",
]

#: Pressure that a carcass acts like [Pa]: the stiffness of the Goodyear tyre at four pressures extrapolates
#: to zero at -75 kPa.
_CARCASS_PRESSURE = 75e3
#: Stiffness over sqrt(r b) (p + 75 kPa): 2.85 for the Goodyear tyre, 2.6 to 2.8 for the radial of MAVS, 1.9
#: for the light truck tyre of CRREL; their mean, which errs by a third for the last.
_STIFFNESS_RULE = 2.5
#: Growth of the secant stiffness with deflection: the Goodyear tyre.
_STIFFENING = 0.11
#: Friction of an off-road tread on hard ground, as of hard ground in `make_soil`.
_FRICTION = 0.8
#: Cornering stiffness over the load: 8.9 for the Goodyear tyre, 8.4 for that of the MRZR, 5.9 for that of
#: the HMMWV, at their nominal loads.
_CORNERING = 8.0
#: Loss of effective rolling radius over deflection: R. N. Jazar, Vehicle Dynamics, ch. 3.
_ROLLING = 1.0 / 3.0
#: Largest difference between the size of a tyre and the wheel that it stands on.
_MISFIT = 0.15

_LENGTHS = (3.0000001, 3e3, "mm given as m")
TYRE_RANGES = MappingProxyType(
    {
        "r": Quantity("in [0.02, 3] m", 0.02, 3.0, mistakes=(_LENGTHS,)),
        "b": Quantity("in [0.01, 3] m", 0.01, 3.0, mistakes=(_LENGTHS,)),
        "inflation": Quantity(
            "in [1e3, 1e9] Pa",
            1e3,
            1e9,
            mistakes=((0.05, 12.0, "bar given as Pa"), (12.0, 999.0, "kPa or psi given as Pa")),
        ),
        "k_carcass": Quantity("in [0, 1e7] N/m", 0.0, 1e7),
        "k_per_pressure": Quantity("in [0.01, 20] m", 0.01, 20.0),
        "stiffening": Quantity("in [0, 1]", 0.0, 1.0),
        "mu": Quantity("in [0.05, 2]", 0.05, 2.0),
        "cornering": Quantity("in [0.5, 60] 1/rad", 0.5, 60.0),
        "rolling": Quantity("in [0, 1]", 0.0, 1.0),
    }
)


class TyreFields(TypedDict, total=False):
    """Fields of a tyre as `make_tyre` takes them; their meaning stands there."""

    r: float | None
    b: float | None
    inflation: float | None
    k_carcass: float | None
    k_per_pressure: float | None
    stiffening: float | None
    mu: float | None
    cornering: float | None
    rolling: float | None


def make_tyre(base: str | Tyre | None = None, **fields: Unpack[TyreFields]) -> Tyre:
    """Make a validated tyre, from its size and pressure or from another tyre.

    Parameters
    ----------
    base
        Name in `TYRES`, or a tyre, with the values of all fields that are not given: most often
        ``make_tyre("mrzr", inflation=120e3)``. Without it ``r, b, inflation`` are needed.
    r, b
        Radius and width that the stiffness belongs to [m].
    inflation
        Inflation pressure above the atmosphere [Pa].
    k_carcass, k_per_pressure
        Vertical stiffness at a deflection of 0.08 r: k_carcass + k_per_pressure inflation [N/m]; default
        2.5 sqrt(r b) (75 kPa + inflation), the mean of three measured tyres, right within a third.
    stiffening
        Growth exponent of the secant stiffness with deflection [-]; default 0.11.
    mu
        Friction coefficient of the tread [-]; default 0.8.
    cornering
        Cornering stiffness on hard ground over the load [1/rad]; default 8.
    rolling
        Loss of effective rolling radius over deflection [-]; default 1/3.

    Returns
    -------
    Tyre

    Raises
    ------
    InvalidParameter
        With name, value, allowed range and likely mistake.
    TypeError
        For a field that a tyre does not have.

    Examples
    --------
    >>> tyre = make_tyre("goodyear_335_65r22_5", inflation=270e3)
    >>> round(tyre.r, 4), tyre.inflation
    (0.4987, 270000.0)
    """
    given = given_fields("make_tyre", fields, TYRE_RANGES)  # type: ignore[arg-type]  # a TypedDict of floats
    if base is None:
        missing = [name for name in ("r", "b", "inflation") if name not in given]
        if missing:
            raise InvalidParameter(
                f"a tyre needs {', '.join(missing)} - name a base, as in make_tyre('mrzr', inflation=120e3)"
            )
        values = _defaults(given["r"], given["b"]) | given
    elif isinstance(base, str | Tyre):
        values = (TYRES[base] if isinstance(base, str) else base)._asdict() | given
    else:
        raise InvalidParameter(f"base must be a name in TYRES or a Tyre, got {shown(base)}")
    return Tyre(**{name: quantity.check(name, values[name]) for name, quantity in TYRE_RANGES.items()})


def _defaults(r: float, b: float) -> dict[str, float]:
    """Values of a tyre of this size where none are published."""
    slope = _STIFFNESS_RULE * math.sqrt(max(r * b, 0.0))
    return {
        "k_carcass": slope * _CARCASS_PRESSURE,
        "k_per_pressure": slope,
        "stiffening": _STIFFENING,
        "mu": _FRICTION,
        "cornering": _CORNERING,
        "rolling": _ROLLING,
    }


def read_tyre(tyre: str | Tyre | None) -> Tyre | None:
    """A tyre by its name in `TYRES`, or itself; None stays None: a rigid wheel.

    Raises
    ------
    UnknownNameError
        For a name that the catalogue does not have.
    """
    if tyre is None or isinstance(tyre, Tyre):
        return tyre
    if isinstance(tyre, str):
        return TYRES[tyre]
    raise InvalidParameter(f"tyre must be a name in TYRES or a Tyre, got {shown(tyre)}")


def with_tyre(structure: Structure | None, tyre: Tyre) -> Structure:
    """The structure for wheels with this tyre.

    Raises
    ------
    InvalidParameter
        Where the structure has no room for a tyre, by the name of the choice that excludes it.
    """
    if structure is None:
        raise InvalidParameter(
            'a tyre needs a structure whose pressure acts along the ground: structure="grid" or "field"; a '
            "rim with Wong-Reece contact angles is rigid"
        )
    if structure.ground_normal < 0.5:
        raise InvalidParameter(
            'a tyre needs pressure_direction="ground_normal": its belt is no rim that soil presses along '
            "its normal"
        )
    if structure.own_sinkage < 0.5:
        raise InvalidParameter(
            'a tyre needs pressure_from="own_sinkage": Wong-Reece contact angles are those of a rigid rim'
        )
    if structure.grouser_height > 0.0:
        raise InvalidParameter(
            f"grousers of {structure.grouser_height:g} m stand on rigid rims; a tyre has none: leave one out"
        )
    return structure._replace(tyre=tyre)


def require_fitting_tyre(tyre: Tyre, wheel: Wheel) -> None:
    """Refuse a tyre on a wheel of another size, whose stiffness it does not have.

    Raises
    ------
    InvalidParameter
        Where radius or width differ by more than 15 %.
    """
    for name, own, other in (("radius", tyre.r, wheel.r), ("width", tyre.b, wheel.b)):
        if abs(own / other - 1.0) > _MISFIT:
            raise InvalidParameter(
                f"the tyre's {name} must be within 15 % of the wheel's {other:g} m, got {own:g} m "
                "- a tyre of another vehicle? make_tyre(r=..., b=..., inflation=...) scales the stiffness"
            )


def _measured() -> list[Entry[Tyre]]:
    goodyear = make_tyre(
        r=0.4987,
        b=0.335,
        inflation=414e3,
        k_carcass=0.822e5,
        k_per_pressure=1.097,
        stiffening=0.112,
        mu=0.83,
        cornering=8.9,
    )
    mavs = make_tyre(r=0.565, b=0.309, inflation=600e3, k_carcass=1.5e5, k_per_pressure=1.0, stiffening=0.0)
    crrel = make_tyre(r=0.370, b=0.264, inflation=179e3, k_carcass=5.7e4, k_per_pressure=0.51)
    return [
        Entry(
            name="goodyear_335_65r22_5",
            record=goodyear,
            title="Goodyear G275 MSA 335/65R22.5, truck tyre, 270 to 650 kPa",
            source="Project Chrono, data/vehicle/feda/tires/335_65R22_5_G275MSA_{40,60,70,95}psi.tir "
            "(Calspan, 2010): load-deflection curves, stiffness at four pressures, Magic Formula",
            remark="Three numbers of stiffness, chosen to make the largest relative error over all points of "
            "the curves and the four printed stiffnesses as small as it gets (8.6 %; two curves at the same "
            "pressure are 7 % apart). Friction: mean of PDX1 and PDY1; cornering stiffness over load at the "
            "nominal load from PKY1, PKY2.",
        ),
        Entry(
            name="mavs_radial",
            record=mavs,
            title="Radial truck tyre of MAVS, 400 to 800 kPa",
            source="Mississippi State University, MAVS, docs/Vehicles/mavs_radial_tire.md: spring constant = "
            "pressure + 150 kPa, fitted to the load-deflection plot of Ragheb et al. (2013)",
            remark="The unit of the constant is printed as Pa and read as N/m. Friction, "
            "cornering stiffness and rolling radius are defaults of `make_tyre`.",
        ),
        Entry(
            name="crrel_light_truck",
            record=crrel,
            title="Light truck tyre of CRREL's instrumented vehicle, 103 to 179 kPa",
            source="P. Richmond, CRREL Report 95-7 (1995): dimensions at two pressures and two loads",
            remark="Column headings of the table were not seen: the first dimension is read as loaded, "
            "the second as free radius. Stiffness is the straight line through the mean of each pressure; "
            "the rest are defaults of `make_tyre`.",
        ),
    ]


def _of_vehicles() -> list[Entry[Tyre]]:
    mrzr = make_tyre(
        r=0.330, b=0.212, inflation=150e3, k_carcass=5.74e4, k_per_pressure=0.7655, cornering=8.4
    )
    hmmwv = make_tyre(
        r=0.470, b=0.3175, inflation=240e3, k_carcass=9.79e4, k_per_pressure=1.305, cornering=5.9
    )
    robot = make_tyre(r=0.165, b=0.165, inflation=100e3)
    return [
        Entry(
            name="mrzr",
            record=mrzr,
            title="Tyre of the Polaris MRZR class, 100 to 200 kPa",
            source="Project Chrono, data/vehicle/Polaris/Polaris_TMeasyTire.json: vertical stiffness "
            "172 kN/m, cornering stiffness 25.1 kN/rad at 3 kN",
            remark="The pressure behind the stiffness is not printed: 150 kPa is assumed. It is split "
            "between carcass and inflation as for the Goodyear tyre, whose carcass acts like 75 kPa.",
        ),
        Entry(
            name="hmmwv",
            record=hmmwv,
            title="Tyre of the HMMWV, 37x12.5R16.5, 140 to 350 kPa",
            source="Project Chrono, data/vehicle/hmmwv/tire/HMMWV_TMeasyTire.json: vertical stiffness "
            "411 kN/m, cornering stiffness 50.9 kN/rad at 8.56 kN",
            remark="The pressure behind the stiffness is not printed: 240 kPa is assumed. Split between "
            "carcass and inflation as for the tyre of the MRZR. A stiff tyre for its size: "
            "1.3 times the rule of `make_tyre`.",
        ),
        Entry(
            name="robot_13x6_5_6",
            record=robot,
            title="Pneumatic tyre of a skid-steer robot, 13x6.5-6, 50 to 150 kPa",
            source="Size code: 13 in diameter, 6.5 in width",
            remark="No measurement: stiffness and the rest are the defaults of `make_tyre`.",
        ),
    ]


def _agricultural() -> list[Entry[Tyre]]:
    """Tyres of the soil bin of Cranfield, whose ruts are published."""
    sizes = (
        ("500_70r24", "500/70 R24, radial", 0.6548, 0.50, 230e3),
        ("500_85r24", "500/85 R24, radial", 0.7298, 0.50, 140e3),
        ("600_55_26_5", "600/55-26.5, cross-ply", 0.6666, 0.60, 140e3),
        ("710_45_26_5", "710/45-26.5", 0.6561, 0.71, 100e3),
    )
    return [
        Entry(
            name=name,
            record=make_tyre(r=r, b=b, inflation=inflation),
            title=f"{title}, combine harvester, {inflation / 1e3:.0f} kPa at 4.5 t",
            source="D. Ansorge, PhD thesis, Cranfield University (2007): size and pressure",
            remark="Radius and width from the size code. No load-deflection was published: stiffness and the "
            "rest are the defaults of `make_tyre`.",
        )
        for name, title, r, b, inflation in sizes
    ]


#: Tyres by name; ``TYRES.entry(name)`` gives title, source and remark.
TYRES: Catalogue[Tyre] = Catalogue("tyre", [*_measured(), *_of_vehicles(), *_agricultural()])
