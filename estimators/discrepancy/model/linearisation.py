"""The model simulated at one point, and the derivatives of its predictions there by finite differences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.discrepancy.model.nuisances import acts
from estimators.discrepancy.model.parameters import Candidate, CandidateKey, Point
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.protocol import Nuisance, Records
from offroad_env.effects import EFFECTS, Setup
from offroad_env.errors import OffroadError, SolverFailure

__all__ = ["Jacobian", "Linearisation"]

#: Finite differences: share of a state's spread, and of an effect's plausible size. On bumps they hold
#: only within some centimetres of the line that the vehicle took.
_STATE_STEP, _SIZE_STEP = 0.001, 1e-4
#: A window whose predictions move by this share of the residuals over so small a step, and otherwise on the
#: other side of the point, has jumped to another branch of a contact. Residuals are taken for no less than
#: the last share of the signal.
_JUMP, _APART, _SHARE = 1.0, 0.25, 0.05
#: The error of the rough solver must be the same at both ends of a difference. Where it is of use it changes
#: by less than 1e-5, in squares of the residuals of a window; where it is not, by 0.1 and more. What exceeds
#: this, and this share of the change itself, is taken for noise.
_NOISE, _NOISE_SHARE = 1e-3, 1e-2
#: Share by which what two parameters change may differ in proportion, and still be the same.
_ALIKE = 0.01


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Residual and records at a point, and derivatives by states, nuisances and sizes of effects.

    Derivatives are of the prediction. The simulations behind them use the rough solver at both ends of a
    difference, or the coarse one where the inputs differ, which change within its steps: its error is nearly
    the same at both. Where it is not, as with wheels that grip and slip in turn, all are accurate.
    """

    problem: LeastSquaresProblem
    point: Point
    setups: tuple[Setup, ...]
    records: tuple[Records, ...]
    prediction: np.ndarray  #: (M,)
    residual: np.ndarray  #: (M,) measured less predicted

    @classmethod
    def at(cls, problem: LeastSquaresProblem, point: Point) -> Linearisation:
        """Simulate all runs at a point.

        Raises
        ------
        SolverFailure
            Where the model has no solution.
        """
        setups = problem.setups(point)
        records, prediction = problem.simulated(point, setups)
        return cls(
            problem=problem,
            point=point,
            setups=setups,
            records=records,
            prediction=prediction,
            residual=problem.residual(prediction),
        )

    @cached_property
    def _coarse_prediction(self) -> np.ndarray:
        if self.problem.coarse_runs == self.problem.runs:
            return self.prediction
        return self.problem.predicted_coarsely(self.setups, self.point.starts, self.point.warm)

    @cached_property
    def _rough_prediction(self) -> np.ndarray:
        if self.problem.rough_runs == self.problem.runs:
            return self.prediction
        return self.problem.predicted_coarsely(self.setups, self.point.starts, self.point.warm, rough=True)

    @cached_property
    def _noisy(self) -> bool:
        """Whether the rough solver's error differs between the ends of a difference, in any window."""
        problem, point = self.problem, self.point
        if problem.rough_runs == problem.runs:
            return False
        for i, nuisance in enumerate(problem.nuisances):
            if nuisance.sensors_only or not any(acts(nuisance, run) for run in problem.runs):
                continue
            setups = self._with_nuisance(i)
            if any(new.inputs != own.inputs for new, own in zip(setups, self.setups, strict=True)):
                continue
            try:
                after = problem.predicted_coarsely(setups, point.starts, point.warm, rough=True)
                exact = problem.simulated(point, setups)[1]
            except SolverFailure:
                continue
            rough = self.difference(self._rough_prediction, after, 1.0)
            change = self.difference(self.prediction, exact, 1.0)
            least = np.maximum(_NOISE, _NOISE_SHARE * self._energy(change))
            return bool(np.any(self._energy(rough - change) > least))
        return False

    def change(self, setups: Sequence[Setup], step: float) -> np.ndarray:
        """Change of the prediction (M,) from this point to other setups, over ``step``."""
        return self._change(setups, self.point.starts, step)

    def _change(self, setups: Sequence[Setup], starts: Sequence[np.ndarray], step: float) -> np.ndarray:
        rough = all(new.inputs == own.inputs for new, own in zip(setups, self.setups, strict=True))
        if rough and self._noisy:
            there = replace(self.point, starts=tuple(starts))
            return self.difference(self.prediction, self.problem.simulated(there, setups)[1], step)
        before = self._rough_prediction if rough else self._coarse_prediction
        after = self.problem.predicted_coarsely(setups, starts, self.point.warm, rough=rough)
        return self.difference(before, after, step)

    def difference(self, before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
        """Change from one prediction (M,) to another, over ``step``; angles within half a turn."""
        return np.asarray((self.problem.residual(before) - self.problem.residual(after)) / step)

    def _sensor_change(self, setups: Sequence[Setup], step: float) -> np.ndarray:
        """The same where only the sensors differ: no simulation, unless they set the wheels in motion."""
        pairs = zip(self.problem.runs, setups, self.setups, strict=True)
        if any(run.moved_by(setup, own) for run, setup, own in pairs):
            return self.change(setups, step)
        return self.difference(self.prediction, self.problem.predicted(setups, self.records), step)

    def state_columns(self) -> np.ndarray:
        """Derivatives by the free states of each sample's own window, (M, S)."""
        runs, columns = self.problem.runs, [np.empty((self.problem.rows, 0))]
        for j in range(len(runs[0].free)):
            elsewhere = self._elsewhere(j)
            if elsewhere is not None:
                columns.append(elsewhere[:, None])
                continue
            try:
                column = self._by_state(j)
            except SolverFailure:
                column = self._by_state(j, ahead=-1.0)
            columns.append(column[:, None])
        return np.concatenate(columns, axis=1)

    def _by_state(self, j: int, *, ahead: float = 1.0) -> np.ndarray:
        """Derivative (M,) by a free state, by its step ``ahead`` or (-1) back."""
        starts = [start.copy() for start in self.point.starts]
        step = ahead * self._state_step(j)
        for start, run in zip(starts, self.problem.runs, strict=True):
            start[:, run.free[j]] += step
        return self._change(self.setups, starts, step)

    def _state_step(self, j: int) -> float:
        """Step of a finite difference by a free state, in its unit."""
        return _STATE_STEP / math.sqrt(self.problem.state_information[:, j].min())

    def _elsewhere(self, j: int) -> np.ndarray | None:
        """Derivative (M,) by a free state that only says where a window begins; None for any other."""
        moved, step = [], self._state_step(j)
        for run, setup, records in zip(self.problem.runs, self.setups, self.records, strict=True):
            found = run.displaced(setup, records, run.free[j], step)
            if found is None:
                return None
            moved.append(found)
        after = self.problem.predicted(self.setups, moved)
        return self.difference(self.prediction, after, step)

    def nuisance_columns(
        self, known: np.ndarray | None = None, effects: Mapping[CandidateKey, np.ndarray] | None = None
    ) -> np.ndarray:
        """Derivatives by the nuisances, (M, N); 0 for those that do not exist in these runs.

        Parameters
        ----------
        known
            (M, N) earlier ones, which serve again for the numbers that are stated to a tolerance. These move
            little, and are half of the work of a linearisation.
        effects
            Those by the sizes of the effects in the model. A number whose effect is among them has its
            derivative from there: one of its own would differ by what finite differences do on bumps, and
            the fit use that difference, with number and effect far off on either side.
        """
        columns = []
        for i, nuisance in enumerate(self.problem.nuisances):
            same = self._by_own_effect(nuisance, i, effects or {})
            if same is not None:
                columns.append(same)
                continue
            if known is not None and nuisance.tolerated:
                columns.append(known[:, i])
                continue
            if not any(acts(nuisance, run) for run in self.problem.runs):
                columns.append(np.zeros(self.problem.rows))
                continue
            columns.append(self._by_nuisance(i))
        return np.stack(columns, axis=1)

    def _by_nuisance(self, i: int) -> np.ndarray:
        """Derivative (M,) by one nuisance."""
        nuisance = self.problem.nuisances[i]
        change = self._sensor_change if nuisance.sensors_only else self.change
        try:
            return change(self._with_nuisance(i), nuisance.step)
        except SolverFailure:
            # At the limit of what the soil carries, one side alone may have a solution.
            return change(self._with_nuisance(i, ahead=-1.0), -nuisance.step)

    def _with_nuisance(self, i: int, *, ahead: float = 1.0) -> tuple[Setup, ...]:
        """The setups with one nuisance further by its step, or behind by it with ``ahead`` -1."""
        moved = self.point.nuisances.copy()
        moved[i] += ahead * self.problem.nuisances[i].step
        return self.problem.setups(replace(self.point, nuisances=moved))

    def _by_own_effect(
        self, nuisance: Nuisance, i: int, effects: Mapping[CandidateKey, np.ndarray]
    ) -> np.ndarray | None:
        """Derivative (M,) by a number from that by its effect; None where these do not do the same."""
        own = [c for c in self.point.candidates if c.effect == nuisance.effect and c.key in effects]
        if not nuisance.tolerated or not own or EFFECTS[nuisance.effect].hook != "parameter":
            return None
        step = self._size_step(own[0].effect)
        column = np.zeros(self.problem.rows)
        pairs = zip(self.setups, self._with_nuisance(i), self._with_size(own[0], step), strict=True)
        for k, (here, number, effect) in enumerate(pairs):
            by_number, by_effect = (
                (there.stated_numbers() - here.stated_numbers()) / length
                for there, length in ((number, nuisance.step), (effect, step))
            )
            moved = by_effect != 0.0
            ratio = by_number[moved] / by_effect[moved]
            if not moved.any() or np.any(by_number[~moved]) or np.ptp(ratio) > _ALIKE * np.abs(ratio).max():
                return None
            rows = slice(self.problem.offsets[k], self.problem.offsets[k + 1])
            column[rows] = float(np.mean(ratio)) * effects[own[0].key][rows]
        return column

    def effect_column(self, candidate: Candidate) -> np.ndarray | None:
        """Derivative by the size of an effect, (M,); None where the model has no solution.

        At its present size; at its off-value, if it is not in the model.
        """
        step = self._size_step(candidate.effect)
        column = self._effect_difference(candidate, step)
        if column is None:
            return self._effect_difference(candidate, -step)
        jumped = self._energy(step * column) > _JUMP**2
        if not jumped.any():
            return column
        # The other side of the point may lie on its branch; a window that jumps on both tells nothing.
        back = self._effect_difference(candidate, -step)
        if back is None:
            return np.where(jumped[self.problem.window], 0.0, column)
        apart = self._energy(step * (column - back))
        jumped &= apart > _APART * self._energy(step * column)
        nothing = jumped & (self._energy(step * back) > _JUMP**2)
        column = np.where(jumped[self.problem.window], back, column)
        return np.where(nothing[self.problem.window], 0.0, column)

    def _energy(self, change: np.ndarray) -> np.ndarray:
        """Squares of a change of the predictions over those of the residuals, summed by window, (W,)."""
        scale = np.ones(self.problem.rows)
        for run, offset in zip(self.problem.runs, self.problem.offsets, strict=False):
            for channel in run.channels:
                rows = slice(channel.rows.start + offset, channel.rows.stop + offset)
                # Data that are themselves simulated leave no residual.
                least = _SHARE * float(np.std(self.prediction[rows]))
                scale[rows] = max(float(np.std(self.residual[rows])), least, 1e-9)
        return np.bincount(self.problem.window, (change / scale) ** 2)

    def _effect_difference(self, candidate: Candidate, step: float) -> np.ndarray | None:
        """Change of the prediction (M,) by a ``step`` of an effect's size, over the step."""
        try:
            setups = self._with_size(candidate, step)
            sensors_only = EFFECTS[candidate.effect].sensors_only
            return (self._sensor_change if sensors_only else self.change)(setups, step)
        except OffroadError:
            return None

    def _size_step(self, effect: str) -> float:
        return _SIZE_STEP * EFFECTS[effect].plausible(self.problem.runs[0].setup.plant.vehicle)

    def _with_size(self, candidate: Candidate, step: float) -> tuple[Setup, ...]:
        """The setups with an effect further by a step of its size."""
        point = self.point
        if candidate in point.candidates:
            moved = point.sizes.copy()
            moved[point.candidates.index(candidate)] += step
            return self.problem.setups(replace(point, sizes=moved))
        moved = np.append(point.sizes, EFFECTS[candidate.effect].size.off + step)
        candidates = (*point.candidates, candidate)
        return self.problem.setups(replace(point, candidates=candidates, sizes=moved))


@dataclass(frozen=True, kw_only=True)
class Jacobian:
    """Derivatives of the prediction, each kind taken at a point not far away; None where not yet taken."""

    states: np.ndarray | None = None  #: (M, S)
    nuisances: np.ndarray | None = None  #: (M, N)
    effects: Mapping[CandidateKey, np.ndarray] = field(default_factory=dict)  #: (M,) each

    def window_states(self) -> np.ndarray:
        """(M, S) derivatives by the free states.

        Raises
        ------
        ValueError
            If they were not taken.
        """
        if self.states is None:
            raise ValueError("the fit has no derivatives by the states of its windows: descend first")
        return self.states

    def renewed_states(self, at: Linearisation) -> Jacobian:
        """The same with new derivatives by the states."""
        return replace(self, states=at.state_columns())

    def without_numbers(self, at: Linearisation) -> Jacobian:
        """As if nothing depended on the numbers that are stated to a tolerance: these stay where they are."""
        nothing = np.zeros((at.problem.rows, at.problem.nuisance_count))
        known = nothing if self.nuisances is None else self.nuisances
        tolerated = [nuisance.tolerated for nuisance in at.problem.nuisances]
        return replace(self, nuisances=np.where(tolerated, nothing, known))

    def renewed(self, at: Linearisation, *, states: bool = True, tolerated: bool = True) -> Jacobian:
        """New derivatives by states, nuisances and the effects in the model.

        Those by other effects are left out: on bumps, starts that moved by ten centimetres change them.

        Parameters
        ----------
        states
            Those by states, too, or else those that are there.
        tolerated
            Likewise those by numbers that are stated to a tolerance.

        Raises
        ------
        SolverFailure
            Where the model has no solution.
        """
        known = self.states if not states and self.states is not None else at.state_columns()
        effects = {}
        for candidate, size in zip(at.point.candidates, at.point.sizes, strict=True):
            column = at.effect_column(candidate)
            if column is None:
                raise SolverFailure(f"the model breaks down near {candidate.effect} = {size:.3g}")
            effects[candidate.key] = column
        nuisances = at.nuisance_columns(None if tolerated else self.nuisances, effects)
        return Jacobian(states=known, nuisances=nuisances, effects=effects)

    def completed(self, at: Linearisation, more: Sequence[Candidate] = ()) -> Jacobian:
        """With the derivatives that are missing for the model's own parameters and for ``more`` effects.

        An effect for which the model has no solution gets a column of zeros.
        """
        effects = dict(self.effects)
        for candidate in (*at.point.candidates, *more):
            if candidate.key not in effects:
                found = at.effect_column(candidate)
                usable = found is not None and np.isfinite(found).all()
                effects[candidate.key] = found if found is not None and usable else np.zeros(at.problem.rows)
        nuisances = at.nuisance_columns(None, effects) if self.nuisances is None else self.nuisances
        states = at.state_columns() if self.states is None else self.states
        return Jacobian(states=states, nuisances=nuisances, effects=effects)

    def shared(self, candidates: Sequence[Candidate]) -> np.ndarray:
        """(M, N + E) derivatives by the nuisances and by the sizes of ``candidates``; all must be there."""
        if self.nuisances is None:
            raise ValueError("the fit has no derivatives by its nuisances: descend first")
        return np.column_stack([self.nuisances, self.of(candidates)])

    def of(self, candidates: Sequence[Candidate]) -> np.ndarray:
        """(M, E) derivatives by the sizes of ``candidates``; all must be there."""
        rows = len(self.window_states())
        return np.column_stack([np.empty((rows, 0)), *(self.effects[c.key] for c in candidates)])
