"""The model fitted to a log by multiple shooting: window states, nuisances and sizes of effects together.

Every window has its own start, which is eliminated window by window; what all windows share (n, the healthy
imperfections of the sensors, the timing of the inputs within half a sample, sizes of effects) stays. The
result is a small normal matrix with a score: all that screening and search need.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.discrepancy.noise import Whitener
from estimators.discrepancy.nuisances import NUISANCES, acts, wheelbase, with_nuisances
from estimators.discrepancy.road import healthy_residuals, widening
from estimators.discrepancy.run_model import RunModel
from offroad_env.effects import EFFECTS, Setup, apply
from offroad_env.errors import OffroadError, SolverFailure

__all__ = ["Candidate", "Fit", "Shares", "fit_runs", "settle"]


#: Belief about a size, in plausible sizes: loose enough to change no result.
_LOOSE = 100.0
#: Finite differences: share of a state's spread, and of an effect's plausible size. On bumps they hold
#: only as far as the vehicle stays within a hand of where it was.
_STATE_STEP, _SIZE_STEP = 0.001, 1e-4
_ROUNDS, _ROUGHLY = 8, 3
#: Passes of descending and learning the noise; the gain of a pass that ends them, in the log-likelihood.
_PASSES, _SETTLED = 6, 1.0
#: What a step promises and does not keep, above which the point is no minimum.
_STALLED = 10.0
#: A step that promises more than this share of what the one before did, and so much at all, asks for new
#: derivatives.
_SLOW, _STAKE = 0.2, 1.0
#: Shares of a step that are tried until one pays.
_SHARES = (1.0, 0.5, 0.2, 0.05)


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An effect at one place of the route, whose size is sought."""

    effect: str
    place: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple:
        """Tells candidates apart."""
        return (self.effect, *sorted(self.place.items()))

    def values(self, size: float) -> dict[str, float]:
        """Parameters of the effect at this size, held within what the model bears."""
        parameter = EFFECTS[self.effect].size
        return {parameter.name: min(max(size, parameter.low), parameter.high), **self.place}


@dataclass(kw_only=True)
class Shares:
    """What the windows share at one point, and the whitened normal equations about it."""

    normal: np.ndarray  #: (g, g) Fisher information of nuisances, then columns of effects
    score: np.ndarray  #: (g,)
    cost: float  #: half the squared whitened residual that window states cannot take away

    def alike(self, count: int) -> np.ndarray:
        """How much each two of the last ``count`` parameters hang together, 0 to 1; 0 with themselves."""
        spread = np.linalg.inv(self.normal)[len(self.normal) - count :, len(self.normal) - count :]
        deviation = np.sqrt(np.diag(spread))
        return np.abs(spread / np.outer(deviation, deviation) - np.eye(count))


class Fit:
    """A point (nuisances, sizes, starts), and how the data hang on it.

    Parameters
    ----------
    runs
        Windows that are fitted together.
    candidates
        Effects in the model, with their sizes.
    """

    def __init__(self, runs: Sequence[RunModel]) -> None:
        self.runs = tuple(runs)
        self._coarse_runs = tuple(run.coarse() for run in runs)
        self.offsets = np.concatenate([[0], np.cumsum([len(run.y) for run in runs])])
        self.whitener = Whitener([(run.channels, int(o)) for run, o in zip(runs, self.offsets, strict=False)])
        self.window = self._window_of_rows()
        self.nuisances = np.zeros(len(NUISANCES))
        self.candidates: tuple[Candidate, ...] = ()
        self.sizes = np.empty(0)
        self.starts: list[np.ndarray] = []
        self.warm: list[np.ndarray] = []
        self._simulated: tuple | None = None  #: the point that was simulated last
        # Derivatives of the data, taken at a point not far away.
        self._states: np.ndarray | None = None
        self._by_nuisances: np.ndarray | None = None
        self._by_sizes: dict[tuple, np.ndarray] = {}
        # Residuals of runs with nothing wrong on an unknown road, plain and whitened.
        self.drawn: np.ndarray | None = None
        self._healthy: np.ndarray | None = None
        self._widenings: np.ndarray | None = None

    def branch(self) -> Fit:
        """A copy that may go elsewhere."""
        other = copy.copy(self)
        other.nuisances, other.sizes = self.nuisances.copy(), self.sizes.copy()
        other.starts = [start.copy() for start in self.starts]
        other.whitener = copy.copy(self.whitener)
        other.whitener.noise = dict(self.whitener.noise)
        other._by_sizes = dict(self._by_sizes)
        return other

    def with_effects(self, candidates: Sequence[Candidate], sizes: Sequence[float]) -> Fit:
        """A copy with these effects, and no others, in the model."""
        other = self.branch()
        other.candidates = tuple(candidates)
        low, high = (limit[len(NUISANCES) :] for limit in other._limits())
        other.sizes = np.clip(np.array(sizes, dtype=np.float64), low, high)
        return other

    @property
    def hard(self) -> bool:
        """Whether the ground is hard."""
        return self.runs[0].setup.plant.soil.rigid > 0.5

    def _window_of_rows(self) -> np.ndarray:
        """Number of the window of every row of data, over all runs."""
        parts, before = [], 0
        for run in self.runs:
            own = np.empty(len(run.y), dtype=np.int64)
            for channel in run.channels:
                own[channel.rows] = channel.window + before
            parts.append(own)
            before += len(run.windows)
        return np.concatenate(parts)

    # ------------------------------------------------------------------ the model at a point

    def setup(self, run: RunModel, nuisances: np.ndarray, sizes: np.ndarray) -> Setup:
        """The vehicle, soil, inputs and sensors at a point."""
        setup = with_nuisances(run, nuisances)
        pairs = zip(self.candidates, sizes, strict=True)
        return apply(setup, [(c.effect, c.values(float(size))) for c, size in pairs])

    def _predict(self, setups: Sequence[Setup], starts: Sequence[np.ndarray], kept: list | None = None):
        """Predicted data of all runs; ``kept`` receives the records."""
        parts = []
        for run, setup, start, warm in zip(self.runs, setups, starts, self.warm, strict=True):
            records = run.simulate(setup, start, warm, run.windows)
            if kept is not None:
                kept.append(records)
            parts.append(run.predict(setup, records))
        return np.concatenate(parts)

    def _setups(self, nuisances: np.ndarray | None = None, sizes: np.ndarray | None = None) -> list[Setup]:
        nuisances = self.nuisances if nuisances is None else nuisances
        sizes = self.sizes if sizes is None else sizes
        return [self.setup(run, nuisances, sizes) for run in self.runs]

    def _residual(self, prediction: np.ndarray) -> np.ndarray:
        pairs = zip(self.runs, self.offsets, strict=False)
        return np.concatenate([run.residual(prediction[o : o + len(run.y)]) for run, o in pairs])

    def begin(self) -> None:
        """Starts of all windows from the sensors, at the present point.

        Raises
        ------
        SolverFailure
            When the model cannot be run at all.
        """
        pairs = [run.first_starts(setup) for run, setup in zip(self.runs, self._setups(), strict=True)]
        self.starts, self.warm = [p[0] for p in pairs], [p[1] for p in pairs]
        self._centre = [start.copy() for start in self.starts]
        self._states = self._by_nuisances = None

    # ------------------------------------------------------------------ derivatives

    def residual(self) -> np.ndarray:
        """Measured less predicted at the present point, (M,)."""
        point = self._point()
        if point != self._simulated:
            self._simulated = None
            self._records: list = []
            self._prediction = self._predict(self._setups(), self.starts, self._records)
            self._coarse_prediction: np.ndarray | None = None
            self._simulated = point
        return self._residual(self._prediction)

    def _point(self) -> tuple:
        """Everything that a simulation hangs on."""
        numbers = (self.nuisances, self.sizes, *self.starts, *self.warm)
        return (self.runs, self.candidates, *(values.tobytes() for values in numbers))

    def _derivative(self, setups: Sequence[Setup], starts: Sequence[np.ndarray], step: float) -> np.ndarray:
        """Change of the data from the present point to another, over ``step``.

        Both ends with the coarse solver: its error is nearly the same at both.
        """
        if self._coarse_prediction is None:
            self._coarse_prediction = self._coarsely(self._setups(), self.starts)
        return self._difference(self._coarse_prediction, self._coarsely(setups, starts), step)

    def _coarsely(self, setups: Sequence[Setup], starts: Sequence[np.ndarray]) -> np.ndarray:
        parts = zip(self._coarse_runs, setups, starts, self.warm, strict=True)
        return np.concatenate([r.predict(s, r.simulate(s, x, warm, r.windows)) for r, s, x, warm in parts])

    def _sensed(self, setups: Sequence[Setup], step: float) -> np.ndarray:
        """Change of the data where the vehicle moves the same but its sensors differ, over ``step``.

        Where the wheels turn as measured, their sensors move the vehicle.
        """
        if any(run.moved_by(s, own) for run, s, own in zip(self.runs, setups, self._setups(), strict=True)):
            return self._derivative(setups, self.starts, step)
        parts = zip(self.runs, setups, self._records, strict=True)
        prediction = np.concatenate([run.predict(setup, records) for run, setup, records in parts])
        return self._difference(self._prediction, prediction, step)

    def _difference(self, before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
        return (self._residual(before) - self._residual(after)) / step

    def state_columns(self) -> np.ndarray:
        """Derivatives of the data by the free states of their own window, (M, S)."""
        setups, columns = self._setups(), []
        for j in range(len(self.runs[0].free)):
            starts = [start.copy() for start in self.starts]
            steps = [_STATE_STEP * run.spread[j] for run in self.runs]
            for start, run, step in zip(starts, self.runs, steps, strict=True):
                start[:, run.free[j]] += step
            columns.append(self._derivative(setups, starts, steps[0]))
        return np.stack(columns, axis=1)

    def nuisance_columns(self) -> np.ndarray:
        """Derivatives of the data by the nuisances, (M, len(NUISANCES))."""
        columns = []
        for i, nuisance in enumerate(NUISANCES):
            point = self.nuisances.copy()
            point[i] += nuisance.step
            if not any(acts(nuisance, run) for run in self.runs):
                columns.append(np.zeros(len(self.window)))
                continue
            setups = self._setups(point)
            if nuisance.sensors_only:
                columns.append(self._sensed(setups, nuisance.step))
            else:
                columns.append(self._derivative(setups, self.starts, nuisance.step))
        return np.stack(columns, axis=1)

    def effect_column(self, candidate: Candidate) -> np.ndarray | None:
        """Derivative of the data by the size of an effect, (M,); None where the model breaks down.

        At its present size; at its off-value, if it is not in the model.
        """
        effect = EFFECTS[candidate.effect]
        step = _SIZE_STEP * effect.plausible(self.runs[0].setup.plant.vehicle)
        before, sizes = self.candidates, self.sizes
        try:
            if candidate in before:
                moved = sizes.copy()
                moved[before.index(candidate)] += step
            else:
                self.candidates, moved = (*before, candidate), np.append(sizes, effect.size.off + step)
            setups = self._setups(sizes=moved)
        except OffroadError:
            return None
        finally:
            self.candidates = before
        try:
            if effect.sensors_only:
                return self._sensed(setups, step)
            return self._derivative(setups, self.starts, step)
        except OffroadError:
            return None

    def linearise(self, *, states: bool = True, shared: bool = True) -> None:
        """Take the derivatives by the states of the windows, and by all that they share, anew.

        The present point must have been simulated last, see `residual`.

        Raises
        ------
        SolverFailure
            Where the model breaks down.
        """
        if states:
            self._states = self.state_columns()
        if not shared:
            return
        self._by_nuisances = self.nuisance_columns()
        # Those of other effects are of another point: on bumps, starts that moved by a hand tell them apart.
        self._by_sizes = {}
        for candidate, size in zip(self.candidates, self.sizes, strict=True):
            column = self.effect_column(candidate)
            if column is None:
                raise SolverFailure(f"the model breaks down near {candidate.effect} = {size:.3g}")
            self._by_sizes[candidate.key] = column

    def forget_shared(self) -> None:
        """Let the derivatives by what all windows share be taken anew when they are asked for."""
        self._by_nuisances, self._by_sizes = None, {}

    def column(self, candidate: Candidate) -> np.ndarray:
        """Derivative by the size of an effect, taken where it was asked for first; 0 where it cannot be."""
        if candidate.key not in self._by_sizes:
            found = self.effect_column(candidate)
            usable = found is not None and np.isfinite(found).all()
            self._by_sizes[candidate.key] = found if usable else np.zeros(len(self.window))
        return self._by_sizes[candidate.key]

    def columns(self) -> np.ndarray:
        """Derivatives by the nuisances and the sizes of the effects in the model, (M, g)."""
        if self._by_nuisances is None:
            self._by_nuisances = self.nuisance_columns()
        return np.column_stack([self._by_nuisances, *(self.column(c) for c in self.candidates)])

    # ------------------------------------------------------------------ normal equations

    def reduce(self, residual: np.ndarray, states: np.ndarray, shared: np.ndarray) -> tuple[Shares, list]:
        """Normal equations of the shared columns with the window states eliminated.

        Arguments are whitened. Columns of ``states`` beyond those of the states are something else that every
        window has for itself, believed to be nought within one. Also returns, per window, what gives their
        change from that of the shared parameters: (offset (S,), slope (S, g)).
        """
        g = shared.shape[1]
        prior, value = np.zeros(g), np.zeros(g)
        if g:
            prior[: len(NUISANCES)] = self.beliefs
            value[: len(NUISANCES)] = self.nuisances
        normal, score = np.diag(prior), -prior * value
        spread = np.array([nuisance.spread for nuisance in NUISANCES])
        cost = 0.5 * float(np.sum((self.nuisances / spread) ** 2))
        back = []
        order = np.argsort(self.window, kind="stable")
        starts = np.concatenate([s[:, run.free] for s, run in zip(self.starts, self.runs, strict=True)])
        centre = np.concatenate([s[:, run.free] for s, run in zip(self._centre, self.runs, strict=True)])
        more = states.shape[1] - starts.shape[1]
        weight = np.append(1.0 / self.runs[0].spread ** 2, np.ones(more))
        away_from = np.column_stack([centre - starts, np.zeros((len(starts), more))])
        # A window in a gap of the log has no rows.
        edges = np.searchsorted(self.window[order], np.arange(len(starts) + 1))
        for w in range(len(starts)):
            rows = order[edges[w] : edges[w + 1]]
            A, G, r = states[rows], shared[rows], residual[rows]
            away = away_from[w]
            inner = A.T @ A + np.diag(weight)
            cross, gradient = A.T @ G, A.T @ r + weight * away
            solved = np.linalg.solve(inner, np.column_stack([gradient, cross]))
            normal += G.T @ G - cross.T @ solved[:, 1:]
            score += G.T @ r - cross.T @ solved[:, 0]
            cost += 0.5 * float(r @ r + away @ (weight * away) - gradient @ solved[:, 0])
            back.append((solved[:, 0], solved[:, 1:]))
        return Shares(normal=normal, score=score, cost=cost), back

    def _moved(self, change: np.ndarray, back: list, share: float) -> tuple[np.ndarray, np.ndarray, list]:
        count, w = len(NUISANCES), 0
        starts = []
        for run, start in zip(self.runs, self.starts, strict=True):
            moved = start.copy()
            for i in range(len(start)):
                offset, slope = back[w]
                moved[i, list(run.free)] += share * (offset - slope @ change)
                w += 1
            starts.append(moved)
        if not len(change):
            return self.nuisances, self.sizes, starts
        point = np.clip(np.concatenate([self.nuisances, self.sizes]) + share * change, *self._limits())
        return point[:count], point[count:], starts

    def cost_of(self, residual: np.ndarray) -> float:
        """Half the squared whitened residual, with what the beliefs about starts and nuisances add."""
        white = self.whitener(residual)
        away = sum(
            float(np.sum(((s - c)[:, run.free] / run.spread) ** 2))
            for s, c, run in zip(self.starts, self._centre, self.runs, strict=True)
        )
        spread = np.array([nuisance.spread for nuisance in NUISANCES])
        return 0.5 * (float(white @ white) + away + float(np.sum((self.nuisances / spread) ** 2)))

    def descend(
        self, rounds: int = _ROUNDS, *, fresh: bool = True, held: bool = False, enough: float = np.inf
    ) -> float:
        """Gauss-Newton; returns the cost. Noise must be known.

        The derivatives serve as long as steps keep what they promise. ``fresh`` takes them anew at the
        beginning; ``held`` moves the starts of the windows alone. A descent whose new derivatives promise no
        cost below ``enough``, were they wrong by half, ends.
        """
        residual = self.residual()
        cost = self.first_cost = self.cost_of(residual)
        self.stalled = False
        if new := fresh or self._states is None:
            self.linearise(shared=not held)
        white = self._whitened(held)
        before = np.inf
        for _ in range(rounds):
            shares, back, change, expected = self._step(residual, white, cost)
            if not new and expected > max(_SLOW * before, _STAKE):
                self.linearise(shared=not held)
                white, new = self._whitened(held), True
                shares, back, change, expected = self._step(residual, white, cost)
            # What is still to gain is not worth a simulation.
            if expected < 0.05 or (new and cost - 2.0 * expected > enough):
                break
            trial = self._try(change, back, cost, _SHARES if expected > _STAKE else _SHARES[:1])
            gain = 0.0 if trial is None else cost - trial[0]
            if trial is not None:
                cost, residual = trial
            if gain < 0.05:
                self.stalled = expected > _STALLED
                if new or expected < _STAKE:
                    break
            new, before = False, expected if trial else 0.0
        self.shares, self._widenings = shares, None
        return cost

    def _step(self, residual: np.ndarray, white: tuple, cost: float) -> tuple:
        """(normal equations, way back to the states, step of the shared parameters, what it promises)."""
        shares, back = self.reduce(self.whitener(residual), *white)
        if len(shares.score):
            self._loosely_bound(shares.normal)
        change = self._inside(shares)
        return shares, back, change, cost - shares.cost + 0.5 * float(shares.score @ change)

    def _inside(self, shares: Shares) -> np.ndarray:
        """Step of the shared parameters that, on hard ground, leaves those at their limits where they are.

        On soil a step is only cut: the one limit there, of the timing, needs no more.
        """
        change = np.linalg.solve(shares.normal, shares.score)
        if not self.hard or not len(change):
            return change
        low, high = self._limits()
        point = np.concatenate([self.nuisances, self.sizes])
        free = np.ones(len(change), dtype=bool)
        while True:
            out = free & (((point >= high) & (change > 0.0)) | ((point <= low) & (change < 0.0)))
            if not out.any():
                return change
            free &= ~out
            change = np.zeros(len(change))
            change[free] = np.linalg.solve(shares.normal[np.ix_(free, free)], shares.score[free])

    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value of every shared parameter."""
        pairs = [n.hard_limits if self.hard and n.hard_limits else n.limits for n in NUISANCES]
        sizes = [EFFECTS[c.effect].size for c in self.candidates]
        low, high = np.array([*pairs, *((size.low, size.high) for size in sizes)], dtype=np.float64).T
        return low, high

    def _whitened(self, held: bool) -> tuple[np.ndarray, np.ndarray]:
        shared = np.empty((len(self.window), 0)) if held else self.columns()
        return self.whitener(self._states), self.whitener(shared)

    @property
    def beliefs(self) -> np.ndarray:
        """Information about the nuisances before any data."""
        return np.array([1.0 / nuisance.spread**2 for nuisance in NUISANCES])

    def _loosely_bound(self, normal: np.ndarray) -> None:
        """Sizes that the data do not show - a brake's in a run without brakes - must stay solvable."""
        vehicle = self.runs[0].setup.plant.vehicle
        for i, candidate in enumerate(self.candidates, len(NUISANCES)):
            normal[i, i] += 1.0 / (_LOOSE * EFFECTS[candidate.effect].plausible(vehicle)) ** 2

    def _try(self, change: np.ndarray, back: list, cost: float, shares: Sequence[float]):
        """Go as far along the step as it pays: (cost, residual) there; None if it does not."""
        point = (self.nuisances, self.sizes, self.starts)
        before = (self._simulated, self._records, self._prediction, self._coarse_prediction)
        for share in shares:
            self.nuisances, self.sizes, self.starts = self._moved(change, back, share)
            try:
                residual = self.residual()
            except OffroadError:
                residual = None
            if residual is not None and (reached := self.cost_of(residual)) < cost:
                return reached, residual
            self.nuisances, self.sizes, self.starts = point
        self._simulated, self._records, self._prediction, self._coarse_prediction = before
        return None

    # ------------------------------------------------------------------ noise

    def without_states(self, table: np.ndarray) -> np.ndarray:
        """Whitened columns (M, k) less what the starts of the windows can take away."""
        out, states = table.copy(), self.whitener(self._states)
        weight = np.diag(1.0 / self.runs[0].spread ** 2)
        for w in range(int(self.window.max()) + 1):
            rows = np.flatnonzero(self.window == w)
            A = states[rows]
            out[rows] -= A @ np.linalg.solve(A.T @ A + weight, A.T @ table[rows])
        return out

    @property
    def healthy(self) -> np.ndarray | None:
        """Whitened residuals of runs with nothing wrong, (M, K), less what starts take away; see `road`."""
        if self._healthy is None and self.drawn is not None:
            self._healthy = self.without_states(self.whitener(self.drawn))
        return self._healthy

    def freedom(self, states: np.ndarray) -> dict[str, float]:
        """How many parameters each channel has paid for: the trace of the window states' hat matrix."""
        white = self.whitener(states)
        leverage = np.zeros(len(white))
        weight = np.diag(1.0 / self.runs[0].spread ** 2)
        for w in range(int(self.window.max()) + 1):
            rows = np.flatnonzero(self.window == w)
            A = white[rows]
            leverage[rows] = np.einsum("ij,ji->i", A, np.linalg.solve(A.T @ A + weight, A.T))
        return {
            name: float(sum(leverage[piece].sum() for piece in pieces))
            for name, pieces in self.whitener.pieces.items()
        }

    def widenings(self) -> np.ndarray:
        """By how much an unknown road scatters each nuisance and size more than `shares` says, at least 1."""
        if self._widenings is None:
            self._widenings = widening(self, self.whitener(self.columns()), 0, self.beliefs)
        return self._widenings

    def deviations(self) -> np.ndarray:
        """Standard deviations of nuisances and sizes, of the last `descend`."""
        own = np.diag(np.linalg.inv(self.shares.normal))
        return np.sqrt(own if self.drawn is None else own * self.widenings())

    def healthy_values(self) -> dict[str, float]:
        """What the fit makes of each nuisance, in the nuisance's own unit."""
        pairs = zip(NUISANCES, self.nuisances, strict=True)
        return {nuisance.name: float(value) for nuisance, value in pairs if acts(nuisance, self.runs[0])}

    def unknowns(self) -> dict[str, dict[str, float | str]]:
        """What the log calls unknown as the fit has it: value, deviation and unit, by name."""
        found = {}
        for nuisance, value, deviation in zip(NUISANCES, self.nuisances, self.deviations(), strict=False):
            if nuisance.unknown and acts(nuisance, self.runs[0]):
                scale = wheelbase(self.runs[0]) if nuisance.unit == "m" else 1.0
                numbers = {"value": float(scale * value), "deviation": float(scale * deviation)}
                found[nuisance.name] = {**numbers, "unit": nuisance.unit}
        return found

    def learn_noise(self, *, white: bool = False) -> None:
        """Set the whitening from the residuals at the present point."""
        residual = self.residual()
        freedom = self.freedom(self._states) if self._states is not None and self.whitener.noise else {}
        self.whitener.learn(residual, freedom, white=white)
        self._healthy = None


def fit_runs(runs: Sequence[RunModel], *, white: bool = False) -> Fit:
    """The nominal model fitted: starts, nuisances and the colour of the noise."""
    fit = _fitted(runs, white=white, wide=False)
    if fit.hard or not fit.converged:
        # Far from the data, noise as small as the sensors' leads into the nearest valley. On hard ground
        # that may hold: tyres at a limit of their stiffness turn the car late, too.
        other = _fitted(runs, white=white, wide=True)
        fit = min(fit, other, key=lambda each: each.cost_of(each.residual()) + each.whitener.log_scale())
    fit.residual()
    fit.drawn = None if white else healthy_residuals(fit)
    return fit


def _fitted(runs: Sequence[RunModel], *, white: bool, wide: bool) -> Fit:
    fit = Fit(runs)
    fit.begin()
    first_noise(fit, wide=wide)
    # Once more from the starts that a ground about right leads to: no sensor may have told the speed.
    fit.descend(_ROUGHLY)
    fit.begin()
    settle(fit, white=white)
    return fit


def settle(fit: Fit, *, white: bool = False) -> None:
    """Descend and learn the noise in turn, until neither changes much."""
    fit.converged = False
    for i in range(_PASSES):
        reached = fit.descend(fresh=i == 0)
        if i > 0 and fit.first_cost - reached < _SETTLED:
            fit.converged = not fit.stalled
            break
        fit.learn_noise(white=white)
    fit.learn_noise(white=white)
    # All derivatives at the point that is reached: scores project one kind from the other.
    fit.descend()


def first_noise(fit: Fit, *, wide: bool = False) -> None:
    """White noise as small as the second differences of every channel say; ``wide``: as the start errs."""
    from estimators.discrepancy.noise import ChannelNoise

    if wide:
        residual = fit.residual()
        for name, pieces in fit.whitener.pieces.items():
            own = np.concatenate([residual[piece] for piece in pieces])
            fit.whitener.noise[name] = ChannelNoise.white(max(float(np.sqrt(np.mean(own**2))), 1e-6))
        return
    y = np.concatenate([run.y for run in fit.runs])
    for name, pieces in fit.whitener.pieces.items():
        bends = np.concatenate([np.diff(y[piece], 2) for piece in pieces if piece.stop - piece.start > 2])
        spread = 1.4826 * float(np.median(np.abs(bends))) / np.sqrt(6.0) if len(bends) else 0.0
        fit.whitener.noise[name] = ChannelNoise.white(max(spread, 1e-6))
