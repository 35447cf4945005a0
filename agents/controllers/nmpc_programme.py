"""The quadratic programme of a real-time iteration: linearised stages, soft bounds, one call of a solver."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from agents.controllers.nmpc_problem import CONTROLS, INPUTS, STATES, Horizon, Problem

__all__ = ["Limits", "Programme"]

_E, _PSI, _S, _V, _VY, _R, _STEER, _PUSH, _STEER_COMMAND, _PUSH_COMMAND = range(len(STATES))
_X, _U = len(STATES), CONTROLS
_CORRIDOR, _FRONT, _REAR, _SPEED = range(len(INPUTS), CONTROLS)  # slacks

#: Metres of progress that cost as much as: (m/s^3)^2 of drive, (rad/s)^2 of steering, over a second.
_PUSH_WEIGHT, _STEER_WEIGHT = 2e-3, 1.0
#: And: m^2 from the path, rad^2 of heading, (rad/s)^2 ... small weights that make the problem regular.
_REGULAR = np.array([0.02, 0.1, 1e-6, 1e-4, 1e-3, 1e-2, 1e-3, 1e-4, 1e-3, 1e-4])
#: At the end of the plan the vehicle should lie along the path.
_FINAL = np.array([0.3, 2.0, 1e-6, 1e-4, 0.05, 0.2, 1e-3, 1e-4, 1e-3, 1e-4])
#: Linear and quadratic cost of the slacks: corridor [m], slip angles [rad], final speed [m/s].
_LINEAR = np.array([20.0, 20.0, 20.0, 8.0])
_QUADRATIC = np.array([200.0, 100.0, 100.0, 10.0])
_FAR = 1e8


class Limits(NamedTuple):
    """Bounds of a plan."""

    corridor: float  #: distance from the path [m]
    slip: float  #: slip angle of either axle [rad]
    steer: float  #: steering command [rad]
    steer_rate: float  #: its rate [rad/s]
    push: float  #: largest drive per mass [m/s^2]
    brake: float  #: lowest, negative [m/s^2]
    speed_max: float  #: [m/s]
    stations: np.ndarray  #: (S,) ways ahead [m]
    final: np.ndarray  #: (S,) speeds there from which all that is seen can be driven [m/s]


@lru_cache(maxsize=4)
def _pattern(stages: int) -> tuple[Any, np.ndarray]:
    """Sparsity of the constraints' matrix (as a casadi `Sparsity`), and the order of its entries.

    Unknowns: stage by stage state and controls, and the last state. Rows, stage by stage: dynamics, then slip
    angles and corridor of the later state, each as an upper and a lower bound, then the speed.
    """
    import casadi as ca

    full = _fill(
        stages, np.ones((stages, _X, _X)), np.ones((stages, _X, len(INPUTS))), np.ones((stages, 2, _X))
    )
    matrix = csc_matrix(full)
    matrix.sort_indices()
    rows, columns = matrix.shape
    sparsity = ca.Sparsity(rows, columns, matrix.indptr.tolist(), matrix.indices.tolist())
    return sparsity, np.flatnonzero(full.T.ravel())


_ROWS = _X + 2 + 4 + 1  # dynamics, corridor, slips, speed


def _fill(stages: int, A: np.ndarray, B: np.ndarray, G: np.ndarray) -> np.ndarray:
    """The constraints' matrix, dense."""
    width = _X + _U
    full = np.zeros((stages * _ROWS, stages * width + _X))
    for k in range(stages):
        top, left = k * _ROWS, k * width
        late = left + width
        full[top : top + _X, left : left + _X] = A[k]
        full[top : top + _X, left + _X : left + _X + len(INPUTS)] = B[k]
        full[top : top + _X, late : late + _X] -= np.eye(_X)
        row = top + _X
        slack = left + _X
        full[row, late + _E], full[row, slack + _CORRIDOR] = 1.0, -1.0
        full[row + 1, late + _E], full[row + 1, slack + _CORRIDOR] = 1.0, 1.0
        for j, name in enumerate((_FRONT, _REAR)):
            full[row + 2 + 2 * j, late : late + _X], full[row + 2 + 2 * j, slack + name] = G[k, j], -1.0
            full[row + 3 + 2 * j, late : late + _X], full[row + 3 + 2 * j, slack + name] = G[k, j], 1.0
        full[row + 6, late + _V], full[row + 6, slack + _SPEED] = 1.0, -1.0
    return full


class Programme:
    """Builds and solves the programme; keeps the last multipliers as the next start."""

    def __init__(self, horizon: Horizon, *, solver: str = "osqp") -> None:
        import casadi as ca

        self._horizon = horizon
        self._width = _X + _U
        self._count = horizon.stages * self._width + _X
        sparsity, self._order = _pattern(horizon.stages)
        self._H = self._weights()
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False}
        options |= SOLVERS[solver]
        self._solver = ca.conic(
            "programme", solver, {"h": ca.Sparsity.diag(self._count), "a": sparsity}, options
        )
        self._ca = ca
        self._a = ca.DM(sparsity, np.zeros(sparsity.nnz()))
        self._sparsity = sparsity
        self._last: Any = None

    def _weights(self) -> np.ndarray:
        """Diagonal of the Hessian."""
        stages, dt = self._horizon
        controls = np.concatenate([dt * np.array([_STEER_WEIGHT, _PUSH_WEIGHT]), _QUADRATIC * dt])
        H = np.concatenate([*[np.concatenate([dt * _REGULAR, controls])] * stages, _FINAL])
        return np.asarray(2.0 * H)

    def solve(
        self,
        problem: Problem,
        start: np.ndarray,
        states: np.ndarray,
        inputs: np.ndarray,
        soil: np.ndarray,
        kappas: np.ndarray,
        limits: Limits,
    ) -> tuple[np.ndarray, np.ndarray]:
        """States (N+1, 10) and inputs (N, 2) of the plan from ``start``, linearised about the given ones."""
        stages = self._horizon.stages
        late, A, B = (np.asarray(part) for part in problem.stage(states[:-1].T, inputs.T, soil, kappas[None]))
        A = A.reshape(_X, stages, _X).transpose(1, 0, 2)
        B = B.reshape(_X, stages, len(INPUTS)).transpose(1, 0, 2)
        slips, G = (np.asarray(part) for part in problem.slips(states[1:].T))
        G = G.reshape(2, stages, _X).transpose(1, 0, 2)
        full = _fill(stages, A, B, G)
        a = self._ca.DM(self._sparsity, full.T.ravel()[self._order])
        # Rows: bounds. Everything but the plan's departure from the old one is constant.
        defect = np.einsum("kij,kj->ki", A, states[:-1]) + np.einsum("kij,kj->ki", B, inputs) - late.T
        offset = slips.T - np.einsum("kij,kj->ki", G, states[1:])
        low, high = np.full((stages, _ROWS), -_FAR), np.full((stages, _ROWS), _FAR)
        low[:, :_X] = high[:, :_X] = defect
        high[:, _X], low[:, _X + 1] = limits.corridor, -limits.corridor
        for j in range(2):
            high[:, _X + 2 + 2 * j] = limits.slip - offset[:, j]
            low[:, _X + 3 + 2 * j] = -limits.slip - offset[:, j]
        high[:, _X + 6] = limits.speed_max
        high[-1, _X + 6] = min(
            float(np.interp(states[-1, _S], limits.stations, limits.final)), limits.speed_max
        )
        lowest, highest = self._bounds(start, limits)
        g = self._gradient()
        found = self._solver(
            h=self._H,
            g=g,
            a=a,
            lba=low.ravel(),
            uba=high.ravel(),
            lbx=lowest,
            ubx=highest,
            **({} if self._last is None else self._last),
        )
        z = np.asarray(found["x"]).ravel()
        if not np.isfinite(z).all():
            self._last = None
            return states, inputs
        self._last = {"x0": found["x"], "lam_a0": found["lam_a"], "lam_x0": found["lam_x"]}
        table = z[: stages * self._width].reshape(stages, self._width)
        return np.vstack([table[:, :_X], z[-_X:]]), table[:, _X : _X + len(INPUTS)].copy()

    def _gradient(self) -> np.ndarray:
        """Progress at the end counts -1 a metre; slacks cost their linear weight."""
        stages, dt = self._horizon
        controls = np.concatenate([np.zeros(len(INPUTS)), dt * _LINEAR])
        g = np.tile(np.concatenate([np.zeros(_X), controls]), stages)
        final = np.zeros(_X)
        final[_S] = -1.0
        return np.concatenate([g, final])

    def _bounds(self, start: np.ndarray, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
        stages = self._horizon.stages
        low_x, high_x = np.full(_X, -_FAR), np.full(_X, _FAR)
        low_x[_STEER_COMMAND], high_x[_STEER_COMMAND] = -limits.steer, limits.steer
        low_x[_PUSH_COMMAND], high_x[_PUSH_COMMAND] = limits.brake, limits.push
        low_u = np.array([-limits.steer_rate, -12.0, 0.0, 0.0, 0.0, 0.0])
        high_u = np.array([limits.steer_rate, 12.0, _FAR, _FAR, _FAR, _FAR])
        low = np.concatenate([*[np.concatenate([low_x, low_u])] * stages, low_x])
        high = np.concatenate([*[np.concatenate([high_x, high_u])] * stages, high_x])
        low[:_X] = high[:_X] = start
        return low, high


#: Options of solvers; none of them looks at a clock.
SOLVERS: dict[str, dict[str, Any]] = {
    "osqp": {
        "osqp": {
            "verbose": False,
            "max_iter": 200,
            "eps_abs": 1e-3,
            "eps_rel": 1e-3,
            "adaptive_rho": True,
            "adaptive_rho_interval": 25,
            "polish": False,
        }
    },
    "piqp": {"piqp": {}},
    "proxqp": {"proxqp": {}},
    "hpipm": {"hpipm": {}},
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False},
}
