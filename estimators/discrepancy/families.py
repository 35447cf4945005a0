"""Families of causes: variants of one thing that the vehicle, the soil, a sensor or a gauge does.

Data seldom tell the variants of a family from each other, and which of them fits best changes with the
manoeuvres, or the slip angles, that are measured. The family is what a verdict can be held to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

__all__ = ["DRIVE_FAMILIES", "RIG_FAMILIES", "families_of"]

#: Family -> its members on a rig, effects and structural causes.
RIG_FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "slip sinkage": ("slip_sinkage", "soil_loosening", "slip_exponent"),
        "soil pushed aside": ("bulldozing",),
        "soil pushed ahead": ("front_bulldozing", "rut_drag"),
        "distribution of the pressure": (
            "pressure_distribution",
            "pressure_direction",
            "peak_angle",
            "exit_angle",
        ),
        "strength of the soil": (
            "friction_angle",
            "cohesion",
            "shear_modulus",
            "grouser_thrust",
            "shear_strengths",
            "soil_frame_shear",
        ),
        "stiffness of the soil": ("soil_stiffness", "effective_width"),
        "gauges": ("drawbar_offset", "side_force_offset", "sinkage_offset", "load_scale"),
    }
)
#: Family -> its members in a drive.
DRIVE_FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "late steering": ("steer_delay", "steer_lag"),
        "clocks of inputs and sensors": ("clock_offset",),
        "ratio of the steering": ("steer_gain",),
        "zero of the steering": ("steer_offset",),
        "torque of drive and brakes": ("torque_scale", "drive_scale", "brake_scale"),
        "brakes left and right": ("one_sided_brake",),
        "load of the vehicle": ("payload", "placed_payload", "cg_shift", "cg_height", "inertia"),
        "resistance to the motion": ("rolling_resistance", "aero_drag", "rut_drag"),
        "slope of the ground": ("grade", "bank"),
        "a moment about the vertical": ("yaw_moment",),
        "springs and dampers": ("spring_rate", "damper_nonlinear", "coulomb_friction", "bump_stop"),
        "tyres": ("tyre_pressure",),
        "strength of the soil": ("friction_angle", "cohesion", "shear_modulus", "grouser_thrust"),
        "soil that changes along the route": ("n_step", "n_trend"),
        "stiffness of the soil": ("rate_damping", "multi_pass"),
        "distribution of the pressure": ("exit_angle",),
        "slip sinkage": ("slip_exponent",),
        "soil pushed aside": ("bulldozing",),
        "grip of the ground": ("road_grip",),
        "reading of a_x": ("accel_bias_x", "imu_misalignment_pitch"),
        "reading of a_y": ("accel_bias_y", "imu_misalignment_roll"),
        "reading of a_z": ("accel_bias_z", "accel_scale"),
        "reading of pitch_rate": ("gyro_bias_pitch",),
        "reading of yaw_rate": ("gyro_bias_yaw",),
        "place of the IMU": ("lever_arm_x", "lever_arm_z"),
        "place of the antenna": ("antenna_x",),
        "age of the pose": ("pose_delay",),
        "reading of the wheel speeds": ("wheel_radius_scale",),
    }
)


def families_of(members: Iterable[str], families: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Families that some causes belong to, in the order of ``families``."""
    names = set(members)
    return tuple(family for family, own in families.items() if names.intersection(own))
