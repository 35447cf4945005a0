"""Vehicles with four wheels by name: the vehicle and what it has beyond a `Vehicle`, with sources."""

from __future__ import annotations

from typing import NamedTuple

from offroad_env.physics.records import FourWheel, Vehicle
from offroad_env.world.catalogue import Catalogue, Entry
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.vehicles import VEHICLES, make_vehicle

__all__ = ["FOUR_WHEEL_VEHICLES", "FourWheelVehicle"]


class FourWheelVehicle(NamedTuple):
    """What `make_plant` takes for ``vehicle_model="four_wheel"``."""

    vehicle: Vehicle
    four_wheel: FourWheel


def _mrzr() -> Entry[FourWheelVehicle]:
    vehicle = VEHICLES["mrzr"]
    return Entry(
        name="mrzr",
        record=FourWheelVehicle(vehicle, make_four_wheel(vehicle, track_f=1.21, track_r=1.23)),
        title="Polaris MRZR class, Ackermann steering, open differentials",
        source="tracks: 2013 Polaris MRZR model published with Project Chrono (data/vehicle/Polaris)",
        remark="Everything else by the rules of `make_four_wheel`: roll inertia from mass and track, roll "
        "stiffness of the wheels' springs, roll centres on the ground, no toe, no anti-roll bar.",
    )


def _hmmwv() -> Entry[FourWheelVehicle]:
    vehicle = VEHICLES["hmmwv"]
    return Entry(
        name="hmmwv",
        record=FourWheelVehicle(vehicle, make_four_wheel(vehicle, I_x=1477.0)),
        title="HMMWV class light truck, Ackermann steering, open differentials",
        source="HMMWV model of Project Chrono (src/chrono_models/vehicle/hmmwv): roll inertia of the body "
        "1079 kg m^2, and 120.3 kg at each corner, 0.91 m beside the middle",
        remark="Everything else by the rules of `make_four_wheel`.",
    )


def _warthog() -> Entry[FourWheelVehicle]:
    vehicle = make_vehicle(
        m=260.0,
        I_z=93.0,
        I_y=51.0,
        l_f=0.46,
        l_r=0.46,
        k_f=63e3,
        k_r=63e3,
        c_f=860.0,
        c_r=860.0,
        m_w=30.0,
        r=0.30,
        b=0.25,
        wheels_per_axle=2,
        I_w=0.675,
        h_cg=0.42,
        track=1.12,
        drag_area=1.0,
        rolling_resistance=0.02,
        steer_max=0.5,
        steer_rate=5.0,
        steer_lag=0.05,
        drive_torque_max=900.0,
        brake_torque_max=900.0,
        power_max=5e3,
        torque_lag=0.05,
        drive_front=0.5,
        brake_front=0.5,
    )
    return Entry(
        name="warthog",
        record=FourWheelVehicle(vehicle, make_four_wheel(vehicle, I_x=56.0, skid=1.0)),
        title="skid-steered robot of 260 kg, Clearpath Warthog class",
        source="robot description published by Clearpath Robotics (github.com/warthog-cpr/warthog, "
        "warthog_description/urdf/warthog_params.xacro): chassis 100 kg, two side units of 50 kg, wheels of "
        "15 kg, 0.30 m x 0.25 m; axles at +-0.46 m, wheels at +-0.56 m",
        remark="Derived: inertias and CG height of uniform boxes and cylinders of these sizes at their "
        "places, as if the side units stood in the middle. Not in the source, chosen for the class: tyres as "
        "springs (bounce 3.5 Hz, damping ratio 0.15; the rocking of the side units is left out), torque 1.2 "
        "of the weight at the wheels, 5 kW, drag area 1 m^2, lags 0.05 s; ``steer_max`` is the handle's "
        "largest position, at which right and left differ by all the torque.",
    )


#: Vehicles by name; ``FOUR_WHEEL_VEHICLES.entry(name)`` gives title, source and remark.
FOUR_WHEEL_VEHICLES: Catalogue[FourWheelVehicle] = Catalogue(
    "four-wheel vehicle", (_mrzr(), _hmmwv(), _warthog())
)
