"""Parameter records of the kernels: named tuples of floats, nothing else.

Kernels trust these records. They are made only by the validating factories in
``offroad_env.soils``, ``offroad_env.vehicles`` and ``offroad_env.terrain``. Every field is a
float: a single int or bool would make numba compile a second version of every kernel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Ground", "Soil", "SoilMap", "Vehicle", "Wheel"]


class Wheel(NamedTuple):
    """A rigid cylindrical wheel."""

    r: float  #: radius [m]
    b: float  #: width [m]


class Soil(NamedTuple):
    """Bekker pressure-sinkage, Mohr-Coulomb strength, Janosi-Hanamoto shear, contact angles.

    ``rigid = 1.0`` replaces the soil by hard ground with a saturating combined-slip force
    (``mu``, ``C_alpha``, ``C_kappa``); the soil fields are then unused.
    """

    k_c: float  #: cohesive modulus of sinkage [N/m^(n+1)]
    k_phi: float  #: frictional modulus of sinkage [N/m^(n+2)]
    n: float  #: sinkage exponent [-]
    c: float  #: cohesion [Pa]
    phi: float  #: angle of internal shearing resistance [rad]
    k_x: float  #: longitudinal shear deformation modulus [m]
    k_y: float  #: lateral shear deformation modulus [m]
    a_0: float  #: theta_m / theta_f at zero slip [-]
    a_1: float  #: slope of theta_m / theta_f with slip [-]
    b_0: float  #: theta_r / theta_f at zero slip [-]
    b_1: float  #: slope of theta_r / theta_f with slip [-]
    rigid: float  #: 1.0 = hard ground, 0.0 = deformable soil
    mu: float  #: friction coefficient of hard ground [-]
    C_alpha: float  #: side-slip stiffness of hard ground per unit of wheel load [1/rad]
    C_kappa: float  #: stiffness against slip along the wheel per unit of wheel load [-]


class Vehicle(NamedTuple):
    """Half-car + bicycle vehicle. ``_f`` front axle, ``_r`` rear axle.

    Stiffness, damping and unsprung mass are per axle; an axle carries ``wheels_per_axle`` wheels.
    """

    m: float  #: total mass [kg]
    I_z: float  #: yaw moment of inertia [kg m^2]
    I_y: float  #: pitch moment of inertia [kg m^2]
    l_f: float  #: CG to front axle [m]
    l_r: float  #: CG to rear axle [m]
    k_f: float  #: front suspension stiffness, axle [N/m]
    k_r: float  #: rear suspension stiffness, axle [N/m]
    c_f: float  #: front suspension damping, axle [N s/m]
    c_r: float  #: rear suspension damping, axle [N s/m]
    m_w: float  #: unsprung mass, axle [kg]
    r: float  #: wheel radius [m]
    b: float  #: wheel width [m]
    wheels_per_axle: float  #: wheels on an axle [-]
    I_w: float  #: spin inertia of one wheel with its driveline share [kg m^2]
    h_cg: float  #: height of the CG above the contact points [m]
    track: float  #: distance between left and right wheels [m]
    drag_area: float  #: aerodynamic drag area C_d A [m^2]
    rolling_resistance: float  #: bearing and tyre rolling resistance, fraction of load [-]
    steer_max: float  #: largest road-wheel angle [rad]
    steer_rate: float  #: largest road-wheel angle rate [rad/s]
    steer_lag: float  #: first-order time constant of the steering [s]
    drive_torque_max: float  #: largest total drive torque at the wheels [N m]
    brake_torque_max: float  #: largest total brake torque at the wheels [N m]
    power_max: float  #: largest drive power at the wheels [W]
    torque_lag: float  #: first-order time constant of drive and brake torque [s]
    drive_front: float  #: front share of the drive torque, 0 ... 1 [-]
    brake_front: float  #: front share of the brake torque, 0 ... 1 [-]


class Ground(NamedTuple):
    """Height field H(X, Y) = H_0 + S_x X + S_y Y + sum_i A_i sin(p_i X + q_i Y + phase_i).

    One closed form serves every terrain of the project: the paper's field is three such waves,
    a grade is the plane, ISO 8608-like roughness is many waves with random phases.
    """

    H_0: float  #: height at the origin [m]
    S_x: float  #: plane slope dH/dX [-]
    S_y: float  #: plane slope dH/dY [-]
    waves: np.ndarray  #: (M, 4) float64, C order: amplitude [m], p [rad/m], q [rad/m], phase [rad]


class SoilMap(NamedTuple):
    """Where the sinkage exponent departs from the base soil: smooth-edged discs.

    Row i: x [m], y [m], radius [m], n inside [-]. Later rows lie over earlier ones; the edge is a
    smooth step of width ``edge`` [m].
    """

    edge: float
    patches: np.ndarray  #: (K, 4) float64, C order
