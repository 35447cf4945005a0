"""Information of drives about pairs of soil parameters: the units behind ``offroad identify``.

A unit is one drive and one pair: its information, and the errors of estimates over noise seeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.studies.runner import Key, run_units, stamp_of
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.fisher_information import Information, Noise, linearise
from estimators.experiments.manoeuvres import MANOEUVRES, Manoeuvre, log_manoeuvre, manoeuvre, row_manoeuvre
from estimators.experiments.simulated_estimates import estimation_errors
from estimators.logs import read_log
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.descriptions import read_soil
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = ["SECONDS", "Finding", "Options", "identify", "run_unit"]

#: Partners of n.
SECONDS = ("phi", "k_phi", "c")
_ROW_NAMES = tuple(f"row{row.number}" for row in ROWS)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One drive, one pair."""

    source: str
    title: str
    duration: float  #: [s]
    information: Information
    errors: np.ndarray  #: (seeds, 2) of estimates, in shown units; NaN where one failed

    @property
    def failed(self) -> int:
        """Estimates that did not converge, or left the range of the model."""
        return int(np.isnan(self.errors[:, 0]).sum())

    @property
    def excess(self) -> float:
        """Mean squared error in units of the bound: 1 where the estimates reach it, in every direction."""
        errors = self.errors[~np.isnan(self.errors[:, 0])]
        if not len(errors):
            return math.nan
        precision = np.linalg.inv(self.information.bound)
        squares = np.einsum("ij,jk,ik->i", errors, precision, errors)
        return float(np.mean(squares)) / int(errors.shape[1])

    @property
    def excess_band(self) -> tuple[float, float]:
        """95 % band of `excess` for estimates that reach the bound."""
        from scipy.stats import chi2

        freedom = max(self.errors.size - 2 * self.failed, 1)
        low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
        return float(low), float(high)


def _drive(source: str, soil: str, n: float | None, duration: float) -> Manoeuvre:
    """A drive of the menu, a row of the paper's table, or that of a log."""
    if source in MANOEUVRES:
        plant = make_plant(VEHICLES["mrzr"], make_soil(read_soil(soil).record, n=n), flat())
        return manoeuvre(source, plant, duration=duration)
    if source in _ROW_NAMES:
        return row_manoeuvre(_ROW_NAMES.index(source) + 1, duration=duration)
    if not Path(source).exists():
        raise InvalidParameter(
            f"no drive {source!r} - one of {', '.join(MANOEUVRES)}, {_ROW_NAMES[0]} ... {_ROW_NAMES[-1]}, "
            "or the file of a log"
        )
    return log_manoeuvre(read_log(source))


class Options(NamedTuple):
    """What all units of a call share."""

    soil: str  #: of the menu's drives
    n: float | None  #: its sinkage exponent [-]; None: the catalogue's
    duration: float  #: of the menu's drives and the rows [s]
    seeds: int  #: noise seeds
    seed: int  #: the first of them
    fix: bool  #: a satellite receiver is there


def run_unit(
    source: str, second: str, soil: str, n: float | None, duration: float, seeds: int, seed: int, fix: bool
) -> dict[str, Any]:
    """Information of one drive about n and ``second``, and errors of estimates, as plain numbers."""
    drive = _drive(source, soil, n, duration)
    line = linearise(drive, ("n", second), Noise(fix=fix))
    errors = estimation_errors(line, range(seed, seed + seeds))
    return {
        "name": drive.name,
        "title": drive.title,
        "duration": drive.duration,
        "matrix": line.information.matrix.tolist(),
        "errors": errors.tolist(),
    }


def identify(
    sources: tuple[str, ...], seconds: tuple[str, ...], path: Path, options: Options, *, n_jobs: int = 2
) -> list[Finding]:
    """Every drive with every pair; results in ``path`` are used again.

    Parameters
    ----------
    sources
        Names of the menu, ``row1`` ... ``row8``, or files of logs.
    seconds
        Partners of n.
    path
        File of JSON lines.
    options
        Soil, durations and seeds.
    n_jobs
        Local processes.
    """
    for source in sources:
        _drive(source, options.soil, options.n, 0.1)  # refuses what cannot work before anything long begins
    stamp = stamp_of("estimators.experiments.simulated_estimates")
    keys: list[Key] = [(source, second, *options) for source in sources for second in seconds]
    stamps = {key: f"{stamp}-{read_log(key[0]).hash[:10] if _is_log(key[0]) else ''}" for key in keys}
    found = run_units(path, run_unit, stamps, label="drives and pairs", n_jobs=n_jobs)
    return [
        Finding(
            source=found[key]["name"],
            title=found[key]["title"],
            duration=found[key]["duration"],
            information=Information(parameters=("n", key[1]), matrix=np.array(found[key]["matrix"])),
            errors=np.array(found[key]["errors"], dtype=np.float64),
        )
        for key in keys
    ]


def _is_log(source: str) -> bool:
    return source not in MANOEUVRES and source not in _ROW_NAMES
