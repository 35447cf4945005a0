"""``offroad reproduce gate``: what happens to an estimate while the motion says nothing about the soil.

Two drives. In the paper's model: 20 s of steering and changing force, 20 s straight on at constant
speed on level ground, 20 s as before; joint filter and bank stand against the Cramer-Rao bound of the
same drive, so that a standard deviation that falls without a reason would show. In the full model:
the same with a standstill of 20 s in between, and the estimators that the environment carries.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.commands.output import Results, console, say, table
from agents.studies.recorded import Recording, record, run_on_board
from agents.studies.units import Key, checked_seeds, run_units, stamp_of
from estimators.bank import BankSettings, run_bank
from estimators.bounds import posterior_bound
from estimators.carried import KINDS
from estimators.joint import JointSettings, prior, run_joint_filter
from estimators.paper import CHOICES, ROWS, row_plant
from estimators.protocol_runs import REPORT_SEEDS, RowTwin, row_model, row_twin
from offroad_env.physics import state as at
from offroad_env.simulator import make_plant, settled_state, simulate
from offroad_env.soils import make_soil
from offroad_env.terrain import flat
from offroad_env.vehicles import VEHICLES

__all__ = ["Gate", "PhaseLine", "board_drive", "gate_twin", "phase_lines", "run_unit"]

#: The drive of the paper's model is row 3 without the hills.
ROW = ROWS[2]._replace(H0=0.0)
#: Phases: name and end [s].
TWIN_PHASES = (("steering", 20.0), ("straight", 40.0), ("steering again", 60.0))
BOARD_PHASES = (("steering", 20.0), ("straight", 40.0), ("standing", 60.0), ("steering again", 80.0))
DRIFTS = (0.0, 0.02)
#: Samples between two that are kept.
_EVERY = 10
_PRIOR_SD = 0.05
_BOARD_N, _BOARD_PRIOR, _BOARD_RANGE = 0.8, (1.0, 0.15), (0.4, 1.2)
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


def gate_twin(seed: int, settings: JointSettings, *, duration: float = TWIN_PHASES[-1][1]) -> RowTwin:
    """Level clay: steering and changing force, but straight on at constant speed from 20 to 40 s."""
    _, begin, end = _phase_edges(TWIN_PHASES)[1]
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
    return row_twin(ROW, seed, settings, inputs=inputs)


def _twin_unit(seed: int, drift: float) -> dict:
    settings = JointSettings(drift=drift)
    twin, model = gate_twin(seed, settings), row_model(ROW, settings)
    z, place, n_0 = twin.readings(), (0.0, 0.0, 0.0), float(twin.n[0])
    start = prior(model, settings, n_0, _PRIOR_SD, place, _SPEED)
    bank = BankSettings(joint=settings, n_prior=n_0, n_prior_sd=_PRIOR_SD)
    runs = {
        "joint": run_joint_filter(model, start, twin.inputs, z),
        "bank": run_bank(model, bank, twin.inputs, z, v_x=_SPEED),
    }
    bound = posterior_bound(model, start, twin.truth, twin.inputs, z)
    return {
        "bound": bound[::_EVERY].tolist(),
        "truth": twin.n[::_EVERY].tolist(),
        "runs": {name: _series(run) for name, run in runs.items()},
    }


def _series(run) -> dict:
    return {"n": run.n[::_EVERY].tolist(), "sd": run.sd[::_EVERY].tolist()}


class _Chauffeur:
    """Holds a speed by a proportional and an integral part; steers and varies it while exciting."""

    def __init__(self) -> None:
        self.sum = 0.0

    def __call__(self, t: float, v: float) -> tuple[float, float, float]:
        phase = next(name for name, _, end in _phase_edges(BOARD_PHASES) if t < end)
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


def board_drive(seed: int) -> Recording:
    """Level sand of n = 0.8 under the full model, in the phases of `BOARD_PHASES`."""
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=_BOARD_N), flat())
    return record(plant, _Chauffeur(), BOARD_PHASES[-1][1] - 0.01, seed=seed, speed=_SPEED)


def _board_unit(seed: int) -> dict:
    drive = board_drive(seed)
    mean, sd = _BOARD_PRIOR
    runs = {kind: run_on_board(kind, drive, n_range=_BOARD_RANGE, n_prior=mean, sd=sd) for kind in KINDS}
    return {
        "truth": drive.n[::_EVERY].tolist(),
        "runs": {f"{kind}, on board": _series(run) for kind, run in runs.items()},
    }


def run_unit(part: str, seed: int, drift: float) -> dict:
    """Estimates over time (10 Hz) of one seed of one of the two drives."""
    return _board_unit(seed) if part == "board" else _twin_unit(seed, drift)


def phase_lines(results: Mapping[Key, Mapping]) -> list[PhaseLine]:
    """A line for every filter and phase from the results by (part, seed, drift)."""
    lines = []
    for part, drift in dict.fromkeys((key[0], key[2]) for key in results):
        units = [result for key, result in results.items() if (key[0], key[2]) == (part, drift)]
        phases = _phase_edges(BOARD_PHASES if part == "board" else TWIN_PHASES)
        lines += [
            _phase_line(name, math.nan if part == "board" else drift, phase, units)
            for name in units[0]["runs"]
            for phase in phases
        ]
    return lines


def _phase_line(
    name: str, drift: float, phase: tuple[str, float, float], units: Sequence[Mapping]
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
    """The information gate: estimates and their standard deviations while the motion says nothing.

    Level ground; steering, then straight on at constant speed, then (on board) a standstill. Writes
    gate.png, and gate.jsonl with the result of every run: a run that is there is not repeated.
    """

    quick: bool = False  #: one seed
    seeds: int = 10  #: noise seeds, of those set aside for reporting
    n_jobs: int = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.figures.gate import gate_figure

        if self.quick:
            self.seeds = 1
        twins = stamp_of("estimators.bank", "estimators.protocol_runs", "estimators.bounds")
        board = stamp_of("estimators.carried", "agents.studies.recorded")
        units: dict[Key, str] = {}
        for seed in checked_seeds(self.seeds, REPORT_SEEDS):
            units |= {("twin", seed, drift): twins for drift in DRIFTS}
            units["board", seed, 0.0] = board
        results = run_units(self.out / "gate.jsonl", run_unit, units, label="gate", n_jobs=self.n_jobs)
        lines = phase_lines(results)
        _show(lines)
        self.save_figure(gate_figure(results, TWIN_PHASES, BOARD_PHASES), "gate")
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
    say("least sd/bound: 1 or more means that no filter is surer than the drive allows")
