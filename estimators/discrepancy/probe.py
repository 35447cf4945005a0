"""What no effect explains: a force of unknown course in each equation of motion.

In every window and equation a force that is constant over each third of the window stands for a random walk.
If such forces would take more out of the residuals than chance can, something is wrong that has no name here;
how the force hangs on speed, slip, load and time shows its shape, and no name is invented for it.

What was named may then be no more than its shadow. So the effects are fitted once more with the unknown
forces beside them: a force that an effect only mimics takes its trace over; what no force can write - late
inputs, a wrong scale, a turned sensor - stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.fit import Fit, Shares
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.road import chance_of_gain
from estimators.discrepancy.run_model import Records, RunModel
from estimators.discrepancy.windows import Windows
from offroad_env.effects import EFFECTS, apply
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EQUATIONS", "Beside", "Rest", "Shape", "beside_forces", "probe", "shapes_of"]

#: Equation of motion -> effect that pushes in it.
EQUATIONS = {"longitudinal": "push_forward", "lateral": "push_left", "yaw": "yaw_moment"}
#: What else may push where nobody knows of it.
_SPINS = ("spin_front", "spin_rear")
#: Pieces of a window with a force of their own.
_PIECES = 3
#: Size of the push of a finite difference, as a share of the weight (times an arm for moments).
_PUSH = 2e-3


@dataclass(frozen=True, kw_only=True)
class Shape:
    """How strongly the unknown force follows a quantity."""

    quantity: str
    correlation: float
    slope: float  #: force per unit of the quantity [N or N m per its unit]


def shapes_of(
    quantities: Mapping[str, np.ndarray], force: np.ndarray, weight: np.ndarray
) -> tuple[Shape, ...]:
    """Weighted correlation of a force (K,) with what might drive it, strongest first."""
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
class Rest:
    """What the unknown forces of one equation would explain."""

    equation: str
    gain: float  #: twice the log-likelihood
    freedom: int  #: forces that it takes
    chance: float  #: share of logs with nothing wrong that gain as much
    force: np.ndarray  #: (W x pieces,) estimated force [N, yaw: N m]
    deviation: np.ndarray  #: (W x pieces,)
    shapes: tuple[Shape, ...]  #: strongest first

    @property
    def excess(self) -> float:
        """What the forces explain beyond chance."""
        return max(self.gain - self.freedom, 0.0)


@dataclass(frozen=True, kw_only=True)
class Beside:
    """The effects of a model, in its order, when forces of unknown course are fitted beside them."""

    sizes: np.ndarray  #: (E,)
    deviations: np.ndarray  #: (E,)
    kept: np.ndarray  #: (E,) share of the information about each size that the forces leave
    alike: np.ndarray  #: (E, E) how much two sizes hang together, 0 to 1; 0 with themselves


def _weight_of(run: RunModel, effect: str) -> float:
    """The vehicle's weight [N]; times half the wheelbase for yaw, and the radius for a wheel's spin [N m]."""
    vehicle = run.setup.plant.vehicle
    arms = {"yaw_moment": 0.5 * (vehicle.l_f + vehicle.l_r)} | dict.fromkeys(_SPINS, vehicle.r)
    return vehicle.m * GRAVITY * arms.get(effect, 1.0)


def _pushed(run: RunModel, setup, records: Records, warm: np.ndarray, piece: int, effect: str) -> Records:
    """The records with a push during one piece of every window."""
    size = _PUSH * _weight_of(run, effect)
    pushed = apply(setup, [(effect, {EFFECTS[effect].size.name: size})])
    # Both stretches with the same compiled model: the base model's own code rounds differently.
    plain = replace(setup, plant=setup.plant._replace(effects=np.zeros_like(pushed.plant.effects)))
    if setup.plant.effects is not None:
        plain = setup
    windows, begin = run.windows, run.windows.begin[:-1]
    a = piece * windows.count // _PIECES
    b = (piece + 1) * windows.count // _PIECES
    states, readings = records.states.copy(), records.readings.copy()
    first = Windows(first=windows.first + a, count=b - a, use=windows.use)
    _splice(states, readings, run.simulate(pushed, states[begin + a], warm, first), first, begin + a)
    if piece < _PIECES - 1:
        later = Windows(first=windows.first + b, count=windows.count - b, use=windows.use)
        # The instant of the border keeps the push: its readings are of the force that held before it.
        done = run.simulate(plain, states[begin + b], warm, later)
        _splice(states, readings, done, later, begin + b, skip=1)
    return Records(states=states, readings=readings)


def _splice(states, readings, records: Records, windows: Windows, places: np.ndarray, skip: int = 0) -> None:
    begin = windows.begin
    for w, place in enumerate(places):
        rows = slice(begin[w] + skip, begin[w + 1])
        target = slice(place + skip, place + windows.count[w] + 1)
        states[target], readings[target] = records.states[rows], records.readings[rows]


def _columns(fit: Fit, effect: str) -> np.ndarray | None:
    """Derivatives of the data by the pushes in each piece of its own window, (M, pieces), per newton.

    None where the model breaks down.
    """
    setups, columns = fit._setups(), []
    scale = _PUSH * _weight_of(fit.runs[0], effect)
    try:
        for piece in range(_PIECES):
            parts = [
                run.predict(setup, _pushed(run, setup, records, warm, piece, effect))
                for run, setup, records, warm in zip(fit.runs, setups, fit._records, fit.warm, strict=True)
            ]
            columns.append(fit._difference(fit._prediction, np.concatenate(parts), scale))
    except OffroadError:
        return None
    return np.stack(columns, axis=1)


def probe(fit: Fit) -> tuple[Rest, ...]:
    """What unknown forces would still explain at the present point of a fit, equation by equation."""
    fit = _levelled(fit)
    residual = fit.whitener(fit.residual())
    states = fit.whitener(fit._states)
    found = []
    for equation, effect in EQUATIONS.items():
        columns = _columns(fit, effect)
        if columns is not None:
            found.append(_rest(fit, equation, residual, states, fit.whitener(columns)))
    return tuple(found)


def _levelled(fit: Fit) -> Fit:
    """The fit, on hard ground with the noise of every window at its own level."""
    if not fit.hard:
        return fit
    fit = fit.branch()
    fit.whitener.learn_levels(fit.residual())
    return fit


def beside_forces(fit: Fit) -> Beside:
    """Sizes of the effects in the model with the unknown forces of all equations beside them.

    To first order about the present point. A force is believed to be smaller than the vehicle's weight.
    Unknown torques may turn the wheels, too: no force on the body stands for a wrong law of their slip.
    """
    fit = _levelled(fit)
    residual, forces = fit.whitener(fit.residual()), []
    # Where wheels turn as measured, or have no spin, no torque turns them.
    spins = _SPINS if at.OMEGA_F in fit.runs[0].free else ()
    for effect in (*EQUATIONS.values(), *spins):
        columns = _columns(fit, effect)
        if columns is not None:
            forces.append(fit.whitener(columns * _weight_of(fit.runs[0], effect)))
    states, shared = fit.whitener(fit._states), fit.whitener(fit.columns())
    alone, _ = fit.reduce(residual, states, shared)
    beside, _ = fit.reduce(residual, np.column_stack([states, *forces]), shared)
    before, after = (_variances(shares) for shares in (alone, beside))
    wide = np.ones(len(fit.sizes)) if fit.drawn is None else fit.widenings()[len(NUISANCES) :]
    return Beside(
        sizes=fit.sizes + fit._inside(beside)[len(NUISANCES) :],
        deviations=np.sqrt(after * wide),
        kept=before / after,
        alike=beside.alike(len(fit.sizes)),
    )


def _variances(shares: Shares) -> np.ndarray:
    return np.diag(np.linalg.inv(shares.normal))[len(NUISANCES) :]


def _rest(fit: Fit, equation: str, residual: np.ndarray, states: np.ndarray, columns: np.ndarray) -> Rest:
    weight = np.diag(1.0 / fit.runs[0].spread ** 2)
    gain, freedom, forces, deviations = 0.0, 0, [], []
    healthy = None if fit.healthy is None else np.zeros(fit.healthy.shape[1])
    for w in range(int(fit.window.max()) + 1):
        rows = np.flatnonzero(fit.window == w)
        A, B, r = states[rows], columns[rows], residual[rows]
        solved = np.linalg.solve(A.T @ A + weight, A.T @ np.column_stack([B, r]))
        inner = B.T @ B - (A.T @ B).T @ solved[:, :-1]
        score = B.T @ r - (A.T @ B).T @ solved[:, -1]
        values, vectors = np.linalg.eigh(inner)
        seen = values > 1e-9 * max(values[-1], 1e-300)
        inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
        gain += float(score @ inverse @ score)
        if healthy is not None:
            pushes = (B - A @ solved[:, :-1]).T @ fit.healthy[rows]
            healthy += np.sum(pushes * (inverse @ pushes), axis=0)
        freedom += int(seen.sum())
        forces.append(inverse @ score)
        deviations.append(np.sqrt(np.maximum(np.diag(inverse), 1e-300)))
    force, deviation = np.concatenate(forces), np.concatenate(deviations)
    return Rest(
        equation=equation,
        gain=gain,
        freedom=freedom,
        chance=chance_of_gain(gain, freedom, healthy),
        force=force,
        deviation=deviation,
        shapes=shapes_of(_quantities(fit), force, 1.0 / deviation**2),
    )


def _quantities(fit: Fit) -> dict[str, np.ndarray]:
    """Means over the pieces of what a force may hang on."""
    table: dict[str, list[float]] = {}
    for run, records in zip(fit.runs, fit._records, strict=True):
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
