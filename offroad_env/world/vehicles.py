"""Vehicles: the validating factories `make_vehicle` and `make_wheel`, and the catalogue `VEHICLES`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, TypedDict, Unpack, cast

from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Vehicle, Wheel
from offroad_env.world.catalogue import Catalogue, Entry, Quantity, given_fields
from offroad_env.world.yaml_text import shown

__all__ = ["VEHICLES", "VEHICLE_RANGES", "VehicleFields", "make_vehicle", "make_wheel", "static_loads"]

_MILLIMETRES = "mm given as m"
_DEGREES = "degrees"


def _positive(unit: str, low: float, high: float, *mistakes: tuple[float, float, str]) -> Quantity:
    return Quantity(f"in [{low:g}, {high:g}] {unit}", low, high, mistakes=mistakes)


_STIFFNESS = _positive("N/m per axle", 10.0, 1e8)
_DAMPING = _positive("N s/m per axle", 0.0, 1e7)
_LEVER = _positive("m", 0.01, 10.0, (10.0000001, 2e4, _MILLIMETRES))
_RADIUS = _positive("m", 0.005, 3.0, (3.0000001, 3e3, _MILLIMETRES))
_WIDTH = _positive("m", 0.002, 3.0, (3.0000001, 3e3, _MILLIMETRES))
_SHARE = Quantity("in [0, 1]", 0.0, 1.0, mistakes=((1.0000001, 100.0, "per cent"),))
_LAG = _positive("s", 0.0, 2.0, (2.0000001, 2e3, "ms given as s"))

#: Allowed range of every field: from a 1:10 car to a heavy truck.
VEHICLE_RANGES = MappingProxyType(
    {
        "m": _positive("kg", 0.1, 1e5),
        "I_z": _positive("kg m^2", 1e-5, 1e7),
        "I_y": _positive("kg m^2", 1e-5, 1e7),
        "l_f": _LEVER,
        "l_r": _LEVER,
        "k_f": _STIFFNESS,
        "k_r": _STIFFNESS,
        "c_f": _DAMPING,
        "c_r": _DAMPING,
        "m_w": _positive("kg per axle", 1e-4, 2e4),
        "r": _RADIUS,
        "b": _WIDTH,
        "wheels_per_axle": _positive("wheels", 1.0, 2.0),
        "I_w": _positive("kg m^2", 1e-7, 1e4),
        "h_cg": _LEVER,
        "track": _LEVER,
        "drag_area": _positive("m^2", 0.0, 30.0),
        "rolling_resistance": Quantity("in [0, 0.5]", 0.0, 0.5, mistakes=((0.5000001, 50.0, "per cent"),)),
        "steer_max": Quantity(
            "in (0, pi/2) rad",
            0.0,
            0.5 * math.pi,
            low_open=True,
            high_open=True,
            mistakes=((1.5707, 90.0, _DEGREES),),
        ),
        "steer_rate": Quantity(
            "in (0, 20] rad/s", 0.0, 20.0, low_open=True, mistakes=((20.0, 2e3, "degrees/s"),)
        ),
        "steer_lag": _LAG,
        "drive_torque_max": _positive("N m, all wheels together", 0.0, 1e6),
        "brake_torque_max": _positive("N m, all wheels together", 0.0, 1e6),
        "power_max": _positive("W", 0.0, 1e7),
        "torque_lag": _LAG,
        "drive_front": _SHARE,
        "brake_front": _SHARE,
    }
)


class _Ratio(NamedTuple):
    """A combination of fields whose size is known for every vehicle: shows a wrong power of ten."""

    name: str
    low: float
    high: float
    unit: str
    fields: tuple[str, ...]


_RATIOS = MappingProxyType(
    {
        "split": _Ratio("front share of the static load l_r/(l_f + l_r)", 0.1, 0.9, "", ("l_f", "l_r")),
        "yaw": _Ratio(
            "radius of gyration in yaw over the wheelbase", 0.15, 1.0, "", ("I_z", "m", "l_f", "l_r")
        ),
        "pitch": _Ratio(
            "radius of gyration in pitch over the wheelbase", 0.15, 1.0, "", ("I_y", "m", "l_f", "l_r")
        ),
        "bounce": _Ratio("bounce frequency sqrt((k_f + k_r)/m)/(2 pi)", 0.3, 30.0, "Hz", ("k_f", "k_r", "m")),
        "damping": _Ratio("damping ratio of bounce", 0.0, 5.0, "", ("c_f", "c_r", "k_f", "k_r", "m")),
        # Springs and dampers are integrated explicitly: faster decay than this is no longer stable.
        "decay": _Ratio("damping rate (c_f + c_r)/m", 0.0, 300.0, "1/s", ("c_f", "c_r", "m")),
        "unsprung": _Ratio("unsprung share 2 m_w/m of the mass", 0.0, 0.6, "", ("m_w", "m")),
        "wheel": _Ratio("wheel radius over the wheelbase", 0.03, 0.5, "", ("r", "l_f", "l_r")),
        "spin": _Ratio("radius of gyration of a wheel over its radius", 0.05, 5.0, "", ("I_w", "m_w", "r")),
        "width": _Ratio("wheel width over the track", 0.0, 0.8, "", ("b", "track")),
        "height": _Ratio("CG height over the wheelbase", 0.05, 1.2, "", ("h_cg", "l_f", "l_r")),
        "drive": _Ratio("largest drive force over the weight", 0.0, 10.0, "", ("drive_torque_max", "r", "m")),
        "brake": _Ratio("largest brake force over the weight", 0.0, 10.0, "", ("brake_torque_max", "r", "m")),
        "power": _Ratio("drive power per mass", 0.0, 2000.0, "W/kg", ("power_max", "m")),
    }
)


def make_wheel(*, r: float, b: float) -> Wheel:
    """Make a validated rigid wheel.

    Parameters
    ----------
    r
        Radius [m].
    b
        Width [m].

    Returns
    -------
    Wheel

    Raises
    ------
    InvalidParameter
        With name, value, allowed range and likely mistake.
    """
    return Wheel(r=_RADIUS.check("r", r), b=_WIDTH.check("b", b))


class VehicleFields(TypedDict, total=False):
    """Fields of a vehicle as `make_vehicle` takes them; their meaning stands there."""

    m: float | None
    I_z: float | None
    I_y: float | None
    l_f: float | None
    l_r: float | None
    k_f: float | None
    k_r: float | None
    c_f: float | None
    c_r: float | None
    m_w: float | None
    r: float | None
    b: float | None
    wheels_per_axle: float | None
    I_w: float | None
    h_cg: float | None
    track: float | None
    drag_area: float | None
    rolling_resistance: float | None
    steer_max: float | None
    steer_rate: float | None
    steer_lag: float | None
    drive_torque_max: float | None
    brake_torque_max: float | None
    power_max: float | None
    torque_lag: float | None
    drive_front: float | None
    brake_front: float | None


def make_vehicle(base: str | Vehicle | None = None, **fields: Unpack[VehicleFields]) -> Vehicle:
    """Make a validated vehicle, from scratch or from another one.

    Parameters
    ----------
    base
        Name in `VEHICLES`, or a vehicle, with the values of all fields that are not given.
        Without it every field is needed.
    m
        Total mass [kg].
    I_z, I_y
        Moments of inertia of the whole vehicle in yaw and pitch [kg m^2].
    l_f, l_r
        CG to front and rear axle [m].
    k_f, k_r, c_f, c_r
        Suspension stiffness [N/m] and damping [N s/m], per axle.
    m_w
        Unsprung mass, per axle [kg].
    r, b
        Wheel radius and width [m].
    wheels_per_axle, I_w
        1 or 2; spin inertia of one wheel with its driveline share [kg m^2].
    h_cg, track
        Height of the CG and distance between left and right wheels [m].
    drag_area, rolling_resistance
        Aerodynamic drag area C_d A [m^2]; rolling resistance as a fraction of the load [-].
    steer_max, steer_rate, steer_lag
        Largest road-wheel angle [rad], its largest rate [rad/s], time constant [s].
    drive_torque_max, brake_torque_max
        Largest torque of all wheels together [N m].
    power_max, torque_lag
        Largest drive power at the wheels [W]; time constant of drive and brake torque [s].
    drive_front, brake_front
        Front share of drive and brake torque, 0 ... 1 [-].

    Returns
    -------
    Vehicle
        Record of floats that the kernels trust.

    Raises
    ------
    InvalidParameter
        With name, value, allowed range and likely mistake; also where fields that are allowed one
        by one do not belong to one vehicle (a bounce frequency of 100 Hz, for example).
    TypeError
        For a field that a vehicle does not have.

    Examples
    --------
    >>> loaded = make_vehicle("mrzr", m=1500.0)
    >>> loaded.m, loaded.l_f
    (1500.0, 1.537)
    """
    given = given_fields("make_vehicle", cast("Mapping[str, float | None]", fields), VEHICLE_RANGES)
    values = _base_values(base) | given
    _check_complete(values)
    vehicle = Vehicle(**{name: VEHICLE_RANGES[name].check(name, value) for name, value in values.items()})
    _check_together(vehicle)
    return vehicle


def _check_complete(values: Mapping[str, float]) -> None:
    missing = [name for name in VEHICLE_RANGES if name not in values]
    if missing:
        raise InvalidParameter(
            f"a vehicle without a base needs every field; missing: {', '.join(missing)} "
            "- name a base, as in make_vehicle('mrzr', m=1500.0)"
        )


def static_loads(vehicle: Vehicle) -> tuple[float, float]:
    """Static axle loads (front, rear) [N] on level ground: m g l_r/L and m g l_f/L.

    The paper writes m g/2 for both, which is this split for l_f = l_r.
    """
    per_length = vehicle.m * GRAVITY / (vehicle.l_f + vehicle.l_r)
    return per_length * vehicle.l_r, per_length * vehicle.l_f


def _base_values(base: str | Vehicle | None) -> dict[str, float]:
    if base is None:
        return {}
    if isinstance(base, Vehicle):
        return base._asdict()
    if isinstance(base, str):
        return VEHICLES[base]._asdict()
    raise InvalidParameter(f"base must be a name in VEHICLES or a Vehicle, got {shown(base)}")


def _ratios(v: Vehicle) -> dict[str, float]:
    wheelbase = v.l_f + v.l_r
    stiffness = v.k_f + v.k_r
    return {
        "split": v.l_r / wheelbase,
        "yaw": math.sqrt(v.I_z / v.m) / wheelbase,
        "pitch": math.sqrt(v.I_y / v.m) / wheelbase,
        "bounce": math.sqrt(stiffness / v.m) / (2.0 * math.pi),
        "damping": 0.5 * (v.c_f + v.c_r) / math.sqrt(stiffness * v.m),
        "decay": (v.c_f + v.c_r) / v.m,
        "unsprung": 2.0 * v.m_w / v.m,
        "wheel": v.r / wheelbase,
        "spin": math.sqrt(v.I_w * v.wheels_per_axle / v.m_w) / v.r,
        "width": v.b / v.track,
        "height": v.h_cg / wheelbase,
        "drive": v.drive_torque_max / (v.r * v.m * GRAVITY),
        "brake": v.brake_torque_max / (v.r * v.m * GRAVITY),
        "power": v.power_max / v.m,
    }


def _check_together(vehicle: Vehicle) -> None:
    if vehicle.wheels_per_axle not in (1.0, 2.0):
        raise InvalidParameter(f"wheels_per_axle must be 1 or 2, got {vehicle.wheels_per_axle:g}")
    for key, value in _ratios(vehicle).items():
        rule = _RATIOS[key]
        if not rule.low <= value <= rule.high:
            fields = ", ".join(f"{name}={getattr(vehicle, name):g}" for name in rule.fields)
            unit = f" {rule.unit}" if rule.unit else ""
            raise InvalidParameter(
                f"{rule.name} must be in [{rule.low:g}, {rule.high:g}]{unit}, got {value:.3g} from {fields} "
                "- a wrong unit or power of ten in one of them?"
            )


def _mrzr() -> Entry[Vehicle]:
    record = make_vehicle(
        m=1378.3,
        I_z=1787.0,
        I_y=1395.0,
        l_f=1.537,
        l_r=1.183,
        k_f=28.0e3,
        k_r=88.3e3,
        c_f=14.3e3,
        c_r=5.7e3,
        m_w=127.25,  # half of total less sprung mass, 1378.3 - 1123.8 kg
        r=0.330,
        b=0.212,
        wheels_per_axle=2,
        I_w=1.86,
        h_cg=0.638,
        track=1.22,  # mean of 1.21 m front, 1.23 m rear
        drag_area=1.8,
        rolling_resistance=0.015,
        steer_max=0.55,
        steer_rate=1.0,
        steer_lag=0.10,
        drive_torque_max=3600.0,
        brake_torque_max=5000.0,
        power_max=35e3,
        torque_lag=0.20,
        drive_front=0.5,
        brake_front=0.6,
    )
    return Entry(
        name="mrzr",
        record=record,
        title="Polaris MRZR class, four seats, with crew and load",
        source="2013 Polaris MRZR model published with Project Chrono (data/vehicle/Polaris; measurements "
        "by SEA Ltd., July 2016): masses, CG, inertias, wheels; wheel rates and damping linearised at "
        "ride height",
        remark="Unsprung mass: total less sprung mass, half to each axle (the wheels with tyres alone are "
        "68 kg an axle). The suspension is strongly non-linear in truth; these are its slopes at the "
        "static load. Not in the source, chosen for the class: drag area 1.8 m^2 (1.51 m x 1.87 m "
        "outline, open body, C_d about 0.65); rolling resistance 0.015 (off-road tyre on hard ground, "
        "soil not included); steering 0.55 rad, 1 rad/s, 0.1 s (a hand wheel turned fast); drive torque "
        "3.6 kN m (0.8 of the weight at the wheels, in low range), 35 kW at the wheels (a litre-size "
        "diesel of about 45 kW through a belt transmission), equal on both axles (locked all-wheel "
        "drive); brakes 5 kN m (all wheels lock below a friction of 1.1), 0.6 front (for load transfer); "
        "torque lag 0.2 s.",
    )


def _paper() -> Entry[Vehicle]:
    record = make_vehicle(
        m=1000.0,  # empty two-seat D2 about 860 kg, and a crew
        I_z=800.0,  # radius of gyration 0.43 of the wheelbase (`mrzr` 0.42)
        I_y=700.0,  # radius of gyration 0.40 of the wheelbase (`mrzr` 0.37)
        l_f=1.05,  # two-seat wheelbase 2.1 m, CG in the middle: the paper's m g/2 an axle
        l_r=1.05,  # as l_f
        k_f=45e3,  # 1.5 Hz bounce (`mrzr` 1.5 Hz), 0.11 m static deflection
        k_r=45e3,  # as k_f
        c_f=5e3,  # damping ratio 0.53 of bounce (`mrzr` 0.79)
        c_r=5e3,  # as c_f
        m_w=80.0,  # two wheels with tyres 68 kg, and arms
        r=0.33,  # `mrzr`
        b=0.21,  # `mrzr`, rounded
        wheels_per_axle=2,  # the paper leaves it open; a car has two
        I_w=1.9,  # `mrzr`, rounded; from here on not in the paper's model
        h_cg=0.60,  # a little under the loaded `mrzr`
        track=1.22,  # `mrzr`
        drag_area=1.8,  # `mrzr`
        rolling_resistance=0.015,  # `mrzr`
        steer_max=0.55,  # `mrzr`; the paper steers up to 0.5 rad
        steer_rate=1.0,  # `mrzr`
        steer_lag=0.10,  # `mrzr`
        drive_torque_max=2600.0,  # 0.8 of the weight, as `mrzr`
        brake_torque_max=3600.0,  # 1.1 of the weight, as `mrzr`
        power_max=35e3,  # `mrzr`
        torque_lag=0.20,  # `mrzr`
        drive_front=0.5,  # `mrzr`
        brake_front=0.6,  # `mrzr`
    )
    return Entry(
        name="paper",
        record=record,
        title="round numbers of the MRZR D2 class, for the paper's model",
        source="Buzhardt & Tallapragada, ACC 2021 (arXiv 2202.04727) say only that the vehicle represents a"
        " Polaris MRZR D2 and print no number: every value here is a choice",
        remark="The reason for every number stands beside it in `_paper` (offroad_env/world/vehicles.py): "
        "the two-seat D2's mass and wheelbase (0.65 m shorter than the four-seat 2.72 m), bounce frequency "
        "and radii of gyration of `mrzr`, and the CG in the middle, as the paper's m g/2 on each axle "
        "implies.",
    )


def _f1tenth() -> Entry[Vehicle]:
    record = make_vehicle(
        m=3.74,
        I_z=0.04712,
        I_y=0.04712,
        l_f=0.15875,
        l_r=0.17145,
        k_f=1200.0,
        k_r=1200.0,
        c_f=40.0,
        c_r=40.0,
        m_w=0.30,
        r=0.05,
        b=0.045,
        wheels_per_axle=2,
        I_w=3e-4,
        h_cg=0.074,
        track=0.265,
        drag_area=0.03,
        rolling_resistance=0.02,
        steer_max=0.4189,
        steer_rate=3.2,
        steer_lag=0.05,
        drive_torque_max=1.78,
        brake_torque_max=1.78,
        power_max=260.0,
        torque_lag=0.05,
        drive_front=0.5,
        brake_front=0.5,
    )
    return Entry(
        name="f1tenth",
        record=record,
        title="1:10 car of the F1TENTH class",
        source="default parameters of the F1TENTH gym (f1tenth/f1tenth_gym): m, I_z, l_f, l_r, h, steering "
        "limits",
        remark="Torque 1.78 N m is the simulator's 9.51 m/s^2 times mass and wheel radius; 260 W keeps that"
        " up to its switching speed 7.3 m/s; track 0.265 m is its width 0.31 m less a tyre. Not "
        "published, of the class: wheel 0.05 m x 0.045 m and its 0.15 kg, I_y = I_z (flat, long body), "
        "springs for 4 Hz bounce and damping ratio 0.4 (radio-controlled touring cars), lags of a hobby "
        "servo and motor, drag area 0.03 m^2.",
    )


def _hmmwv() -> Entry[Vehicle]:
    record = make_vehicle(
        m=2568.0,
        I_z=5280.0,
        I_y=4270.0,
        l_f=1.60,
        l_r=1.70,
        k_f=81e3,
        k_r=179e3,
        c_f=8.5e3,
        c_r=12.0e3,
        m_w=211.0,
        r=0.467,
        b=0.254,
        wheels_per_axle=2,
        I_w=7.4,
        h_cg=0.70,
        track=1.82,
        drag_area=2.9,
        rolling_resistance=0.015,
        steer_max=0.50,
        steer_rate=0.8,
        steer_lag=0.10,
        drive_torque_max=11e3,
        brake_torque_max=13e3,
        power_max=100e3,
        torque_lag=0.25,
        drive_front=0.5,
        brake_front=0.6,
    )
    return Entry(
        name="hmmwv",
        record=record,
        title="HMMWV class light truck",
        source="HMMWV model of Project Chrono (src/chrono_models/vehicle/hmmwv): body 2086.5 kg with "
        "inertia (1079, 2956, 3570) kg m^2, 63.9 kg of arms and spindle and 56.4 kg of wheel and tyre a "
        "corner, tyre 0.467 m x 0.254 m, axles at 1.649 m and -1.653 m, spindles 1.82 m apart",
        remark="Derived: m is body and four corners; inertias add the corners at their distance from the "
        "CG; CG 0.05 m before the middle; wheel rates are the springs (167 and 369 kN/m) times the square"
        " of the arm ratio 0.49, damping the mean of both directions times the same, two wheels an axle; "
        "m_w takes half of the arms; I_w is tyre, rim and spindle. Chosen for the class: CG height 0.70 "
        "m, drag area 2.9 m^2, steering, drive 0.95 and brakes 1.1 of the weight, 100 kW at the wheels, "
        "lags.",
    )


#: Vehicles by name; ``VEHICLES.entry(name)`` gives title, source and remark.
VEHICLES: Catalogue[Vehicle] = Catalogue("vehicle", (_mrzr(), _paper(), _f1tenth(), _hmmwv()))
