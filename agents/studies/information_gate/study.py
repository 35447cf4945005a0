"""``offroad reproduce gate``: what happens to an estimate while the motion holds no information on the soil.

Two drives. In the paper's model: 20 s of steering and changing force, 20 s straight on at constant
speed on level ground, 20 s as before; joint filter and bank stand against the Cramer-Rao bound of the
same drive, so that a standard deviation that falls without a reason would show. In the full model: the same
with a standstill of 20 s in between, and the online filters of the environment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.recorded_drives import record, run_online
from agents.studies.runner import Key, checked_seeds, run_units, stamp_of
from estimators.analysis.cramer_rao import posterior_bound
from estimators.experiments.buzhardt_tallapragada import CHOICES, ROWS, row_plant
from estimators.experiments.simulated_rows import REPORT_SEEDS, SimulatedRow, row_model, simulate_row
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.joint_bank import BankSettings, run_bank
from estimators.filters.joint_ukf import run_joint_filter
from estimators.filters.registry import ONLINE_FILTERS
from estimators.models.half_car_on_map import JointSettings, prior
from offroad_env.physics import state as at
from offroad_env.simulation.drive import DriveRecord
from offroad_env.simulation.simulator import make_plant, settled_state, simulate
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = ["Gate", "PhaseLine", "gate_drive", "online_drive", "phase_lines", "run_unit"]

#: The drive of the paper's model is row 3 without the hills.
ROW = ROWS[2]._replace(H0=0.0)
#: Phases: name and end [s].
MAP_PHASES = (("steering", 20.0), ("straight", 40.0), ("steering again", 60.0))
ONLINE_PHASES = (("steering", 20.0), ("straight", 40.0), ("standing", 60.0), ("steering again", 80.0))
DRIFTS = (0.0, 0.02)
#: Samples between two that are kept.
_EVERY = 10
_PRIOR_SD = 0.05
_ONLINE_N, _ONLINE_PRIOR, _ONLINE_RANGE = 0.8, (1.0, 0.15), (0.4, 1.2)
_SPEED = 5.0


class PhaseLine(NamedTuple):
    """What one filter did in one phase, over all seeds."""

    filter: str
    drift: float  #: random walk of eta that truth and filter have [1/sqrt(s)]; NaN: the estimator's own
    phase: str
    sd_begin: float  #: median standard deviation of n at the start of the phase [-]
    sd_end: float  #: and at its end [-]
    moved: float  #: median change of the estimate in its standard deviations at the start
    least_over_bound: float  #: smallest sd / bound in the phase over all seeds; NaN without a bound
    inside: float  #: share of the phase with the truth within two standard deviations


def _phase_edges(phases: Sequence[tuple[str, float]]) -> list[tuple[str, float, float]]:
    ends = [end for _, end in phases]
    return [(name, begin, end) for (name, end), begin in zip(phases, [0.0, *ends[:-1]], strict=True)]


def _resistance() -> float:
    """Force [N] that keeps the settled vehicle at its speed on level ground."""
    plant = row_plant(ROW)
    state, warm = settled_state(plant, v_x=_SPEED)
    run = simulate(plant, state, warm, duration=2.0 * CHOICES["dt"].value, dt=CHOICES["dt"].value)
    return -float(run.readings[0, at.A_X]) * plant.vehicle.m


def gate_drive(seed: int, settings: JointSettings, *, duration: float = MAP_PHASES[-1][1]) -> SimulatedRow:
    """Level clay: steering and changing force, but straight on at constant speed from 20 to 40 s."""
    _, begin, end = _phase_edges(MAP_PHASES)[1]
    hold, mass = _resistance(), VEHICLES["paper"].m
    t = 0.5 * CHOICES["dt"].value * np.arange(2 * round(duration / CHOICES["dt"].value) + 1)
    excited = (t < begin) | (t >= end)
    inputs = np.stack(
        [
            np.where(excited, ROW.steer_amplitude * np.sin(ROW.steer_frequency * t), 0.0),
            hold + np.where(excited, 0.5 * mass * np.sin(0.8 * t), 0.0),
            np.full(t.shape, math.nan),
        ],
        axis=1,
    )
    return simulate_row(ROW, seed, settings, inputs=inputs)


def _map_unit(seed: int, drift: float) -> dict[str, Any]:
    settings = JointSettings(drift=drift)
    drive, model = gate_drive(seed, settings), row_model(ROW, settings)
    z, place, n_0 = drive.readings(), (0.0, 0.0, 0.0), float(drive.n[0])
    start = prior(model, settings, n_0, _PRIOR_SD, place, _SPEED)
    bank = BankSettings(joint=settings, n_prior=n_0, n_prior_sd=_PRIOR_SD)
    runs = {
        "map_joint_ukf": run_joint_filter(model, start, drive.inputs, z).belief,
        "map_ukf_bank": run_bank(model, bank, drive.inputs, z, v_x=_SPEED).belief,
    }
    bound = posterior_bound(model, start, drive.truth, drive.inputs, z)
    return {
        "bound": bound[::_EVERY].tolist(),
        "truth": drive.n[::_EVERY].tolist(),
        "runs": {name: _series(run) for name, run in runs.items()},
    }


def _series(history: BeliefHistory) -> dict[str, Any]:
    return {"n": history.n[::_EVERY].tolist(), "sd": history.sd[::_EVERY].tolist()}


class _Driver:
    """Holds a speed by a proportional and an integral part; steers and varies it while exciting."""

    def __init__(self) -> None:
        self.sum = 0.0

    def __call__(self, t: float, v: float) -> tuple[float, float, float]:
        phase = next(name for name, _, end in _phase_edges(ONLINE_PHASES) if t < end)
        vehicle = VEHICLES["mrzr"]
        if phase == "standing":
            self.sum = 0.0
            return 0.0, 0.0, 0.4 * vehicle.brake_torque_max
        exciting = phase != "straight"
        steer = 0.12 * math.sin(t) if exciting else 0.0
        error = _SPEED + (1.5 * math.sin(0.8 * t) if exciting else 0.0) - v
        self.sum = min(max(self.sum + 0.006 * error, -0.5), 0.5)
        pedal = min(max(0.25 + 0.35 * error + self.sum, -0.5), 1.0)
        return steer, max(pedal, 0.0) * vehicle.drive_torque_max, max(-pedal, 0.0) * vehicle.brake_torque_max


def online_drive(seed: int) -> DriveRecord:
    """Level sand of n = 0.8 under the full model, in the phases of `ONLINE_PHASES`."""
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=_ONLINE_N), flat())
    return record(plant, _Driver(), ONLINE_PHASES[-1][1] - 0.01, seed=seed, speed=_SPEED)


def _online_unit(seed: int) -> dict[str, Any]:
    drive = online_drive(seed)
    mean, sd = _ONLINE_PRIOR
    runs = {
        name: run_online(name, drive, n_range=_ONLINE_RANGE, n_prior=mean, sd=sd) for name in ONLINE_FILTERS
    }
    return {
        "truth": drive.n[::_EVERY].tolist(),
        "runs": {name: _series(run) for name, run in runs.items()},
    }


def run_unit(part: str, seed: int, drift: float) -> dict[str, Any]:
    """Estimates over time (10 Hz) of one seed of one of the two drives."""
    return _online_unit(seed) if part == "online" else _map_unit(seed, drift)


def phase_lines(results: Mapping[Key, Mapping[str, Any]]) -> list[PhaseLine]:
    """A line for every filter and phase from the results by (part, seed, drift)."""
    lines = []
    for part, drift in dict.fromkeys((key[0], key[2]) for key in results):
        units = [result for key, result in results.items() if (key[0], key[2]) == (part, drift)]
        phases = _phase_edges(ONLINE_PHASES if part == "online" else MAP_PHASES)
        lines += [
            _phase_line(name, math.nan if part == "online" else drift, phase, units)
            for name in units[0]["runs"]
            for phase in phases
        ]
    return lines


def _phase_line(
    name: str, drift: float, phase: tuple[str, float, float], units: Sequence[Mapping[str, Any]]
) -> PhaseLine:
    step = 0.01 * _EVERY
    title, begin, end = phase
    inside = slice(round(begin / step), round(end / step))
    n, sd = (np.array([unit["runs"][name][part] for unit in units])[:, inside] for part in ("n", "sd"))
    truth = np.array([unit["truth"] for unit in units])[:, inside]
    least = math.nan
    if "bound" in units[0]:
        least = float((sd / np.array([unit["bound"] for unit in units])[:, inside]).min())
    return PhaseLine(
        filter=name,
        drift=drift,
        phase=title,
        sd_begin=float(np.median(sd[:, 0])),
        sd_end=float(np.median(sd[:, -1])),
        moved=float(np.median(np.abs(n[:, -1] - n[:, 0]) / sd[:, 0])),
        least_over_bound=least,
        inside=float(np.mean(np.abs(n - truth) <= 2.0 * sd)),
    )


@dataclass(kw_only=True)
class Gate(Results):
    """The information gate: estimates and their standard deviations while the motion holds no information.

    Level ground; steering, then straight on at constant speed, then (online filters) a standstill. Writes
    gate.png, and gate.jsonl with the result of every run: a run that is there is not repeated.
    """

    quick: bool = False  #: one seed
    seeds: int = 10  #: noise seeds, of those set aside for reporting
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.information_gate.figure import gate_figure

        if self.quick:
            self.seeds = 1
        on_map = stamp_of(
            "estimators.filters.joint_bank",
            "estimators.experiments.simulated_rows",
            "estimators.analysis.cramer_rao",
        )
        online = stamp_of("estimators.filters.online", "agents.studies.recorded_drives")
        units: dict[Key, str] = {}
        for seed in checked_seeds(self.seeds, REPORT_SEEDS):
            units |= {("map", seed, drift): on_map for drift in DRIFTS}
            units["online", seed, 0.0] = online
        results = run_units(self.out / "gate.jsonl", run_unit, units, label="gate", n_jobs=self.n_jobs)
        lines = phase_lines(results)
        _show(lines)
        self.save_figure(
            gate_figure(results, MAP_PHASES, ONLINE_PHASES),
            "gate",
            "Grey: the motion carries no information about n. A constant n keeps its deviation there, "
            "a drifting one loses it.",
        )
        self.save_numbers({"phases": lines, "seeds": self.seeds})


def _show(lines: Sequence[PhaseLine]) -> None:
    heading = (
        "filter", "phase", "drift", "sd before", "sd after", "after/before", "moved [sd]", "least sd/bound",
        "within 2 sd",
    )  # fmt: skip
    body = [
        (
            line.filter,
            line.phase,
            "its own" if math.isnan(line.drift) else f"{line.drift:g}",
            f"{line.sd_begin:.4f}",
            f"{line.sd_end:.4f}",
            f"{line.sd_end / line.sd_begin:.2f}",
            f"{line.moved:.2f}",
            "-" if math.isnan(line.least_over_bound) else f"{line.least_over_bound:.2f}",
            f"{line.inside:.0%}",
        )
        for line in lines
    ]
    console().print(table("standard deviation of n by phase", heading, body, texts=2))
    say("least sd/bound: 1 or more means that no filter states less than the drive allows")
