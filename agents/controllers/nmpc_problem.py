"""The optimal control problem of `agents.controllers.nmpc` as casadi functions. Needs the extra ``mpc``.

A bicycle with dynamic side slip in coordinates of the path (R. Rajamani, Vehicle Dynamics and Control, 2nd
ed. 2012, sections 2.3 and 2.5) on axles whose forces follow the tables of the compiled wheel
(`agents.controllers.traction_limits`). Numbers of the soil are parameters: one problem serves all soils.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from agents.learning.learners import MissingExtraError
from offroad_env.physics.records import Vehicle

__all__ = [
    "CONTROLS",
    "INPUTS",
    "SLACKS",
    "SOIL",
    "STATES",
    "Horizon",
    "Problem",
    "bicycle",
    "make_problem",
]

#: Distance from the path [m], heading error [rad], way [m], speed, side speed [m/s], yaw rate [rad/s],
#: steering [rad], force of the drive per mass [m/s^2], and the commands of these two.
STATES = ("e", "psi", "s", "v", "vy", "r", "steer", "push", "steer_command", "push_command")
#: Rates of the commands [rad/s, m/s^3].
INPUTS = ("steer_rate", "push_rate")
#: Slacks of corridor [m], slip angles of front and rear [rad], final speed [m/s].
SLACKS = 4
CONTROLS = len(INPUTS) + SLACKS
#: Numbers of the soil: side acceleration D sin(C arctan(B alpha)) of both axles, drag c (sqrt(alpha^2 + w^2)
#: - w) of each in a bend [m/s^2], resistance [m/s^2], largest acceleration by drive and brake [m/s^2], what
#: the axles hold, and what moves the vehicle on, beyond the model [m/s^2].
SOIL = ("D_f", "C_f", "B_f", "D_r", "C_r", "B_r", "drag", "resistance", "hold", "d_f", "d_r", "d_v")
#: Slip angle from which the drag of a bend grows linearly [rad].
DRAG_ANGLE = 0.1
#: Speed below which slip angles refer to this speed [m/s].
_SLOW = 1.0
#: Share of the side force that remains where all of the grip is used along the wheel.
_LEFT_OVER = 0.3


class Horizon(NamedTuple):
    """Length and resolution of the plan."""

    stages: int = 20
    dt: float = 0.09  #: [s]


class Problem(NamedTuple):
    """Functions of one vehicle."""

    step: Any  #: (state, inputs, soil, kappa) -> state after `Horizon.dt`
    stage: Any  #: (states, inputs, soils, kappas) -> states, A, B of all stages
    slips: Any  #: (state, soil) -> slip angles of front and rear, and their Jacobian
    short_step: (
        Any  #: (state, soil, kappa) -> state after a control interval, and its Jacobian in state, soil
    )


def bicycle(ca: Any, x: Any, u: Any, soil: Any, kappa: Any, vehicle: Vehicle) -> tuple[Any, Any, Any]:
    """(time derivative of the state, slip angle of front, of rear) as casadi expressions."""
    e, psi, _, v, vy, r, steer, push, steer_command, push_command = (x[i] for i in range(len(STATES)))
    steer_rate, push_rate = (u[i] for i in range(len(INPUTS)))
    p = {name: soil[i] for i, name in enumerate(SOIL)}
    along = ca.sqrt(v * v + _SLOW * _SLOW * ca.exp(-v * v))
    front = steer - ca.atan((vy + vehicle.l_f * r) / along)
    rear = -ca.atan((vy - vehicle.l_r * r) / along)
    net = push - p["resistance"]
    used = net / p["hold"]
    share = ca.sqrt(1.0 - (1.0 - _LEFT_OVER**2) * ca.tanh(used * used))
    side_f = share * p["D_f"] * ca.sin(p["C_f"] * ca.atan(p["B_f"] * front)) + p["d_f"]
    side_r = share * p["D_r"] * ca.sin(p["C_r"] * ca.atan(p["B_r"] * rear)) + p["d_r"]
    wheelbase = vehicle.l_f + vehicle.l_r
    whole = (vehicle.l_r * side_f + vehicle.l_f * side_r) / wheelbase
    turn = vehicle.m * vehicle.l_f * vehicle.l_r / (wheelbase * vehicle.I_z) * (side_f - side_r)
    bend = sum(ca.sqrt(a * a + DRAG_ANGLE**2) - DRAG_ANGLE for a in (front, rear))
    along_path = (v * ca.cos(psi) - vy * ca.sin(psi)) / (1.0 - kappa * e)
    rates = (
        v * ca.sin(psi) + vy * ca.cos(psi),
        r - kappa * along_path,
        along_path,
        net - p["drag"] * bend + vy * r + p["d_v"],
        whole - v * r,
        turn,
        (steer_command - steer) / vehicle.steer_lag,
        (push_command - push) / vehicle.torque_lag,
        steer_rate,
        push_rate,
    )
    return ca.vertcat(*rates), front, rear


@lru_cache(maxsize=8)
def make_problem(vehicle: Vehicle, horizon: Horizon, dt: float) -> Problem:
    """The functions for a vehicle; ``dt`` [s] is the control interval of the observer.

    Raises
    ------
    MissingExtraError
        Without casadi.
    """
    try:
        import casadi as ca
    except ImportError as error:
        raise MissingExtraError(f"casadi is missing ({error}): pip install 'offroad-bekker[mpc]'") from error

    x, u = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS))
    soil, kappa = ca.SX.sym("soil", len(SOIL)), ca.SX.sym("kappa")

    def after(time: float, steps: int, x: Any, u: Any) -> Any:
        h = time / steps
        for _ in range(steps):  # the classical Runge-Kutta method
            k1, _, _ = bicycle(ca, x, u, soil, kappa, vehicle)
            k2, _, _ = bicycle(ca, x + 0.5 * h * k1, u, soil, kappa, vehicle)
            k3, _, _ = bicycle(ca, x + 0.5 * h * k2, u, soil, kappa, vehicle)
            k4, _, _ = bicycle(ca, x + h * k3, u, soil, kappa, vehicle)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x

    late = after(horizon.dt, 2, x, u)
    names = [x, u, soil, kappa]
    stage = ca.Function("stage", names, [late, ca.jacobian(late, x), ca.jacobian(late, u)])
    _, front, rear = bicycle(ca, x, u, soil, kappa, vehicle)
    slips = ca.vertcat(front, rear)
    soon = after(dt, 1, x, ca.DM.zeros(len(INPUTS)))
    rest = ca.vertcat(x, soil)
    return Problem(
        step=ca.Function("step", names, [late]),
        stage=stage.map(horizon.stages),
        slips=ca.Function("slips", [x], [slips, ca.jacobian(slips, x)]).map(horizon.stages),
        short_step=ca.Function("short_step", [x, soil, kappa], [soon, ca.jacobian(soon, rest)]),
    )


def fitted_side(angles: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(3,) D, C, B of D sin(C arctan(B alpha)) through the side accelerations of a table; C at most 1.

    The form is that of H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed. 2012, section 1.2, without a peak.
    """
    from scipy.optimize import least_squares

    highest = float(side[-1])
    if highest <= 1e-6:
        return np.array([1e-3, 1.0, 1.0])
    start = np.array([highest, 0.9, max(1.5 * side[2] / (angles[2] * highest), 1.0)])

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[0] * np.sin(x[1] * np.arctan(x[2] * angles)) - side)

    found = least_squares(residual, start, bounds=([1e-3, 0.3, 0.5], [3.0 * highest, 1.0, 100.0]))
    return np.asarray(found.x)
