"""The experiments of Buzhardt & Tallapragada (ACC 2021, arXiv 2202.04727) as functions.

Section II-C compares half-car and bicycle and sweeps the sinkage exponent; section IV estimates
the exponent on eight combinations of soil, roughness and steering. What the paper does not print
is in one table, `CHOICES`, each entry with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from estimators.analysis.scores import mean_square_error
from estimators.filters.parameter_ukf import (
    SOURCES,
    ParameterHistory,
    ParameterSettings,
    run_parameter_filter,
)
from estimators.filters.parameter_ukf_reference import run_reference_filter
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import (
    PAPER_SLIP,
    Plant,
    Trajectory,
    make_plant,
    settled_state,
    simulate,
)
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import paper_terrain
from offroad_env.world.vehicles import VEHICLES

__all__ = [
    "CHOICES",
    "KNOWN_SETTINGS",
    "ROWS",
    "SETTINGS",
    "SWEEP",
    "Choice",
    "ForwardComparison",
    "Row",
    "RowRun",
    "RowTruth",
    "Sweep",
    "exponent_sweep",
    "find_slip",
    "forward_comparison",
    "noisy_imu",
    "row_plant",
    "row_truth",
    "run_row",
    "speed_range",
]


class Choice(NamedTuple):
    """A number that the paper does not give."""

    value: float
    unit: str
    reason: str


CHOICES: dict[str, Choice] = {
    "slip_clay": Choice(
        PAPER_SLIP["clay"],
        "-",
        "constant slip on clay; `find_slip`: of all slips the one that keeps the four clay rows furthest "
        "inside 0.5-25 m/s, since nothing in the model ties force to speed",
    ),
    "slip_dry_sand": Choice(PAPER_SLIP["dry_sand"], "-", "constant slip on sand, found in the same way"),
    "start_speed": Choice(
        5.0, "m/s", "a walking-to-running pace of the class; the paper's paths span some 200 m in 50 s"
    ),
    "dt": Choice(
        0.01,
        "s",
        "100 Hz, a common rate of inertial units; the RK4 step of the half-car is 1e-8 accurate there",
    ),
    "noise_acceleration": Choice(0.2, "m/s^2", "the paper's, per sample"),
    "noise_rate": Choice(0.0175, "rad/s", "the paper's (printed in rad/s^2), per sample"),
    "n_prior_sd": Choice(0.2, "-", "the paper prints the first guess only; 0.1 and 0.4 reach the same rows"),
    "n_low": Choice(
        0.3,
        "-",
        "the filter estimates logit((n - n_low) / (n_high - n_low)), as every sigma point must be a soil. "
        "Between 0.3 and 1.8 lie the paper's two soils and all others of the catalogue but wet clays; a "
        "walk of constant size is then 2.1 times as wide in n at the first guess as on clay, enough to leave "
        "the false root at 0.97 and little enough to stay at 0.5 (on 0.2 ... 1.4 no R_n does both)",
    ),
    "n_high": Choice(1.8, "-", "see n_low"),
    "filter_a_z": Choice(
        4.0,
        "m/s^2",
        "noise that the filter assumes in a_z: the size of what the ground itself causes, since the "
        "propagated position drifts and with it the phase of the terrain; 2 ... 6 reach the same rows",
    ),
    "filter_pitch_rate": Choice(0.35, "rad/s", "the same for the pitch rate"),
}


def _settings(*, alpha: float, drift: float) -> ParameterSettings:
    """A setting of the paper's filter: what its sweep found, and the choices that go with it."""
    channels = ("noise_acceleration", "noise_acceleration", "filter_a_z", "filter_pitch_rate", "noise_rate")
    return ParameterSettings(
        n_prior_sd=CHOICES["n_prior_sd"].value,
        n_range=(CHOICES["n_low"].value, CHOICES["n_high"].value),
        alpha=alpha,
        drift=drift,
        noise=tuple(CHOICES[name].value for name in channels),
    )


#: One setting of the propagated filter per model for all rows: of the sweep over `SWEEP`, the one with
#: the most rows at or below the paper's error (median over the tuning seeds), and of several the one
#: with the lowest median log-MSE over the rows. ``offroad reproduce table1 --sweep`` repeats it.
SETTINGS: dict[str, ParameterSettings] = {
    "half_car": _settings(alpha=1.0, drift=0.025),
    "bicycle": _settings(alpha=2.0, drift=0.001),
}
#: Settings of the filter with a known state: the sensors' noise, and an n that hardly moves.
KNOWN_SETTINGS: dict[str, ParameterSettings] = {
    model: replace(
        setting,
        drift=1e-3,
        noise=(*3 * (CHOICES["noise_acceleration"].value,), *2 * (CHOICES["noise_rate"].value,)),
    )
    for model, setting in SETTINGS.items()
}
#: Spread of the sigma points and sqrt(R_n) that the sweep tries.
SWEEP: dict[str, tuple[float, ...]] = {
    "alpha": (0.5, 1.0, 2.0),
    "drift": (0.001, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04),
}


class Row(NamedTuple):
    """A row of the paper's table of results."""

    number: int
    soil: str  #: name in SOILS
    H0: float  #: amplitude of the terrain [m]
    steer_amplitude: float  #: [rad]
    steer_frequency: float  #: [rad/s]
    paper_half_car: float  #: mean square error of n that the paper reports [-]
    paper_bicycle: float  #: the same with the bicycle model [-]

    def steer(self, t: float) -> float:
        """Steering angle [rad] at time ``t`` [s]."""
        return self.steer_amplitude * math.sin(self.steer_frequency * t)


ROWS: tuple[Row, ...] = (
    Row(1, "clay", 0.05, 0.0, 0.0, 3.47e-2, 1.26e-1),
    Row(2, "clay", 0.01, 0.0, 0.0, 1.08e-2, 9.81e-2),
    Row(3, "clay", 0.05, 0.2, 1.0, 3.04e-3, 2.02e-2),
    Row(4, "clay", 0.05, 0.5, 0.3, 4.26e-3, 5.78e-2),
    Row(5, "dry_sand", 0.05, 0.0, 0.0, 5.26e-2, 1.55e-1),
    Row(6, "dry_sand", 0.01, 0.0, 0.0, 1.66e-3, 1.97e-1),
    Row(7, "dry_sand", 0.05, 0.2, 1.0, 9.13e-4, 3.53e-3),
    Row(8, "dry_sand", 0.05, 0.5, 0.3, 3.16e-3, 7.11e-3),
)

#: Mean and amplitude of F_u/m [m/s^2] (BT, sections II-C and IV); its frequency is 0.8 rad/s.
_DRIVE = {"clay": (0.8, 0.5), "dry_sand": (1.8, 0.6)}


def _force(soil: str) -> Callable[[float], float]:
    mass = VEHICLES["paper"].m
    mean, amplitude = _DRIVE[soil]
    return lambda t: mass * (mean + amplitude * math.sin(0.8 * t))


def row_plant(
    row: Row, vehicle_model: str = "half_car", *, n: float | None = None, slip: float | None = None
) -> Plant:
    """Vehicle, soil and ground of a row.

    Parameters
    ----------
    row : Row
        Of its fields, soil and H0 matter.
    vehicle_model : {"half_car", "bicycle"}
    n : float, optional
        Another sinkage exponent than the soil's [-].
    slip : float, optional
        Another constant slip than the chosen one [-].
    """
    return make_plant(
        VEHICLES["paper"],
        make_soil(row.soil, n=n),
        paper_terrain(row.H0),
        model="paper",
        vehicle_model=vehicle_model,
        slip=CHOICES[f"slip_{row.soil}"].value if slip is None else slip,
    )


def _comparison_steer(t: float) -> float:
    """Steering of section II-C [rad]."""
    return 0.3 * math.sin(0.1 * t)


def _comparison_run(
    plant: Plant,
    duration: float,
    *,
    speed: float | None = None,
    force: float | Callable[[float], float] = 0.0,
    speed_rate: Callable[[float], float] | None = None,
) -> Trajectory:
    state, warm = settled_state(plant, v_x=CHOICES["start_speed"].value if speed is None else speed)
    return simulate(
        plant,
        state,
        warm,
        steer=_comparison_steer,
        force=force,
        speed_rate=speed_rate,
        duration=duration,
        dt=CHOICES["dt"].value,
    )


@dataclass(frozen=True, kw_only=True)
class ForwardComparison:
    """Half-car and bicycle under the same force and steering (BT, section II-C)."""

    t: np.ndarray  #: (T,) [s]
    half_car: Trajectory
    bicycle: Trajectory
    distance: np.ndarray  #: (T,) distance between the two vehicles at equal times [m]

    @property
    def largest_distance(self) -> float:
        """[m]; the paper reports "as much as 15 m"."""
        return float(self.distance.max())


def forward_comparison(
    *, duration: float = 50.0, H0: float = 0.05, slip: float | None = None, speed: float | None = None
) -> ForwardComparison:
    """Run the paper's forward comparison on clay: both models, each settled on the soil at the start.

    Parameters
    ----------
    duration : float
        [s]
    H0 : float
        Amplitude of the terrain [m]; with 0 the models agree (level ground).
    slip : float, optional
        Another constant slip than the chosen one [-].
    speed : float, optional
        Another speed at the start [m/s].
    """
    ground = ROWS[0]._replace(H0=H0)
    runs = {
        model: _comparison_run(
            row_plant(ground, model, slip=slip), duration, speed=speed, force=_force("clay")
        )
        for model in ("half_car", "bicycle")
    }
    half_car, bicycle = runs["half_car"], runs["bicycle"]
    apart = half_car.states[:, [at.X, at.Y]] - bicycle.states[:, [at.X, at.Y]]
    return ForwardComparison(
        t=half_car.t, half_car=half_car, bicycle=bicycle, distance=np.hypot(apart[:, 0], apart[:, 1])
    )


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """The half-car on soils that differ in n alone (BT, section II-C, last experiment)."""

    mode: str
    n: np.ndarray  #: (K,) sinkage exponents [-]
    runs: tuple[Trajectory, ...]  #: one per exponent

    @property
    def paths(self) -> np.ndarray:
        """(K, T, 2) positions [m]."""
        return np.stack([run.states[:, [at.X, at.Y]] for run in self.runs])

    @property
    def spread(self) -> float:
        """Largest distance between two end points [m]."""
        ends = self.paths[:, -1]
        return float(np.hypot(*(ends[:, None] - ends[None, :]).transpose(2, 0, 1)).max())


def exponent_sweep(
    *, mode: str = "speed", n: tuple[float, ...] = (0.4, 0.45, 0.5, 0.55, 0.6), duration: float = 50.0
) -> Sweep:
    """Paths of the half-car on clay for several sinkage exponents, steering as in the comparison.

    Parameters
    ----------
    mode : {"speed", "force"}
        "speed": the longitudinal speed of the nominal run (n of clay) is prescribed to all, as the
        paper does. "force": all get the nominal body force.
    n : tuple of float
        Exponents [-].
    duration : float
        [s]
    """
    if mode not in ("speed", "force"):
        raise InvalidParameter(f'mode must be "speed" or "force", got {mode!r}')
    force: float | Callable[[float], float] = _force("clay")
    speed_rate: Callable[[float], float] | None = None
    if mode == "speed":
        nominal = _comparison_run(row_plant(ROWS[0]), duration, force=force)
        force, speed_rate = 0.0, CubicSpline(nominal.t, nominal.states[:, at.V_X]).derivative()
    runs = tuple(
        _comparison_run(row_plant(ROWS[0], n=value), duration, force=force, speed_rate=speed_rate)
        for value in n
    )
    return Sweep(mode=mode, n=np.array(n, dtype=np.float64), runs=runs)


@dataclass(frozen=True, kw_only=True)
class RowTruth:
    """The true vehicle of a row: half-car, settled start."""

    row: Row
    slip: float  #: constant slip [-]
    run: Trajectory
    inputs: np.ndarray  #: (2 T - 1, 3) steer [rad], F_u [N], NaN at every half step
    imu: np.ndarray  #: (T, 5) noise-free `models.CHANNELS`

    @property
    def n(self) -> float:
        """True sinkage exponent [-]."""
        return SOILS[self.row.soil].n


def row_truth(row: Row, *, duration: float = 100.0, slip: float | None = None) -> RowTruth:
    """Simulate the true vehicle of a row.

    Parameters
    ----------
    row : Row
        One of `ROWS`.
    duration : float
        [s]
    slip : float, optional
        Another constant slip than the chosen one [-].
    """
    plant = row_plant(row, slip=slip)
    state, warm = settled_state(plant, v_x=CHOICES["start_speed"].value)
    force, dt = _force(row.soil), CHOICES["dt"].value
    run = simulate(plant, state, warm, steer=row.steer, force=force, duration=duration, dt=dt)
    half = 0.5 * dt * np.arange(2 * len(run.t) - 1)
    inputs = np.array([(row.steer(t), force(t), math.nan) for t in half])
    r, x = run.readings, run.states
    imu = np.stack([r[:, at.A_X], r[:, at.A_Y], r[:, at.A_Z], x[:, at.PITCH_RATE], x[:, at.YAW_RATE]], axis=1)
    return RowTruth(row=row, slip=plant.slip, run=run, inputs=inputs, imu=imu)


def speed_range(soil: str, slip: float, *, duration: float = 100.0) -> tuple[float, float]:
    """Lowest and highest speed [m/s] over the rows on ``soil`` at a constant ``slip``.

    A vehicle that stops, reverses or leaves the range of the model counts as (0, inf).
    """
    speeds = []
    for row in ROWS:
        if row.soil == soil:
            try:
                speeds.append(row_truth(row, duration=duration, slip=slip).run.states[:, at.V_X])
            except SolverFailure:
                return 0.0, math.inf
    low = min(float(v.min()) for v in speeds)
    return max(low, 0.0), max(float(v.max()) for v in speeds)


def find_slip(
    soil: str, candidates: np.ndarray, *, limits: tuple[float, float] = (0.5, 25.0)
) -> tuple[float, float]:
    """``(slip, margin)``: the constant slip that keeps all rows of ``soil`` furthest inside ``limits`` [m/s].

    The margin is the smaller of v_min/limits[0] and limits[1]/v_max over the rows: above 1, all
    rows stay inside. It is small for slips that let the vehicle stop and for those that let it run
    away, with one peak between.
    """

    def margin(slip: float) -> float:
        low, high = speed_range(soil, float(slip))
        return min(low / limits[0], limits[1] / high)

    margins = [margin(slip) for slip in candidates]
    best = int(np.argmax(margins))
    return float(candidates[best]), margins[best]


@dataclass(frozen=True, kw_only=True)
class RowRun:
    """One filter on one row with one noise seed."""

    truth: RowTruth
    model: str
    source: str
    seed: int
    filter: ParameterHistory

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return self.truth.run.t

    @property
    def mse(self) -> float:
        """Mean square error of n over the run [-]: the number in the paper's table."""
        return mean_square_error(self.filter.belief.n, self.truth.n)

    @property
    def paper_mse(self) -> float:
        """The paper's number for this row and filter model [-]."""
        return self.truth.row.paper_half_car if self.model == "half_car" else self.truth.row.paper_bicycle


def noisy_imu(truth: RowTruth, seed: int) -> np.ndarray:
    """(T, 5) readings of the truth with the paper's noise."""
    sd = [CHOICES["noise_acceleration"].value] * 3 + [CHOICES["noise_rate"].value] * 2
    rng = np.random.default_rng([seed, truth.row.number])
    return truth.imu + rng.normal(size=truth.imu.shape) * sd


def run_row(
    row: Row,
    model: str = "half_car",
    *,
    source: str = "propagated",
    seed: int = 0,
    settings: ParameterSettings | None = None,
    truth: RowTruth | None = None,
    reference: bool = False,
) -> RowRun:
    """Estimate n on one row of the paper's table.

    Parameters
    ----------
    row : Row
        One of `ROWS`.
    model : {"half_car", "bicycle"}
        Of the filter; the truth is always the half-car.
    source : {"propagated", "known"}
        Where the filter's state comes from, see `estimators.filters.parameter_ukf`.
    seed : int
        Of the IMU noise.
    settings : ParameterSettings, optional
        Default: the one setting of ``model`` for all rows, of `SETTINGS` or `KNOWN_SETTINGS`.
    truth : RowTruth, optional
        Of `row_truth`, to share one simulation between seeds.
    reference : bool
        Use the public filterpy reference in place of the compiled filter; some hundred times as slow.
    """
    if source not in SOURCES:
        raise InvalidParameter(f"source must be one of {', '.join(SOURCES)}, got {source!r}")
    settings = settings or (SETTINGS if source == "propagated" else KNOWN_SETTINGS)[model]
    truth = truth or row_truth(row)
    # The prior for the height follows the prior for n; place and speed at the start are known.
    plant = row_plant(row, model, n=settings.n_prior)
    start = settled_state(plant, v_x=CHOICES["start_speed"].value)
    known = truth.run.states if source == "known" else None
    run_filter = run_reference_filter if reference else run_parameter_filter
    result = run_filter(
        plant, start, truth.inputs, noisy_imu(truth, seed), CHOICES["dt"].value, settings, known=known
    )
    return RowRun(truth=truth, model=model, source=source, seed=seed, filter=result)
