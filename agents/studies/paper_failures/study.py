"""``offroad reproduce causes``: why the paper's filter fails on some rows of its table.

Four experiments with the truth, filter and soil of the table: the terrain read at the wrong place,
starts on both sides of the roots of F_x(n), the information on n in a second of driving, and how far the
forward comparison depends on what the paper does not print.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from agents.reports.output import Results, console, say, table
from agents.studies.paper_failures.records import Drifting, ForwardCell, Information, PhaseError, Start
from estimators.experiments.buzhardt_tallapragada import (
    CHOICES,
    KNOWN_SETTINGS,
    ROWS,
    SETTINGS,
    Row,
    RowTruth,
    forward_comparison,
    noisy_imu,
    row_plant,
    row_truth,
    run_row,
)
from estimators.experiments.imu_sensitivity import ForceCurve, force_curve, information_rate
from estimators.experiments.simulated_rows import REPORT_SEEDS
from estimators.filters.parameter_ukf import ParameterSettings, run_parameter_filter
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import settled_state

__all__ = [
    "Causes",
    "ForwardCell",
    "Information",
    "PhaseError",
    "Start",
    "drifting_runs",
    "forward_map",
    "information_curves",
    "phase_errors",
    "starts",
]

_STRAIGHT, _SMOOTH, _STEERED = ROWS[0], ROWS[1], ROWS[2]
#: What a filter may assume that trusts its propagated state: the sensors' noise.
_TRUSTING = KNOWN_SETTINGS["half_car"]


def phase_errors(shifts: np.ndarray, *, duration: float = 40.0, seed: int = 0) -> list[PhaseError]:
    """MSE of n after 10 s on row 3 when the filter knows its state but reads the terrain elsewhere.

    Nothing else is wrong: heave, pitch, speeds and heading are the truth's.

    Parameters
    ----------
    shifts : array
        Error of the place along X [m]; the terrain repeats after 2 pi m.
    """
    truth = row_truth(_STEERED, duration=duration)
    plant = row_plant(_STEERED)
    start = settled_state(plant, v_x=CHOICES["start_speed"].value)
    imu, late = noisy_imu(truth, seed), truth.run.t >= 10.0

    def error(settings: ParameterSettings, shift: float) -> float:
        states = truth.run.states.copy()
        states[:, at.X] += shift
        run = run_parameter_filter(
            plant, start, truth.inputs, imu, CHOICES["dt"].value, settings, known=states
        )
        return float(np.mean((run.belief.n - truth.n)[late] ** 2))

    return [PhaseError(float(s), error(_TRUSTING, s), error(SETTINGS["half_car"], s)) for s in shifts]


def drifting_runs(*, duration: float = 100.0, seed: int = 0) -> list[Drifting]:
    """Row 1 with a filter that assumes the sensors' noise, its state propagated or known."""
    truth = row_truth(_STRAIGHT, duration=duration)
    runs = []
    for source in ("propagated", "known"):
        run = run_row(_STRAIGHT, source=source, seed=seed, settings=_TRUSTING, truth=truth).filter
        apart = run.states[:, [at.X, at.Y]] - truth.run.states[:, [at.X, at.Y]]
        runs.append(Drifting(source, truth.run.t, run.belief.n, np.hypot(apart[:, 0], apart[:, 1])))
    return runs


def starts(priors: np.ndarray, *, duration: float = 60.0, seed: int = 0) -> list[Start]:
    """Where both filters of the table go on smooth straight clay (row 2) from several first guesses."""
    truth = row_truth(_SMOOTH, duration=duration)
    return [
        Start(model, float(n), truth.run.t, _run_from(float(n), model, truth, seed))
        for model in SETTINGS
        for n in priors
    ]


def _run_from(n: float, model: str, truth: RowTruth, seed: int) -> np.ndarray:
    settings = replace(SETTINGS[model], n_prior=n, n_prior_sd=0.05)
    return run_row(_SMOOTH, model, seed=seed, settings=settings, truth=truth).filter.belief.n


def information_curves(n: np.ndarray) -> list[Information]:
    """What ten seconds on clay tell about n: straight on level, smooth and rough ground, and steered."""
    manoeuvres: dict[str, Row] = {
        "straight, level": _SMOOTH._replace(H0=0.0),
        "straight, H0 = 0.01 m": _SMOOTH,
        "straight, H0 = 0.05 m": _STRAIGHT,
        "0.2 sin t, H0 = 0.05 m": _STEERED,
    }
    curves = []
    for name, row in manoeuvres.items():
        rate = information_rate(row, n)
        total = rate.sum(axis=1)
        curves.append(Information(name, n, 1.0 / np.sqrt(10.0 * total), rate[:, 2:4].sum(axis=1) / total))
    return curves


def forward_map(
    slips: tuple[float, ...], speeds: tuple[float, ...], report: Callable[[], None] = lambda: None
) -> list[ForwardCell]:
    """The forward comparison over slip and start speed, neither of which the paper prints."""
    cells = []
    for slip in slips:
        for speed in speeds:
            try:
                run = forward_comparison(slip=slip, speed=speed)
                distance, slowest = run.largest_distance, float(run.half_car.states[:, at.V_X].min())
            except SolverFailure:
                distance = slowest = math.nan
            cells.append(ForwardCell(slip, speed, distance, slowest))
            report()
    return cells


@dataclass(kw_only=True)
class Causes(Results):
    """Why the paper's filter fails on some rows of its table: four experiments.

    Writes causes_phase.png, causes_roots.png, causes_information.png and causes_forward.png.
    """

    quick: bool = False  #: shorter runs and fewer points
    seed: int = REPORT_SEEDS[0]  #: of the sensors' noise

    def run(self) -> None:
        """Run, print and draw the experiments."""
        from agents.studies.paper_failures.figure import (
            forward_map_figure,
            information_figure,
            phase_figure,
            roots_figure,
        )

        few = self.quick
        shifts = np.linspace(-np.pi, np.pi, 5 if few else 17)
        phases = phase_errors(shifts, duration=20.0 if few else 40.0, seed=self.seed)
        drifting = drifting_runs(duration=30.0 if few else 100.0, seed=self.seed)
        _show_phases(phases, drifting)
        self.save_figure(
            phase_figure(phases, drifting),
            "causes_phase",
            "Left: error of n where the map is read at a wrong place. Right: the estimate, and how "
            "far the propagated place is off (dashed).",
        )

        priors = np.linspace(0.4, 1.2, 3 if few else 9)
        curve, tracks = force_curve("clay"), starts(priors, duration=20.0 if few else 60.0, seed=self.seed)
        _show_starts(curve, tracks)
        self.save_figure(
            roots_figure(curve, tracks),
            "causes_roots",
            "Left: soils that give the same force along the wheel. Middle, right: estimates that "
            "start from several n.",
        )

        information = information_curves(np.linspace(0.4, 1.2, 9 if few else 33))
        _show_information(information)
        self.save_figure(
            information_figure(information, curve),
            "causes_information",
            "Left: least standard deviation of n after 10 s; it peaks where the force hardly depends "
            "on n (dotted). Right: share of the information in the vertical channels.",
        )

        cells = forward_map((0.0275, 0.1) if few else _SLIPS, (5.0, 15.0) if few else _SPEEDS)
        _show_forward(cells)
        self.save_figure(
            forward_map_figure(cells),
            "causes_forward",
            "Largest distance between the two models in 50 s, over the slip that the paper does not print.",
        )
        self.save_numbers(
            {
                "phase": phases,
                "roots": curve.roots,
                "turning_points": curve.turning_points,
                "starts": [{"model": s.model, "n_prior": s.n_prior, "end": s.end} for s in tracks],
                "information": information,
                "forward": cells,
            }
        )


_SLIPS = (0.0, 0.0275, 0.05, 0.075, 0.1, 0.125)
_SPEEDS = (2.0, 5.0, 10.0, 15.0)


def _show_phases(phases: list[PhaseError], drifting: list[Drifting]) -> None:
    heading = ("place off by [m]", "sensors' noise", "setting of the table")
    body = [(f"{p.shift:+.2f}", f"{p.trusting:.1e}", f"{p.table:.1e}") for p in phases]
    console().print(table("MSE of n on row 3, state known but for the place", heading, body, texts=0))
    for run in drifting:
        late = run.t >= 20.0
        error = math.sqrt(float(np.mean((run.n - 0.5)[late] ** 2)))
        say(
            f"row 1, sensors' noise assumed, {run.source}: RMSE after 20 s {error:.3f}, "
            f"place off by up to {run.distance.max():.0f} m"
        )


def _show_starts(curve: ForceCurve, tracks: list[Start]) -> None:
    roots, turns = (", ".join(f"{n:.3f}" for n in values) for values in (curve.roots, curve.turning_points))
    say(f"clay: F_x pulls as on the true soil at n = {roots}; its slope vanishes at {turns}")
    models = list(SETTINGS)
    ends = {(t.model, t.n_prior): t.end for t in tracks}
    heading = ("first guess", *(f"{model.replace('_', '-')} ends at" for model in models))
    priors = dict.fromkeys(t.n_prior for t in tracks)
    body = [(f"{n:.2f}", *(f"{ends[model, n]:.3f}" for model in models)) for n in priors]
    console().print(table("Row 2 from other first guesses", heading, body, texts=0))


def _show_information(curves: list[Information]) -> None:
    heading = ("manoeuvre", "sd at n = 0.5", "largest sd", "at n", "vertical share at 0.5")
    body = []
    for curve in curves:
        here, worst = int(np.argmin(np.abs(curve.n - 0.5))), int(np.argmax(curve.sd))
        numbers = (f"{curve.sd[here]:.4f}", f"{curve.sd[worst]:.4f}", f"{curve.n[worst]:.2f}")
        body.append((curve.name, *numbers, f"{curve.vertical[here]:.1%}"))
    console().print(table("sd of n after 10 s on clay, state known", heading, body))


def _show_forward(cells: list[ForwardCell]) -> None:
    speeds = list(dict.fromkeys(cell.speed for cell in cells))
    distance = {(cell.slip, cell.speed): cell.distance for cell in cells}
    heading = ("slip", *(f"start {v:g} m/s" for v in speeds))
    slips = dict.fromkeys(cell.slip for cell in cells)
    body = [(f"{slip:g}", *(f"{distance[slip, v]:.2f}" for v in speeds)) for slip in slips]
    title = "Forward comparison: largest distance between half-car and bicycle [m] (the paper: up to 15)"
    console().print(table(title, heading, body, texts=0))
