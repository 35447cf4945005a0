"""``offroad reproduce belief``: the soil under drives whose soil is known, errors and coverage of the belief.

Logs of another program, whose descriptions state the true soil (n and phi of it are not read), or simulated
drives of this project's own structures on soils of the population.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, plain, say, table
from agents.studies.belief.results import BeliefScore, score, straight
from agents.studies.belief.simulated import clean_log
from agents.studies.runner import Key, run_units, stamp_of
from estimators.belief.limits import HELD, limits_of, sampled_limits
from estimators.belief.soil_belief import believe_log
from estimators.logs import read_log
from estimators.replay.structures import Case, plant_for
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.simulator import Plant
from offroad_env.simulation.soil_holds import what_soil_holds

__all__ = ["BeliefStudy", "run_unit"]

#: Kinds of units.
_FILE, _SIMULATED = "file", "simulated"


def run_unit(kind: str, name: str) -> dict[str, Any]:
    """The belief over the soil of one drive, and the truth."""
    log, plant = (read_log(Path(name)), None) if kind == _FILE else clean_log(int(name))
    truth = log.config.soil if plant is None else plant.soil
    before = time.process_time()
    belief = believe_log(log)
    seconds = time.process_time() - before
    held = limits_of(sampled_limits(belief))
    if plant is None:
        plant = plant_for(log, Case(belief.parts[0].case.structure, "half_car"))._replace(soil=truth)
    result = {
        "name": log.name,
        "truth": {"n": truth.n, "phi": truth.phi},
        "soil": belief.soil(),
        "holds": held,
        "true_holds": _true_limits(plant),
        "valid_share": belief.valid_share,
        "answered": belief.answered,
        "structure": [[*part.case, part.weight] for part in belief.parts],
        "misfit": float(np.median(belief.parts[0].fit.misfit)),
        "straight": straight(log.channels["yaw_rate"]),
        "seconds": seconds,
    }
    found: dict[str, Any] = plain(result)
    return found


def _true_limits(plant: Plant) -> dict[str, float]:
    """What the soil holds for a vehicle; on a log of another program by the laws of the best structure.

    A simulated vehicle is not the one that its log describes: it is the true one that drives, and whose
    resistance the wheels' torques tell.
    """
    held = what_soil_holds(plant)
    return {name: getattr(held, name) for name in HELD}


@dataclass(kw_only=True)
class BeliefStudy(Results):
    """Errors, coverage and widths of the belief over the soil, on logs and simulated drives.

    A log's description must state its true soil. The first, third, ... of the logs are the tuning half, the
    others the check. Writes belief.png, and belief.jsonl with the result of every drive: a drive that is
    there is not repeated.
    """

    logs: tuple[Path, ...] = ()  #: drives whose description states the true soil
    simulated: int = 0  #: drives of this project's own structures, soils from the population
    first_seed: int = 0  #: of the simulated drives
    n_jobs: Jobs = 1  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.belief.figure import belief_figure

        if not self.logs and self.simulated < 1:
            raise InvalidParameter("name logs with --logs, or a number of drives with --simulated")
        if self.first_seed < 0:
            raise InvalidParameter(f"first_seed must be 0 or more, got {self.first_seed}")
        stamp = stamp_of("estimators.belief.limits", "agents.studies.belief.simulated")
        units: dict[Key, str] = {(_FILE, str(path)): stamp for path in self.logs}
        last = self.first_seed + self.simulated
        units |= {(_SIMULATED, f"{seed}"): stamp for seed in range(self.first_seed, last)}
        found = run_units(self.out / "belief.jsonl", run_unit, units, label="drives", n_jobs=self.n_jobs)
        drives = [row for key, row in found.items() if key[0] == _FILE]
        groups = {
            "tuning half": [row for row in drives[::2] if not row["straight"]],
            "check half": [row for row in drives[1::2] if not row["straight"]],
            "straight": [row for row in drives if row["straight"]],
            "simulated": [row for key, row in found.items() if key[0] == _SIMULATED],
        }
        groups = {name: rows for name, rows in groups.items() if rows}
        scores = {name: score(rows) for name, rows in groups.items()}
        both = [row for row in drives if not row["straight"]]
        if both:
            scores["both halves"] = score(both)
        self.save_figure(
            belief_figure(groups), "belief", "A point is one drive; on the dashed line the estimate is right."
        )
        self.save_numbers({"scores": scores, "drives": list(found.values())})
        _show(groups, scores)


def _show(groups: Mapping[str, Sequence[Mapping[str, Any]]], scores: Mapping[str, BeliefScore]) -> None:
    """A line for each drive, then for each group."""
    columns = ("drive", "n true", "n", "phi true", "phi", "structure", "predicted", "CPU s")
    rows = [_row(row) for group in groups.values() for row in group]
    console().print(table("drives", columns, rows))
    heading = (
        "drives", "", "n MAE", "phi MAE", "rank corr.", "answered", "n held", "phi held", "width n", "phi",
        "z n", "z phi",
    )  # fmt: skip
    lines = []
    for name, found in scores.items():
        shares = (f"{100.0 * value:.0f} %" for value in (found.answered, found.n_covered, found.phi_covered))
        lines.append(
            (
                name,
                f"{found.drives}",
                f"{found.n_mae:.3f}",
                f"{found.phi_mae:.3f}",
                "" if math.isnan(found.spearman) else f"{found.spearman:.3f}",
                *shares,
                f"{found.n_width:.2f}",
                f"{found.phi_width:.2f}",
                f"{found.n_z[0]:+.2f} ± {found.n_z[1]:.2f}",
                f"{found.phi_z[0]:+.2f} ± {found.phi_z[1]:.2f}",
            )
        )
    console().print(table("scores", heading, lines))
    for name, group in groups.items():
        say(f"{name}: what the soil holds, median error and share held: {_limits_line(group)}")


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    n, phi = row["soil"]["n"], row["soil"]["phi"]
    structure, vehicle_model, weight = row["structure"][0]
    return (
        row["name"],
        f"{row['truth']['n']:.3f}",
        f"{n['mean']:.3f} ± {n['sd']:.3f}",
        f"{row['truth']['phi']:.3f}",
        f"{phi['mean']:.3f} ± {phi['sd']:.3f}",
        f"{structure} {vehicle_model} {weight:.2f}",
        f"{100.0 * row['valid_share']:.0f} %",
        f"{row['seconds']:.0f}",
    )


def _limits_line(group: Sequence[Mapping[str, Any]]) -> str:
    parts = []
    for name in ("lateral", "pull", "resistance", "sinkage", "stopping"):
        truth = np.array([row["true_holds"][name] for row in group], dtype=float)
        found = {
            key: np.array([row["holds"][name][key] for row in group], dtype=float)
            for key in ("mean", "low", "high")
        }
        error = float(np.nanmedian(np.abs(found["mean"] / truth - 1.0)))
        held = float(np.mean((found["low"] <= truth) & (truth <= found["high"])))
        parts.append(f"{name} {100.0 * error:.0f} % ({100.0 * held:.0f} %)")
    return ", ".join(parts)
