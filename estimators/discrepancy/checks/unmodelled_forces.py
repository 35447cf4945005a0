"""Unmodelled forces: unknown inputs, piecewise constant, in each equation of motion.

In every window and equation a force that is constant over each third of the window is estimated, in
place of a random walk. If such forces would take more out of the residuals than noise can, something is wrong
that no effect of the library explains; the correlation of the force with speed, slip, load and time shows
its shape.

An effect that was named may be confounded with such a force. So the sizes of the effects are estimated once
more with the unknown inputs fitted jointly. An effect that only mimics a force loses its information to
them; effects that no force can imitate - late inputs, a wrong scale, a turned sensor - keep it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit import autoregressive
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import bounded_step
from estimators.discrepancy.model.normal_equations import NormalEquations, reduced
from estimators.discrepancy.model.null_simulations import p_value_of_gain
from estimators.discrepancy.model.protocol import Records
from estimators.discrepancy.model.run_model import RunModel, drives
from estimators.discrepancy.model.windows import Windows
from offroad_env.effects import EFFECTS, Setup, apply
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY

__all__ = [
    "EQUATIONS", "JointSizes", "Shape", "UnmodelledForce", "shapes_of", "sizes_with_unknown_inputs",
    "unmodelled_forces",
]  # fmt: skip

#: Equation of motion -> effect that pushes in it.
EQUATIONS = {"longitudinal": "push_forward", "lateral": "push_left", "yaw": "yaw_moment"}
#: Torques that may act on the wheels besides.
_SPINS = ("spin_front", "spin_rear")
#: Pieces of a window with a force of their own.
_PIECES = 3
#: Size of the push of a finite difference, as a share of the weight (times an arm for moments).
_PUSH = 2e-3
#: Share of the largest eigenvalue below which the data do not determine a direction.
_SEEN = 1e-9


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Correlation of an unmodelled force with a quantity."""

    quantity: str
    correlation: float
    slope: float  #: force per unit of the quantity [N or N m per its unit]


def shapes_of(
    quantities: Mapping[str, np.ndarray], force: np.ndarray, weight: np.ndarray
) -> tuple[Shape, ...]:
    """Weighted correlations of a force (K,) with quantities (K,), strongest first."""
    shapes = []
    away = force - np.average(force, weights=weight)
    own = np.sum(weight * away**2)
    for name, values in quantities.items():
        centred = values - np.average(values, weights=weight)
        theirs = np.sum(weight * centred**2)
        if own <= 0.0 or theirs <= 1e-12 * np.sum(weight):
            continue
        together = np.sum(weight * away * centred)
        correlation = float(together / np.sqrt(own * theirs))
        shapes.append(Shape(quantity=name, correlation=correlation, slope=float(together / theirs)))
    return tuple(sorted(shapes, key=lambda shape: -abs(shape.correlation)))


@dataclass(frozen=True, kw_only=True)
class UnmodelledForce:
    """Unknown input of one equation of motion."""

    equation: str
    gain: float  #: twice the log-likelihood
    freedom: int  #: number of its pieces that the data determine
    p_value: float  #: share of null logs that gain as much
    force: np.ndarray  #: (W x pieces,) estimated force [N, yaw: N m]
    deviation: np.ndarray  #: (W x pieces,)
    shapes: tuple[Shape, ...]  #: strongest first

    @property
    def excess(self) -> float:
        """Gain beyond its expectation under the null."""
        return max(self.gain - self.freedom, 0.0)


@dataclass(frozen=True, kw_only=True)
class JointSizes:
    """Sizes of the effects of a model, in its order, with unknown inputs fitted jointly."""

    sizes: np.ndarray  #: (E,)
    deviations: np.ndarray  #: (E,)
    kept: np.ndarray  #: (E,) share of the information about each size that the unknown inputs leave
    correlations: np.ndarray  #: (E, E) absolute correlations of the sizes; 0 on the diagonal


def _weight_of(run: RunModel, effect: str) -> float:
    """The vehicle's weight [N]; times half the wheelbase for yaw, and the radius for a wheel's spin [N m]."""
    vehicle = run.setup.plant.vehicle
    arms = {"yaw_moment": 0.5 * (vehicle.l_f + vehicle.l_r)} | dict.fromkeys(_SPINS, vehicle.r)
    return vehicle.m * GRAVITY * arms.get(effect, 1.0)


def _pushed(
    run: RunModel, setup: Setup, records: Records, warm: np.ndarray, piece: int, effect: str
) -> Records:
    """The records with a push during one piece of every window."""
    size = _PUSH * _weight_of(run, effect)
    pushed = apply(setup, [(effect, {EFFECTS[effect].size.name: size})])
    plain = setup
    if setup.plant.effects is None:
        # Both stretches with the same compiled model: the base model's own code rounds differently.
        plain = replace(setup, plant=setup.plant._replace(effects=np.zeros_like(pushed.plant.effects)))
    windows, begin = run.windows, run.windows.begin[:-1]
    a = piece * windows.count // _PIECES
    b = (piece + 1) * windows.count // _PIECES
    first = Windows(first=windows.first + a, count=b - a, use=windows.use)
    spliced = Records(states=records.states.copy(), readings=records.readings.copy())
    done = run.simulate(pushed, records.states[begin + a], warm, first)
    _splice(spliced, done, first, begin + a)
    if piece < _PIECES - 1:
        later = Windows(first=windows.first + b, count=windows.count - b, use=windows.use)
        # The instant of the border keeps the push: its readings are of the force that held before it.
        done = run.simulate(plain, spliced.states[begin + b], warm, later)
        _splice(spliced, done, later, begin + b, skip=1)
    return spliced


def _splice(into: Records, records: Records, windows: Windows, places: np.ndarray, skip: int = 0) -> None:
    """Write simulated windows over the records from ``places`` (W,) on."""
    begin = windows.begin
    for w, place in enumerate(places):
        rows = slice(begin[w] + skip, begin[w + 1])
        target = slice(place + skip, place + windows.count[w] + 1)
        into.states[target], into.readings[target] = records.states[rows], records.readings[rows]


def _columns(fit: FitResult, effect: str) -> np.ndarray | None:
    """Derivatives of the data by the pushes in each piece of its own window, (M, pieces), per newton.

    None where the model breaks down.
    """
    there, runs, columns = fit.linearisation, drives(fit.runs), []
    scale = _PUSH * _weight_of(runs[0], effect)
    try:
        for piece in range(_PIECES):
            parts = [
                run.predict(setup, _pushed(run, setup, records, warm, piece, effect))
                for run, setup, records, warm in zip(
                    runs, there.setups, there.records, there.point.warm, strict=True
                )
            ]
            columns.append(there.difference(there.prediction, np.concatenate(parts), scale))
    except OffroadError:
        return None
    return np.stack(columns, axis=1)


def unmodelled_forces(fit: FitResult) -> tuple[UnmodelledForce, ...]:
    """Unknown inputs that would still explain residuals at the point of a fit, equation by equation."""
    fit = _levelled(fit)
    found = []
    for equation, effect in EQUATIONS.items():
        columns = _columns(fit, effect)
        if columns is not None:
            found.append(_force(fit, equation, fit.noise.whiten(columns)))
    return tuple(found)


def _levelled(fit: FitResult) -> FitResult:
    """The fit, on hard ground with the noise of every window at its own level."""
    if not fit.problem.hard:
        return fit
    return replace(fit, noise=autoregressive(fit).with_levels(fit.residual))


def sizes_with_unknown_inputs(fit: FitResult) -> JointSizes:
    """Sizes of the effects in the model with the unknown inputs of all equations fitted jointly.

    To first order about the present point. The prior standard deviation of a force is the vehicle's weight.
    Unknown torques may turn the wheels, too: a force on the body cannot imitate a wrong law of their slip.
    """
    wide, first = fit.size_inflation, drives(fit.runs)[0]
    fit = _levelled(fit)
    residual, states = fit.noise.whiten(fit.residual), [fit.white_states]
    # Where wheels turn as measured, or have no spin, no torque turns them.
    spins = _SPINS if at.OMEGA_F in first.free else ()
    for effect in (*EQUATIONS.values(), *spins):
        columns = _columns(fit, effect)
        if columns is not None:
            states.append(fit.noise.whiten(columns * _weight_of(first, effect)))
    shared = fit.white_shared()
    alone = fit.reduced(residual, shared)
    joint = reduced(fit.problem, fit.point, residual, np.column_stack(states), shared)
    count = len(fit.nuisances)
    before, after = (_variances(equations, count) for equations in (alone, joint))
    return JointSizes(
        sizes=fit.sizes + bounded_step(fit.problem, fit.point, joint)[count:],
        deviations=np.sqrt(after * wide),
        kept=before / after,
        correlations=joint.correlations(len(fit.sizes)),
    )


def _variances(equations: NormalEquations, count: int) -> np.ndarray:
    """Of the parameters after the first ``count``."""
    return np.diag(equations.covariance)[count:]


class _WindowForce(NamedTuple):
    """Unknown input in one window."""

    gain: float  #: twice the log-likelihood
    freedom: int
    force: np.ndarray  #: (pieces,)
    deviation: np.ndarray  #: (pieces,)
    null_gains: np.ndarray  #: (K,) the same gain in null simulations


def _force(fit: FitResult, equation: str, columns: np.ndarray) -> UnmodelledForce:
    """The unknown input whose whitened derivatives are ``columns`` (M, pieces)."""
    residual = fit.noise.whiten(fit.residual)
    parts = [
        _window_force(fit, i, residual[rows], columns[rows]) for i, rows in enumerate(fit.problem.window_rows)
    ]
    force, deviation = np.concatenate([p.force for p in parts]), np.concatenate([p.deviation for p in parts])
    gain, freedom = sum(part.gain for part in parts), sum(part.freedom for part in parts)
    null = None if fit.null is None else np.sum([part.null_gains for part in parts], axis=0)
    return UnmodelledForce(
        equation=equation,
        gain=gain,
        freedom=freedom,
        p_value=p_value_of_gain(gain, freedom, null),
        force=force,
        deviation=deviation,
        shapes=shapes_of(_quantities(fit), force, 1.0 / deviation**2),
    )


def _window_force(fit: FitResult, window: int, r: np.ndarray, B: np.ndarray) -> _WindowForce:
    """The same in one window, from its whitened residuals and derivatives."""
    rows = fit.problem.window_rows[window]
    A = fit.white_states[rows]
    weight = np.diag(fit.problem.state_information[window])
    solved = np.linalg.solve(A.T @ A + weight, A.T @ np.column_stack([B, r]))
    inner = B.T @ B - (A.T @ B).T @ solved[:, :-1]
    score = B.T @ r - (A.T @ B).T @ solved[:, -1]
    values, vectors = np.linalg.eigh(inner)
    seen = values > _SEEN * max(values[-1], 1e-300)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    null_gains = np.empty(0)
    if fit.null is not None:
        scores = (B - A @ solved[:, :-1]).T @ fit.null.white[rows]
        null_gains = np.sum(scores * (inverse @ scores), axis=0)
    return _WindowForce(
        gain=float(score @ inverse @ score),
        freedom=int(seen.sum()),
        force=inverse @ score,
        deviation=np.sqrt(np.maximum(np.diag(inverse), 1e-300)),
        null_gains=null_gains,
    )


def _quantities(fit: FitResult) -> dict[str, np.ndarray]:
    """Means over the pieces of quantities on which a force may depend."""
    table: dict[str, list[float]] = {}
    for run, records in zip(drives(fit.runs), fit.records, strict=True):
        begin = run.windows.begin[:-1]
        for w, count in enumerate(run.windows.count):
            for piece in range(_PIECES):
                rows = slice(
                    begin[w] + piece * count // _PIECES, begin[w] + (piece + 1) * count // _PIECES + 1
                )
                x, r = records.states[rows], records.readings[rows]
                values = {
                    "speed [m/s]": x[:, at.V_X],
                    "speed squared [m^2/s^2]": x[:, at.V_X] ** 2,
                    "slip [-]": 0.5 * (r[:, at.SLIP] + r[:, at.AXLE + at.SLIP]),
                    "steering [rad]": x[:, at.STEER],
                    "yaw rate [rad/s]": x[:, at.YAW_RATE],
                    "drive torque [N m]": x[:, at.DRIVE] - x[:, at.BRAKE],
                    "time [s]": np.array(
                        [run.t_0 + run.step * (run.windows.first[w] + rows.start - begin[w])]
                    ),
                    "position x [m]": x[:, at.X],
                    "position y [m]": x[:, at.Y],
                }
                for name, value in values.items():
                    table.setdefault(name, []).append(float(np.mean(value)))
    return {name: np.array(values) for name, values in table.items()}
