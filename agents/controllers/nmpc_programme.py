"""The quadratic programme of a real-time iteration: linearised stages, soft bounds, one call of a solver."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from agents.controllers.nmpc_problem import CONTROLS, INPUTS, SLACKS, STATES, Horizon, Problem

__all__ = ["Limits", "Programme"]

_E, _PSI, _S, _V, _VY, _R, _STEER, _PUSH, _STEER_COMMAND, _PUSH_COMMAND = range(len(STATES))
_X, _U = len(STATES), CONTROLS

#: Metres of progress that cost as much as: (m/s^3)^2 of drive, (rad/s)^2 of steering, over a second.
_PUSH_WEIGHT, _STEER_WEIGHT = 2e-3, 1.0
#: And: m^2 from the path, rad^2 of heading, (rad/s)^2 ... small weights that make the problem regular.
_REGULAR = np.array([0.02, 0.1, 1e-6, 1e-4, 1e-3, 1e-2, 1e-3, 1e-4, 1e-3, 1e-4])
#: At the end of the plan the vehicle should lie along the path.
_FINAL = np.array([0.3, 2.0, 1e-6, 1e-4, 0.05, 0.2, 1e-3, 1e-4, 1e-3, 1e-4])
#: Linear and quadratic cost of the slacks: corridor [m], slip angles [rad], final speed [m/s].
_LINEAR = np.array([60.0, 20.0, 20.0, 8.0])
_QUADRATIC = np.array([200.0, 100.0, 100.0, 10.0])
#: Linear cost of the slack of the speed at the end [m/(m/s)]. A metre a second more there gains up to 1.8 m,
#: the duration of the plan times it: at a lower cost the bound would be broken in every plan.
_FINAL_SPEED = 4.0
_FAR = float("inf")
#: Largest rate of the drive [m/s^3], and the share of it with which what a bound excludes now must end.
_PUSH_RATE, _RETURN = 12.0, 0.9


class Limits(NamedTuple):
    """Bounds of a plan."""

    corridor: float  #: distance from the path [m]
    slip: float  #: slip angle of either axle [rad]
    steer: float  #: steering command [rad]
    steer_rate: float  #: its rate [rad/s]
    push: float  #: largest drive per mass [m/s^2]
    brake: float  #: lowest, negative [m/s^2]
    stations: np.ndarray  #: (S,) ways ahead [m]
    speeds: np.ndarray  #: (S,) highest speeds there inside the plan [m/s]
    final: np.ndarray  #: (S,) speeds there at its end, from which all that is seen can be driven [m/s]


_BOUNDS = 7  #: rows of bounds a state: corridor and two slip angles from above and below, speed


class _Layout(NamedTuple):
    """Where the unknowns and the rows of the programme stand.

    Unknowns: the inputs of the first stage; state, inputs and slacks of the later ones; the last state with
    its slacks; and a nought, with which a chain of stages ends. Rows, stage by stage: dynamics, then bounds
    of the state.
    """

    sparsity: Any  #: of the rows, a casadi `Sparsity`
    source: np.ndarray  #: (entries,) of the rows: places in what `_values` gives
    states: np.ndarray  #: (N, 10) places of the states after the first one
    inputs: np.ndarray  #: (N, 2) of the inputs
    slacks: np.ndarray  #: (N, 4) of the slacks
    dynamics: np.ndarray  #: (N, 10) rows
    bounds: np.ndarray  #: (N, 7) rows
    sizes: dict[str, Any]  #: of the stages

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.slacks[-1, -1]) + 2


@lru_cache(maxsize=4)
def _layout(stages: int) -> _Layout:
    """The layout, and which entries of the linearised stages fill it."""
    import casadi as ca

    N, u, width, height = stages, len(INPUTS), _X + _U, _X + _BOUNDS
    states = u + width * np.arange(N)[:, None] + np.arange(_X)
    inputs = np.vstack([np.arange(u), states[:-1, -1:] + 1 + np.arange(u)])
    slacks = states[:, -1:] + 1 + u + np.arange(SLACKS)
    slacks[-1] -= u  # no inputs follow the last state
    dynamics = height * (np.arange(N)[:, None] - 1) + _X + np.arange(_X)
    dynamics[0] = np.arange(_X)
    bounds = height * np.arange(N)[:, None] + 2 * _X + np.arange(_BOUNDS)
    bounds[-1] -= _X - 1
    labels = np.zeros((int(bounds[-1, -1]) + 1, int(slacks[-1, -1]) + 2), dtype=np.int64)
    plus, minus, entries = 1, 2, 3 + np.arange(N * (_X * (_X + u) + 2 * _X))
    A, B, G = np.split(entries, np.cumsum([N * _X * _X, N * _X * u]))
    A, B, G = A.reshape(N, _X, _X), B.reshape(N, _X, u), G.reshape(N, 2, _X)
    for k in range(N):
        if k > 0:
            labels[np.ix_(dynamics[k], states[k - 1])] = A[k]
        labels[np.ix_(dynamics[k], inputs[k])] = B[k]
        labels[dynamics[k], states[k]] = minus
        rows = bounds[k]
        labels[rows[:2], states[k, _E]] = plus
        labels[rows[-1], states[k, _V]] = plus
        for j in range(2):
            labels[np.ix_(rows[2 + 2 * j : 4 + 2 * j], states[k])] = G[k, j]
        labels[rows, slacks[k, [0, 0, 1, 1, 2, 2, 3]]] = [minus, plus, minus, plus, minus, plus, minus]
    labels[bounds[-1, 0] - 1, -1] = minus
    filled = csc_matrix(labels)
    sparsity = ca.Sparsity(*labels.shape, filled.indptr.tolist(), filled.indices.tolist())
    sizes = {
        "N": N + 1,
        "nx": [0, *[_X] * N, 1],
        "nu": [u, *[_U] * (N - 1), SLACKS, 0],
        "ng": [0, *[_BOUNDS] * N, 0],
    }
    return _Layout(sparsity, filled.data - 1, states, inputs, slacks, dynamics, bounds, sizes)


def _values(A: np.ndarray, B: np.ndarray, G: np.ndarray) -> np.ndarray:
    """What stands in the rows: (N, 10, 10) and (N, 10, 2) of the dynamics, (N, 2, 10) of the slip angles."""
    return np.concatenate([[1.0, -1.0], A.ravel(), B.ravel(), G.ravel()])


def _speeds(way: np.ndarray, limits: Limits) -> np.ndarray:
    """(N,) highest speeds of the plan at these ways [m]."""
    speeds: np.ndarray = np.interp(way, limits.stations, limits.speeds)
    speeds[-1] = min(speeds[-1], float(np.interp(way[-1], limits.stations, limits.final)))
    return speeds


class Programme:
    """Builds and solves the programme; keeps the last multipliers as the next start."""

    def __init__(self, horizon: Horizon, *, solver: str = "hpipm") -> None:
        import casadi as ca

        self._horizon = horizon
        self._layout = _layout(horizon.stages)
        H, self._g = self._cost()
        self._H = ca.diag(ca.DM(H))  # a mere column would be repeated to a full matrix at every call
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False, **SOLVERS[solver]}
        if solver == "hpipm":
            options |= self._layout.sizes
        shapes = {"h": ca.Sparsity.diag(self._layout.unknowns), "a": self._layout.sparsity}
        self._solver = ca.conic("programme", solver, shapes, options)
        self._ca = ca
        self._last: Any = None

    def _cost(self) -> tuple[np.ndarray, np.ndarray]:
        """Diagonal of the Hessian, and gradient: progress at the end counts -1 a metre."""
        at, dt = self._layout, self._horizon.dt
        H, g = np.full(at.unknowns, 1e-6), np.zeros(at.unknowns)
        H[at.states] = dt * _REGULAR
        H[at.states[-1]] = _FINAL
        H[at.inputs] = dt * np.array([_STEER_WEIGHT, _PUSH_WEIGHT])
        H[at.slacks], g[at.slacks] = dt * _QUADRATIC, dt * _LINEAR
        g[at.slacks[-1, -1]] = _FINAL_SPEED
        g[at.states[-1, _S]] = -1.0
        return 2.0 * H, g

    def solve(
        self,
        problem: Problem,
        start: np.ndarray,
        states: np.ndarray,
        inputs: np.ndarray,
        soil: np.ndarray,
        kappas: np.ndarray,
        limits: Limits,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """States (N+1, 10) and inputs (N, 2) of the plan from ``start``, linearised about the given ones.

        None where the solver has not converged.
        """
        stages, at = self._horizon.stages, self._layout
        late, A, B = (np.asarray(part) for part in problem.stage(states[:-1].T, inputs.T, soil, kappas[None]))
        A = A.reshape(_X, stages, _X).transpose(1, 0, 2)
        B = B.reshape(_X, stages, len(INPUTS)).transpose(1, 0, 2)
        slips, G = (np.asarray(part) for part in problem.slips(states[1:].T))
        G = G.reshape(2, stages, _X).transpose(1, 0, 2)
        defect = np.einsum("kij,kj->ki", A, states[:-1]) + np.einsum("kij,kj->ki", B, inputs) - late.T
        defect[0] -= A[0] @ start
        offset = slips.T - np.einsum("kij,kj->ki", G, states[1:])
        low, high = self._row_bounds(defect, offset, states[1:, _S], limits)
        lowest, highest = self._bounds(start, limits)
        found = self._solver(
            h=self._H,
            g=self._g,
            a=self._ca.DM(at.sparsity, _values(A, B, G)[at.source]),
            lba=low,
            uba=high,
            lbx=lowest,
            ubx=highest,
            **({} if self._last is None else self._last),
        )
        z = np.asarray(found["x"]).ravel()
        if not (self._solver.stats()["success"] and np.isfinite(z).all()):
            self._last = None
            return None
        self._last = {"x0": found["x"], "lam_a0": found["lam_a"], "lam_x0": found["lam_x"]}
        return np.vstack([start, z[at.states]]), z[at.inputs]

    def cost(self, problem: Problem, states: np.ndarray, inputs: np.ndarray, limits: Limits) -> float:
        """Cost of a drive with states (N+1, 10) and inputs (N, 2), what exceeds its bounds included."""
        dt, later = self._horizon.dt, states[1:]
        slips = np.abs(np.asarray(problem.slips(later.T)[0]).T) - limits.slip
        over = np.column_stack(
            [np.abs(later[:, _E]) - limits.corridor, slips, later[:, _V] - _speeds(later[:, _S], limits)]
        ).clip(min=0.0)
        linear = np.tile(dt * _LINEAR, (len(later), 1))
        linear[-1, -1] = _FINAL_SPEED
        weights = np.tile(dt * _REGULAR, (len(later), 1))
        weights[-1] = _FINAL
        rates = dt * np.array([_STEER_WEIGHT, _PUSH_WEIGHT])
        return float(
            np.sum(linear * over + dt * _QUADRATIC * over**2)
            + np.sum(weights * later**2)
            + np.sum(rates * inputs**2)
            - later[-1, _S]
        )

    def _row_bounds(
        self, defect: np.ndarray, offset: np.ndarray, way: np.ndarray, limits: Limits
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the rows.

        Parameters
        ----------
        defect : array (N, 10)
            Right side of the dynamics.
        offset : array (N, 2)
            Slip angles at state zero [rad], linear about the last plan.
        way : array (N,)
            Of the last plan [m].
        limits
        """
        at = self._layout
        low, high = (np.full(at.sparsity.rows(), end) for end in (-_FAR, _FAR))
        low[at.bounds[-1, 0] - 1] = high[at.bounds[-1, 0] - 1] = 0.0
        low[at.dynamics] = high[at.dynamics] = defect
        high[at.bounds[:, 0]], low[at.bounds[:, 1]] = limits.corridor, -limits.corridor
        high[at.bounds[:, [2, 4]]], low[at.bounds[:, [3, 5]]] = limits.slip - offset, -limits.slip - offset
        high[at.bounds[:, 6]] = _speeds(way, limits)
        return low, high

    def _bounds(self, start: np.ndarray, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the unknowns.

        What is believed of the soil may change within a decision, the drive may not: where its command in
        ``start`` is beyond a bound, the bound comes to it as fast as the drive can follow. Else no plan would
        exist, for as long as the last one drives on.
        """
        at = self._layout
        command = start[_PUSH_COMMAND]
        way_back = _RETURN * _PUSH_RATE * self._horizon.dt * np.arange(1, self._horizon.stages + 1)
        brake = np.minimum(limits.brake, command + way_back)
        push = np.maximum(limits.push, command - way_back)
        low, high = (np.full(at.unknowns, end) for end in (-_FAR, _FAR))
        low[at.slacks] = 0.0
        for place, lowest, highest in (
            (at.states[:, _STEER_COMMAND], -limits.steer, limits.steer),
            (at.states[:, _PUSH_COMMAND], brake, push),
            (at.inputs[:, 0], -limits.steer_rate, limits.steer_rate),
            (at.inputs[:, 1], -_PUSH_RATE, _PUSH_RATE),
        ):
            low[place], high[place] = lowest, highest
        return low, high


#: Options of solvers; none of them looks at a clock. The interior-point method follows the stages and has
#: converged after 8 to 14 iterations; osqp has not after 200, and the rate of the drive then errs by more
#: than a third of its largest value in one decision of ten.
SOLVERS: dict[str, dict[str, Any]] = {
    "hpipm": {"inf": 1e4, "hpipm": {"iter_max": 30}},
    "osqp": {
        "osqp": {
            "verbose": False,
            "max_iter": 4000,
            "eps_abs": 1e-5,
            "eps_rel": 1e-5,
            "adaptive_rho": True,
            "adaptive_rho_interval": 25,
            "polish": False,
        }
    },
}
