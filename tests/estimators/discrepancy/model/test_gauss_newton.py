"""The descent of a fit and its normal equations, on a model that is linear in all its parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.model.autoregressive_noise import AutoregressiveNoise
from estimators.discrepancy.model.fit import stretches_of
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.normal_equations import projected, reduced, without_states
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.protocol import Channel, Nuisance, Records
from estimators.discrepancy.model.windows import FIT, Windows
from offroad_env.errors import SolverFailure

_WINDOWS, _SAMPLES = 3, 40
_TRUTH = {"slope": 0.3, "curve": -0.2}


@dataclass(frozen=True)
class _Setup:
    """A setup of two numbers; `hard` ground keeps them within their limits."""

    slope: float = 0.0
    curve: float = 0.0
    rigid: float = 0.0
    inputs: None = None

    @property
    def plant(self):
        return SimpleNamespace(soil=SimpleNamespace(rigid=self.rigid), vehicle=None)


def _nuisance(name: str, **limits) -> Nuisance:
    def change(setup, run, value):
        return replace(setup, **{name: getattr(setup, name) + value})

    return Nuisance(name=name, change=change, spread=1.0, step=1e-3, **limits)


@dataclass
class _Line:
    """Data = start + slope s + curve s^2 in every window, with or without noise; a `ForwardModel`."""

    noise: float = 0.0
    rigid: float = 0.0
    renews_derivatives: bool = False
    steepest: float = np.inf  #: beyond this slope there is no solution
    calls: list = field(default_factory=list)
    free, spread, step, period, driven = (0,), np.full((_WINDOWS, 1), 10.0), 0.1, 0.1, True
    nuisances = (_nuisance("slope", hard_limits=(-0.1, 0.1)), _nuisance("curve"))

    def __post_init__(self):
        self.setup = _Setup(rigid=self.rigid)
        self.log = SimpleNamespace(config=SimpleNamespace(unknown=(), terrain=SimpleNamespace(kind="flat")))
        self.windows = Windows(
            first=np.arange(_WINDOWS), count=np.full(_WINDOWS, _SAMPLES), use=np.full(_WINDOWS, FIT)
        )
        self.window = np.repeat(np.arange(_WINDOWS), _SAMPLES)
        self.s = np.tile(np.linspace(0.0, 4.0, _SAMPLES), _WINDOWS)
        rows = len(self.s)
        channel = Channel(
            name="a_x", rows=slice(0, rows), t=0.1 * np.arange(rows), window=self.window,
            record=np.arange(rows), weight=np.zeros(rows),
        )  # fmt: skip
        self.channels = (channel,)
        rng = np.random.default_rng(3)
        clean = self.predict(_Setup(**_TRUTH), Records(states=np.array([[1.0], [2.0], [3.0]]), readings=None))
        self.y = clean + self.noise * rng.standard_normal(rows)

    def coarse(self):
        return self

    def rough(self):
        return self

    def displaced(self, setup, records, state, by):
        return None

    def first_starts(self, setup):
        return np.zeros((_WINDOWS, 1)), np.zeros((_WINDOWS, 2, 3))

    def moved_by(self, setup, other):
        return False

    def simulate(self, setup, starts, warm, windows):
        self.calls.append(setup)
        if abs(setup.slope) > self.steepest:
            raise SolverFailure("no solution")
        return Records(states=starts, readings=np.empty((0, 0)))

    def predict(self, setup, records):
        return records.states[self.window, 0] + setup.slope * self.s + setup.curve * self.s**2

    def residual(self, prediction):
        return self.y - prediction


@dataclass
class _Jittery(_Line):
    """Its rough solver's error changes with every parameter."""

    jitter: float = 0.0
    accurate: bool = True

    def rough(self):
        return replace(self, accurate=False)

    def predict(self, setup, records):
        error = self.jitter * np.sin(1e6 * (setup.slope + setup.curve + records.states[self.window, 0]))
        return super().predict(setup, records) + (0.0 if self.accurate else error)


def _start(run: _Line, deviation: float = 0.1) -> FitResult:
    problem = LeastSquaresProblem([run])
    first = Linearisation.at(problem, problem.begun(problem.stated()))
    noise = stretches_of(problem).with_white({"a_x": deviation})
    return FitResult(linearisation=first, jacobian=Jacobian(), noise=noise)


def _dense(run: _Line, deviation: float) -> tuple[np.ndarray, np.ndarray]:
    """(normal matrix, solution) of all parameters at once: nuisances, then starts, with their priors."""
    starts = (run.window[:, None] == np.arange(_WINDOWS)).astype(float)
    table = np.column_stack([run.s, run.s**2, starts]) / deviation
    prior = np.array([1.0, 1.0, *[1.0 / 10.0**2] * _WINDOWS])
    normal = table.T @ table + np.diag(prior)
    return normal, np.linalg.solve(normal, table.T @ run.y / deviation)


def test_eliminated_windows_leave_the_solution_of_all_parameters_together():
    run = _Line(noise=0.1)
    normal, solution = _dense(run, 0.1)
    fit = GaussNewton().descend(_start(run))
    assert fit.nuisances == pytest.approx(solution[:2], rel=1e-6)
    assert fit.point.starts[0][:, 0] == pytest.approx(solution[2:], rel=1e-6)
    assert fit.normal_equations.covariance == pytest.approx(np.linalg.inv(normal)[:2, :2], rel=1e-6)
    assert fit.deviations() == pytest.approx(np.sqrt(np.diag(np.linalg.inv(normal))[:2]), rel=1e-6)


def test_eliminating_parameters_one_after_the_other_is_eliminating_them_together():
    rng = np.random.default_rng(1)
    table = rng.standard_normal((30, 5))
    normal, score = table.T @ table, rng.standard_normal(5)
    once = projected(normal, score, 3)
    twice = projected(*projected(normal, score, 1), 2)
    assert all(np.allclose(a, b) for a, b in zip(once, twice, strict=True))
    assert np.allclose(np.linalg.solve(*once), np.linalg.solve(normal, score)[3:])


def test_what_the_starts_can_take_away_is_gone_from_residuals():
    fit = GaussNewton().descend(_start(_Line()))
    constant = np.repeat([1.0, -2.0, 0.5], _SAMPLES)[:, None]
    left = without_states(fit.problem, fit.white_states, constant / 0.1)
    assert np.abs(left).max() < 1e-3 * np.abs(constant / 0.1).max()


def test_further_parameters_of_a_window_widen_the_shared_ones():
    """An unknown input in every window takes information from a slope that it can imitate."""
    run = _Line(noise=0.1)
    fit = GaussNewton().descend(_start(run))
    residual, shared = fit.noise.whiten(fit.residual), fit.white_shared()
    unknown = fit.noise.whiten(run.s[:, None])
    joint = reduced(fit.problem, fit.point, residual, np.column_stack([fit.white_states, unknown]), shared)
    alone, wider = (np.diag(equations.covariance) for equations in (fit.normal_equations, joint))
    assert wider[0] > 10.0 * alone[0]


def test_held_parameters_stay_and_the_starts_move():
    fit = GaussNewton(held=True).descend(_start(_Line()))
    assert np.array_equal(fit.nuisances, [0.0, 0.0])
    assert fit.cost < fit.first_cost
    assert not np.array_equal(fit.point.starts[0], np.zeros((_WINDOWS, 1)))


def test_on_hard_ground_a_parameter_stays_within_its_limits_and_the_others_make_up_for_it():
    fit = GaussNewton().descend(_start(_Line(rigid=1.0)))
    assert fit.nuisances[0] == pytest.approx(0.1)
    free = GaussNewton().descend(_start(_Line()))
    assert free.nuisances == pytest.approx([0.3, -0.2], abs=1e-3)
    assert fit.nuisances[1] > free.nuisances[1]


@pytest.mark.parametrize(("renews", "fewer"), [(False, True), (True, False)])
def test_derivatives_of_a_linear_model_are_taken_once_unless_every_step_renews_them(renews, fewer):
    run = _Line(noise=0.1, renews_derivatives=renews)
    fit = GaussNewton().descend(_start(run))
    assert fit.nuisances == pytest.approx([0.3, -0.2], abs=0.05)
    # One derivative by the states and two by nuisances; the coarse model is the same.
    assert (len(run.calls) <= 1 + 3 + 2) is fewer


@pytest.mark.parametrize(("jitter", "noisy"), [(0.0054, False), (0.0075, True), (0.3, True)])
def test_where_the_rough_solver_errs_otherwise_at_the_ends_of_a_difference_all_are_accurate(jitter, noisy):
    there, exact = (_start(run).linearisation for run in (_Jittery(jitter=jitter), _Line()))
    assert there._noisy is noisy
    assert np.array_equal(there.nuisance_columns(), exact.nuisance_columns()) is noisy
    assert np.array_equal(there.state_columns(), exact.state_columns()) is noisy


@pytest.mark.parametrize(("jitter", "noisy"), [(0.55, False), (0.8, True)])
def test_an_error_that_is_little_beside_the_change_itself_is_none(jitter, noisy):
    run = _Jittery(jitter=jitter)
    run.nuisances = tuple(replace(nuisance, step=0.3) for nuisance in run.nuisances)
    assert _start(run).linearisation._noisy is noisy


def test_a_fit_ends_at_the_minimum_although_the_rough_solver_jitters():
    fit = GaussNewton().descend(_start(_Jittery(jitter=0.3)))
    assert fit.nuisances == pytest.approx([0.3, -0.2], abs=1e-3)
    assert not fit.stalled


def test_a_descent_into_points_without_a_solution_stays_where_it_is():
    start = _start(_Line(steepest=0.01))
    fit = GaussNewton().descend(start)
    assert fit.cost == start.cost
    assert fit.stalled


def test_a_fit_that_was_not_descended_has_no_uncertainty():
    with pytest.raises(ValueError, match="descend first"):
        _start(_Line()).deviations()
    with pytest.raises(ValueError, match="descend first"):
        Jacobian().window_states()


def test_noise_is_learned_with_the_freedom_that_the_windows_have_left():
    fit = GaussNewton().descend(_start(_Line(noise=0.1)))
    learned = replace(fit, white=True).with_learned_noise()
    assert isinstance(learned.noise, AutoregressiveNoise)
    spent = _WINDOWS * _SAMPLES / (_WINDOWS * _SAMPLES - _WINDOWS)
    expected = np.sqrt(np.mean(fit.residual**2) * spent)
    assert learned.noise.channels["a_x"].deviation[0] == pytest.approx(expected, rel=1e-3)


def test_a_window_that_jumps_to_another_branch_over_a_tiny_step_spoils_no_derivative(monkeypatch):
    """The second window jumps ahead of the point only, the third on both sides of it."""
    there = _start(_Line(noise=0.1)).linearisation
    window = there.problem.window

    def difference(self, candidate, step):
        jumped = (window == 2) | ((window == 1) & (step > 0.0))
        return np.where(jumped, 5.0 / step, 1.0)

    monkeypatch.setattr(Linearisation, "_effect_difference", difference)
    column = there.effect_column(Candidate(effect="grade"))
    assert column == pytest.approx(np.where(window == 2, 0.0, 1.0))
    # A large effect is the same on both sides.
    monkeypatch.setattr(Linearisation, "_effect_difference", lambda *one: np.full(len(window), 1e6))
    assert there.effect_column(Candidate(effect="grade")) == pytest.approx(np.full(len(window), 1e6))


@dataclass
class _Walled(_Line):
    """No solution either where a window begins beyond a wall, or by the rough solver off the point."""

    wall: float = np.inf

    def simulate(self, setup, starts, warm, windows):
        if np.any(starts > self.wall):
            raise SolverFailure("no solution")
        return super().simulate(setup, starts, warm, windows)


def test_derivatives_at_the_limit_of_what_has_a_solution_are_taken_on_its_side():
    run = _Walled(noise=0.1, steepest=0.5, wall=0.0)
    problem = LeastSquaresProblem([run])
    begun = problem.begun(problem.stated())
    there = Linearisation.at(problem, replace(begun, nuisances=np.array([0.5, 0.0])))
    assert there.nuisance_columns()[:, 0] == pytest.approx(run.s)
    assert there.state_columns()[:, 0] == pytest.approx(np.ones(len(run.s)))
    free = Linearisation.at(LeastSquaresProblem([_Line(noise=0.1)]), there.point)
    assert there.nuisance_columns() == pytest.approx(free.nuisance_columns())
    run.steepest = 0.4
    with pytest.raises(SolverFailure, match="no solution"):
        Linearisation.at(problem, there.point)


def test_an_effect_that_has_a_solution_on_one_side_is_moved_to_that_side(monkeypatch):
    there = _start(_Line(noise=0.1)).linearisation
    monkeypatch.setattr(Linearisation, "_effect_difference", lambda self, c, step: None if step > 0 else step)
    step = there.effect_column(Candidate(effect="grade"))
    assert step < 0.0
    monkeypatch.setattr(Linearisation, "_effect_difference", lambda *one: None)
    assert there.effect_column(Candidate(effect="grade")) is None
