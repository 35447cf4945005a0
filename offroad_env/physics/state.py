"""Where each quantity sits in the arrays that the kernels pass around."""

from __future__ import annotations

__all__ = [
    "AXLE",
    "CELLS",
    "CELL_SIZE",
    "CONTACT_SIZE",
    "FOUR_WHEEL_NAMES",
    "FOUR_WHEEL_READINGS",
    "FOUR_WHEEL_SIZE",
    "MOTION",
    "READINGS_SIZE",
    "STATE_NAMES",
    "STATE_SIZE",
    "STRUCTURED_CONTACT_SIZE",
    "WHEELS",
    "WHEEL_COUNT",
    "sizes",
]

# Vehicle state. The paper's ten states come first; `full` adds wheel spin and actuators.
(X, Y, YAW, Z, PITCH, V_X, V_Y, V_Z, PITCH_RATE, YAW_RATE) = range(10)  # [m, rad, m/s, rad/s]
(OMEGA_F, OMEGA_R, STEER, DRIVE, BRAKE) = range(10, 15)  # [rad/s, rad/s, rad, N m, N m]
STATE_SIZE = 15
STATE_NAMES = (
    "X", "Y", "yaw", "z", "pitch", "v_x", "v_y", "v_z", "pitch_rate", "yaw_rate",
    "omega_f", "omega_r", "steer", "drive_torque", "brake_torque",
)  # fmt: skip

# A vehicle with four wheels has these too. Its OMEGA_F and OMEGA_R are the means of an axle's two wheels;
# the split is half of right minus left. Roll is positive with the left side up.
(ROLL, ROLL_RATE, SPLIT_F, SPLIT_R) = range(STATE_SIZE, STATE_SIZE + 4)  # [rad, rad/s, rad/s, rad/s]
FOUR_WHEEL_SIZE = STATE_SIZE + 4
FOUR_WHEEL_NAMES = (*STATE_NAMES, "roll", "roll_rate", "split_f", "split_r")

# Warm start of the sinkage solve, per axle, or per wheel of four: part of the state, so that copies and
# sigma points carry their own (sinkage [m], local exponent d ln F_z / d ln h [-], vertical force [N]).
CONTACT_SIZE = 3
# With a structure of its own (`records.Structure`) a wheel's row goes on: sinkage above the rut's bottom
# [m], pressure at the bottom [Pa], shear displacement at the exit [Janosi moduli]; share of its width in a
# rut and that rut's depth [m] at the last solution, change of its force with either [N, N/m]; its rut now
# (`records.RutSection`); cell of the leader's track nearest to it, number of cells that it has laid itself;
# and the ring of these cells: x, y [m], depth of the unloaded rut [m], shear displacement.
(SINKAGE_ROW, EXPONENT_OF_RISE, FORCE_ROW, RISE, PEAK, SHEAR) = range(6)
(MET_SHARE, MET_DEPTH, BY_SHARE, BY_DEPTH) = range(6, 10)
(RUT_SHARE, RUT_DEPTH, RUT_SHEAR, NEAREST, LAID, TRACK) = range(10, 16)
CELLS, CELL_SIZE = 64, 4
STRUCTURED_CONTACT_SIZE = TRACK + CELLS * CELL_SIZE

# Readings of one evaluation. Front axle at 0, rear axle at AXLE.
(N, F_L, F_C, TORQUE, SINKAGE, SLIP, R_OMEGA, V_L, V_C, EXPONENT, WHEEL_X, WHEEL_Y, HEIGHT) = range(13)
AXLE = 13
MOTION = 2 * AXLE
#: Accelerations of the CG in heading axes (forward, left, up) [m/s^2], yaw and pitch [rad/s^2].
(A_X, A_Y, A_Z, YAW_ACC, PITCH_ACC, STATUS) = range(MOTION, MOTION + 6)
READINGS_SIZE = MOTION + 6

# With four wheels the axles' parts are sums of forces and means of the rest; the wheels' own, front left,
# front right, rear left, rear right, follow, in parts like an axle's, and the roll acceleration [rad/s^2].
WHEEL_COUNT = 4
WHEELS = READINGS_SIZE
ROLL_ACC = WHEELS + WHEEL_COUNT * AXLE
FOUR_WHEEL_READINGS = ROLL_ACC + 1


def sizes(four_wheel: object) -> tuple[int, int]:
    """(state, readings): how many numbers they have for what a plant holds of four wheels, or for None."""
    return (STATE_SIZE, READINGS_SIZE) if four_wheel is None else (FOUR_WHEEL_SIZE, FOUR_WHEEL_READINGS)
