"""Several runs with common parameters as one least-squares problem: rows, windows, priors, limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from estimators.discrepancy.model.nuisances import acts, ground_changed, with_nuisances
from estimators.discrepancy.model.parameters import Candidate, Point
from estimators.discrepancy.model.protocol import ForwardModel, Records
from offroad_env.effects import EFFECTS, Setup, apply

__all__ = ["LeastSquaresProblem"]

#: Prior of a size, in plausible sizes: loose enough to change no result.
_LOOSE = 100.0


class LeastSquaresProblem:
    """Runs that are fitted together.

    The same class serves drives and trials: what differs between them is in the `ForwardModel` of a run,
    which also names the nuisances.

    Parameters
    ----------
    runs
        One or more, all of one kind.
    """

    def __init__(self, runs: Sequence[ForwardModel]) -> None:
        self.runs = tuple(runs)
        self.coarse_runs = tuple(run.coarse() for run in runs)
        self.rough_runs = tuple(run.rough() for run in runs)
        self.nuisances = self.runs[0].nuisances
        #: First row of the data of every run, and the number of rows.
        self.offsets = np.concatenate([[0], np.cumsum([len(run.y) for run in runs])])
        self.window = self._window_of_rows()  #: (M,) number of the window of every row, over all runs
        #: Number of nuisances: the first columns of the shared parameters.
        self.nuisance_count = len(self.nuisances)
        self.nuisance_spread = np.array([nuisance.spread for nuisance in self.nuisances])
        #: (N,) information about the nuisances before any data.
        self.nuisance_information = np.array([1.0 / nuisance.spread**2 for nuisance in self.nuisances])
        #: (W, S) information about the free states of every window before any data, over all runs.
        self.state_information = 1.0 / np.concatenate([run.spread for run in runs]) ** 2
        self.window_rows = self._rows_of_windows()

    @cached_property
    def rough(self) -> LeastSquaresProblem:
        """The same with the rough solver: enough to compare points that are far apart."""
        return LeastSquaresProblem(self.rough_runs)

    def _window_of_rows(self) -> np.ndarray:
        parts, before = [], 0
        for run in self.runs:
            own = np.empty(len(run.y), dtype=np.int64)
            for channel in run.channels:
                own[channel.rows] = channel.window + before
            parts.append(own)
            before += len(run.windows)
        return np.concatenate(parts)

    def _rows_of_windows(self) -> tuple[np.ndarray, ...]:
        """Rows of every window, over all runs; a window in a gap of the log has none."""
        count = sum(len(run.windows) for run in self.runs)
        order = np.argsort(self.window, kind="stable")
        edges = np.searchsorted(self.window[order], np.arange(count + 1))
        return tuple(order[edges[w] : edges[w + 1]] for w in range(count))

    @property
    def rows(self) -> int:
        """Number of samples of all runs."""
        return len(self.window)

    @property
    def hard(self) -> bool:
        """Whether the ground is hard."""
        return self.runs[0].setup.plant.soil.rigid > 0.5

    @property
    def bounded(self) -> bool:
        """Whether parameters stay where their limits stop them: on hard ground, and in trials."""
        return self.hard or self.renews_derivatives

    @property
    def renews_derivatives(self) -> bool:
        """Whether every step of a descent takes new derivatives."""
        return self.runs[0].renews_derivatives

    def refined(self) -> LeastSquaresProblem:
        """The same with a finer solver."""
        return LeastSquaresProblem([run.refined() for run in self.runs])

    # ------------------------------------------------------------------ parameters

    def stated(
        self,
        candidates: Sequence[Candidate] = (),
        sizes: Sequence[float] = (),
        n: float | None = None,
    ) -> Point:
        """Everything as stated and effects of these sizes, without starts yet.

        ``n`` : another sinkage exponent in all runs; hard ground stays as it is.
        """
        values = np.zeros(self.nuisance_count)
        for i, nuisance in enumerate(self.nuisances):
            run = next((run for run in self.runs if acts(nuisance, run)), None)
            if n is not None and nuisance.change is ground_changed and run is not None and not self.hard:
                values[i] = n - run.setup.plant.soil.n
        own = np.array(sizes, dtype=float)
        return Point(nuisances=values, candidates=tuple(candidates), sizes=own, starts=(), warm=(), centre=())

    def exponent(self, point: Point) -> float:
        """The sinkage exponent of the first run."""
        return float(self.setup(self.runs[0], point).plant.soil.n)

    def begun(self, point: Point) -> Point:
        """Starts of all windows from the sensors, the other parameters as they are.

        Raises
        ------
        SolverFailure
            When the model cannot be run at all.
        """
        pairs = [run.first_starts(setup) for run, setup in zip(self.runs, self.setups(point), strict=True)]
        starts = tuple(states for states, _ in pairs)
        return replace(point, starts=starts, warm=tuple(warm for _, warm in pairs), centre=starts)

    def limits(self, candidates: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value of every shared parameter, (N + E,) each."""
        pairs = [n.hard_limits if self.hard and n.hard_limits else n.limits for n in self.nuisances]
        sizes = [self.runs[0].size_limits(c.effect) for c in candidates]
        low, high = np.array([*pairs, *sizes], dtype=np.float64).T
        return low, high

    def size_information(self, candidates: Sequence[Candidate]) -> np.ndarray:
        """(E,) weak prior information: sizes that the data do not show must stay solvable."""
        vehicle = self.runs[0].setup.plant.vehicle
        return np.array([1.0 / (_LOOSE * EFFECTS[c.effect].plausible(vehicle)) ** 2 for c in candidates])

    def free_states(self, states: Sequence[np.ndarray]) -> np.ndarray:
        """(W, S) free states of all windows."""
        return np.concatenate([own[:, run.free] for own, run in zip(states, self.runs, strict=True)])

    def start_prior_cost(self, point: Point) -> float:
        """Half the squared distance of the starts from their prior, in standard deviations."""
        return 0.5 * sum(
            float(np.sum(((s - c)[:, run.free] / run.spread) ** 2))
            for s, c, run in zip(point.starts, point.centre, self.runs, strict=True)
        )

    def nuisance_prior_cost(self, point: Point) -> float:
        """The same of the nuisances."""
        return 0.5 * float(np.sum((point.nuisances / self.nuisance_spread) ** 2))

    # ------------------------------------------------------------------ model

    def setups(self, point: Point) -> tuple[Setup, ...]:
        """Vehicle, soil, inputs and sensors of every run at a point."""
        return tuple(self.setup(run, point) for run in self.runs)

    def setup(self, run: ForwardModel, point: Point) -> Setup:
        """The same of one run, which need not be among those fitted."""
        pairs = zip(point.candidates, point.sizes, strict=True)
        effects = [(c.effect, c.values(float(size))) for c, size in pairs]
        return apply(with_nuisances(run, point.nuisances), effects)

    def simulated(self, point: Point, setups: Sequence[Setup]) -> tuple[tuple[Records, ...], np.ndarray]:
        """Records and predicted samples (M,) of all runs from the starts of a point."""
        parts = zip(self.runs, setups, point.starts, point.warm, strict=True)
        records = tuple(run.simulate(setup, x, warm, run.windows) for run, setup, x, warm in parts)
        return records, self.predicted(setups, records)

    def predicted(self, setups: Sequence[Setup], records: Sequence[Records]) -> np.ndarray:
        """Samples (M,) that the sensors should read."""
        parts = zip(self.runs, setups, records, strict=True)
        return np.concatenate([run.predict(setup, own) for run, setup, own in parts])

    def predicted_coarsely(
        self,
        setups: Sequence[Setup],
        starts: Sequence[np.ndarray],
        warm: Sequence[np.ndarray],
        *,
        rough: bool = False,
    ) -> np.ndarray:
        """The same with the coarse solver, or the rough one."""
        parts = zip(self.rough_runs if rough else self.coarse_runs, setups, starts, warm, strict=True)
        return np.concatenate([r.predict(s, r.simulate(s, x, own, r.windows)) for r, s, x, own in parts])

    def residual(self, prediction: np.ndarray) -> np.ndarray:
        """Measured less predicted, (M,)."""
        pairs = zip(self.runs, self.offsets, strict=False)
        return np.concatenate([run.residual(prediction[o : o + len(run.y)]) for run, o in pairs])
