"""Records of the kernels: named tuples of floats and arrays, nothing else.

Kernels trust the parameter records. They are made only by the validating factories in
``offroad_env.world.soils``, ``offroad_env.world.vehicles`` and ``offroad_env.world.terrain``. Every number is
a float: a single int or bool would make numba compile a second version of every kernel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AxleContact",
    "AxleForces",
    "AxlePlace",
    "AxleSpring",
    "BodyForces",
    "ContactOptions",
    "FloatArray",
    "FourWheel",
    "Ground",
    "RutSection",
    "Soil",
    "SoilField",
    "SoilMap",
    "SpringState",
    "Structure",
    "Tyre",
    "Vehicle",
    "Wheel",
    "WheelMotion",
    "WheelReaction",
]

FloatArray = NDArray[np.float64]


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
    k_x: float  #: longitudinal shear deformation modulus, the Janosi modulus K [m]
    k_y: float  #: lateral shear deformation modulus, the Janosi modulus across the wheel [m]
    a_0: float  #: theta_m / theta_f at zero slip [-]
    a_1: float  #: slope of theta_m / theta_f with slip [-]
    b_0: float  #: theta_r / theta_f at zero slip [-]
    b_1: float  #: slope of theta_r / theta_f with slip [-]
    rigid: float  #: 1.0 = hard ground, 0.0 = deformable soil
    mu: float  #: friction coefficient of hard ground [-]
    C_alpha: float  #: cornering stiffness of hard ground per unit of wheel load [1/rad]
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


class FourWheel(NamedTuple):
    """What a vehicle with four wheels has beyond a `Vehicle`; made by `world.four_wheel`.

    Springs and dampers of a wheel are half of its axle's.
    """

    I_x: float  #: roll moment of inertia of the whole vehicle [kg m^2]
    track_f: float  #: distance between the front wheels [m]
    track_r: float  #: distance between the rear wheels [m]
    roll_centre_f: float  #: height of the front roll centre above the contact points [m]
    roll_centre_r: float  #: height of the rear one [m]
    anti_roll_f: float  #: roll stiffness of the front axle beyond that of its springs [N m/rad]
    anti_roll_r: float  #: and of the rear axle [N m/rad]
    bump_f: float  #: travel of a front wheel up to its bump stop, from static equilibrium [m]
    bump_r: float  #: of a rear wheel [m]
    droop_f: float  #: travel of a front wheel down to its rebound stop [m]
    droop_r: float  #: of a rear wheel [m]
    toe_f: float  #: toe-in of each front wheel [rad]
    toe_r: float  #: of each rear wheel [rad]
    ackermann: float  #: 1.0 = the wheels' axes meet in one point, 0.0 = parallel wheels [-]
    rear_steer: float  #: angle of the rear wheels per angle of the front ones [-]
    skid: float  #: 1.0 = turns by different torques left and right, no wheel is steered
    lock_f: float  #: 1.0 = the front differential is locked, 0.0 = open
    lock_r: float  #: the rear one
    lock_c: float  #: the one between the axles
    servo: float  #: torque per error of a wheel's given speed [N m s/rad]; 0.0 = torques are given


class Ground(NamedTuple):
    """Height field H(X, Y) = H_0 + S_x X + S_y Y + sum_i A_i sin(p_i X + q_i Y + phase_i).

    One closed form serves every terrain of the project: the paper's field is three such waves,
    a grade is the plane, ISO 8608-like roughness is many waves with random phases.
    """

    H_0: float  #: height at the origin [m]
    S_x: float  #: plane slope dH/dX [-]
    S_y: float  #: plane slope dH/dY [-]
    waves: FloatArray  #: (M, 4) float64, C order: amplitude [m], p [rad/m], q [rad/m], phase [rad]


class SoilMap(NamedTuple):
    """Where the sinkage exponent departs from the base soil: smooth-edged discs.

    Row i: x [m], y [m], radius [m], n inside [-]. Later rows lie over earlier ones; the edge is a
    smooth step of width ``edge`` [m].
    """

    edge: float
    patches: FloatArray  #: (K, 4) float64, C order


class SoilField(NamedTuple):
    """Natural soil: discs of other soils, and a random field of plane waves over all of it.

    A row of ``patches``: x, y, radius [m], k_c z^n [N/m], k_phi z^n [Pa] at z = 5 cm, n, c [Pa], tan(phi),
    k_x, k_y [m], a_0, a_1, b_0, b_1; the edge is a smooth step of width ``edge`` [m]. A row of ``waves``:
    p, q [rad/m], the amplitudes of log p(5 cm), n, log c, log tan(phi), log K in sin(p X + q Y), and the five
    in cos(p X + q Y).
    """

    edge: float  #: width of the edges of patches [m]
    patches: FloatArray  #: (K, 14) float64, C order
    waves: FloatArray  #: (M, 12) float64, C order


class WheelMotion(NamedTuple):
    """How a wheel moves over the ground, in the contact's own axes."""

    rim_speed: float  #: r omega [m/s]
    v_l: float  #: speed of the hub along the wheel [m/s]
    v_c: float  #: speed of the hub across the wheel, to the left positive [m/s]


class AxlePlace(NamedTuple):
    """Where an axle stands, for the laws that change its soil (`hooks.change_soil`)."""

    x: float  #: position of the axle's middle [m]
    y: float  #: [m]
    arm: float  #: distance ahead of the CG, negative for the rear axle [m]
    v_eps: float  #: low-speed regularisation [m/s]


class AxleForces(NamedTuple):
    """What the soil does to the wheels of an axle, in the contact's own axes."""

    F_x: float  #: along the wheel, forward positive [N]
    F_y: float  #: across the wheel, to the left positive [N]
    torque: float  #: against the wheels' rotation [N m]


class AxleContact(NamedTuple):
    """What holds an axle up, for the laws that change its forces (`hooks.change_wheel_forces`)."""

    F_n: float  #: normal force [N]
    sinkage: float  #: depth of the lowest point of the rim below the surface [m]
    arm: float  #: distance ahead of the CG, negative for the rear axle [m]
    v_eps: float  #: low-speed regularisation [m/s]
    r: float  #: radius of a wheel [m]
    b: float  #: width of a wheel [m]
    wheels: float  #: number of wheels on the axle [-]


class SpringState(NamedTuple):
    """Travel of an axle's suspension, from static equilibrium; extension is positive."""

    height: float  #: height of the body over the ground at the axle [m]
    rate: float  #: its rate of change [m/s]


class AxleSpring(NamedTuple):
    """Suspension of an axle."""

    static_load: float  #: load at rest on level ground [N]
    k: float  #: stiffness [N/m]
    c: float  #: damping [N s/m]


class BodyForces(NamedTuple):
    """What the ground does to the vehicle's horizontal motion, in heading axes."""

    F_x: float  #: forward [N]
    F_y: float  #: to the left [N]
    M_z: float  #: yaw moment, to the left positive [N m]
    brake: float  #: torque of all brakes; a braking force at the rims, where the drive is a force [N m]


class WheelReaction(NamedTuple):
    """Forces of soil on one wheel, in the contact's own axes."""

    F_x: float  #: along the wheel, forward positive [N]
    F_y: float  #: across the wheel, to the left positive [N]
    F_z: float  #: along the normal [N]
    torque: float  #: against the wheel's rotation [N m]


class ContactOptions(NamedTuple):
    """How the forces of a contact are computed."""

    v_eps: float  #: low-speed regularisation; 0 for the plain law [m/s]
    resultant: float  #: 1.0 = shear stresses share one strength, 0.0 = each has the whole
    fine: bool  #: reference quadrature instead of the fast one


class Tyre(NamedTuple):
    """A pneumatic tyre, besides the radius and width of its wheel (`world.tyres` makes and checks them)."""

    r: float  #: radius that the stiffness belongs to [m]
    b: float  #: width that the stiffness belongs to [m]
    inflation: float  #: inflation pressure above the atmosphere [Pa]
    k_carcass: float  #: vertical stiffness without inflation pressure [N/m]
    k_per_pressure: float  #: growth of the vertical stiffness with inflation pressure [N/m per Pa]
    stiffening: float  #: growth exponent of the secant stiffness with deflection [-]
    mu: float  #: friction coefficient of the tread [-]
    cornering: float  #: cornering stiffness on hard ground per load [1/rad]
    rolling: float  #: loss of effective rolling radius per deflection [-]


class Structure(NamedTuple):
    """Which laws a wheel follows where it presses and shears soil (`world.structures` names them).

    Flags are 1.0 or 0.0.
    """

    ground_normal: float  #: pressure acts along the undeformed ground's normal; 0.0 = normal to the rim
    own_sinkage: float  #: from each point's own sinkage, elastic exit; 0.0 = Wong-Reece contact angles
    soil_path: float  #: shear displacement is path length in the soil; 0.0 = along the rim, per direction
    resultant: float  #: shear stresses share one strength; 0.0 = each direction has the whole
    ruts: float  #: the following wheel meets compacted soil
    shear_carry: float  #: and starts at the shear displacement that the leading wheel left
    hull: float  #: k_c is divided by the contact hull's width instead of the wheel's
    slip_sinkage: float  #: 0 = none, 1 = linear in slip, 2 = Lyasko
    slip_sinkage_rate: float  #: growth of the linear law [-]
    elastic_modulus: float  #: slope of unloading and reloading [Pa/m]
    damping: float  #: pressure per downward speed of the rim [Pa s/m]
    grouser_height: float  #: radial height of the grousers beyond the wheel's radius [m]
    external_torque: float  #: shaft torques come from outside: the body bears no reaction to them
    tyre: Tyre | None = None  #: flexible tyre; None = a rigid rim


class RutSection(NamedTuple):
    """What a leading wheel has left where a wheel stands."""

    share: float  #: share of the wheel's width on the rut [-]
    depth: float  #: of the rut's bottom, unloaded, below the undisturbed surface [m]
    shear: float  #: shear displacement it has, in Janosi moduli [-]
