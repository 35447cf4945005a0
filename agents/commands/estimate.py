"""``offroad estimate``: the soil under measured or simulated drives, or one filter for n along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table, write_bytes
from offroad_env.errors import DataError, InvalidParameter

if TYPE_CHECKING:
    import numpy as np

    from estimators.belief.soil_belief import SoilBelief
    from estimators.log_estimation import LogEstimate
    from estimators.logs import Log, QualityReport

__all__ = ["Estimate"]

#: Filter of drives that cannot be replayed.
_FALLBACK = "online_joint_ukf"


@dataclass(kw_only=True)
class Estimate(Results):
    """Estimate the soil from logs of drives.

    A log is a .csv, .parquet or ROS bag with a .yaml of the same name; docs/logs.md has the format.
    n and phi are taken as unknown, what else the description states as right to a tolerance; several
    structures of wheel and soil compete (docs/belief.md). Prints one number a quantity with its 95 % interval
    and writes a figure of each log.

    With --filter one filter for n runs along the log instead, all else taken as exact. Writes
    estimate_LOG_FILTER.csv (t, n, sd, low, high, valid, nis; robust_sd, robust_valid; evidence_n,
    evidence_sd) and a figure. sd and valid are stated by the filter, given its model; robust_sd and
    robust_valid allow for errors of that model. Filters for any drive: online_parameter_ukf (parameter),
    online_joint_ukf (joint), online_ukf_bank (bank); for the paper's half-car over a known ground:
    map_joint_ukf (map_joint), map_ukf_bank (map_bank), map_ekf. Drives without torques of the wheels can
    only be filtered.
    """

    logs: Positional[tuple[Path, ...]]  #: one or more logs
    structure: tuple[str, ...] = ("full", "grid", "field")  #: that compete: "grid,ruts=none", ...
    tolerance: float = 0.05  #: relative sd of moduli, cohesion and K as the description states them [-]
    details: bool = False  #: also what each structure finds
    filter: str | None = None  #: instead: id or short name of a filter
    n_prior: float | None = None  #: of a filter: mean of the prior [-]; default: n in the log's description
    sd: float = 0.2  #: of a filter: standard deviation of the prior [-]
    accept: bool = False  #: go on where the checks of the data find a problem

    def run(self) -> None:
        """Check, estimate, draw and print, log by log."""
        if not self.logs:
            raise InvalidParameter("logs must name at least one file")
        if not 0.0 < self.sd <= 1.0:
            raise InvalidParameter(f"sd must be in (0, 1], got {self.sd:g}")
        from estimators.logs import read_logs

        logs = read_logs(self.logs)
        chosen = self.filter
        if chosen is None and not all(_replayable(log) for log in logs):
            chosen = _FALLBACK
            say(f"note: a drive without torques of the wheels can only be filtered: --filter {chosen}")
        if chosen is None:
            self._believe(logs)
        else:
            self._filter_all(logs, chosen)

    def _believe(self, logs: Sequence[Log]) -> None:
        """The soil under every drive."""
        from agents.reports.figures.soil_belief import soil_belief_figure
        from agents.reports.soil_belief import Report, show_details, show_report
        from estimators.belief.forecast import prediction_errors
        from estimators.belief.limits import limits_of, sampled_limits
        from estimators.logs import quality

        runs = []
        for log, name in zip(logs, _distinct([log.name for log in logs]), strict=True):
            checks = quality(log)
            self._show_quality(checks, brief=not self.details)
            belief = self._believed(log)
            holds = limits_of(sampled_limits(belief))
            report = Report(belief=belief, holds=holds, prediction=prediction_errors(belief))
            show_report(report)
            if self.details:
                show_details(report)
            runs.append((name, report, {"hash": log.hash, "quality": checks.to_dict()}))
        # Figures come last: a drawing that fails loses no result.
        self.save_numbers({"runs": [report.numbers() | more for _, report, more in runs]})
        for name, report, _ in runs:
            self.save_figure(soil_belief_figure(report), f"soil_{name}")

    def _believed(self, log: Log) -> SoilBelief:
        from rich.progress import Progress

        from estimators.belief.soil_belief import believe_log
        from estimators.belief.unknowns import Tolerances

        with Progress(console=console(), transient=True) as bar:
            task = bar.add_task(log.name, total=1.0)

            def tell(share: float, doing: str) -> None:
                bar.update(task, completed=share, description=f"{log.name}: {doing}")

            tolerances = Tolerances(soil=self.tolerance)
            return believe_log(log, structures=self.structure, tolerances=tolerances, progress=tell)

    def _filter_all(self, logs: Sequence[Log], chosen: str) -> None:
        """One filter along every drive."""
        from estimators.filters.registry import filter_id
        from estimators.log_estimation import LOG_FILTERS
        from estimators.logs import quality

        known = filter_id(chosen, LOG_FILTERS)
        names = _distinct([log.name for log in logs])
        rows, numbers = [], []
        for log, name in zip(logs, names, strict=True):
            report = quality(log)
            self._show_quality(report)
            result, reference = self._filter(log, known), _reference(log)
            for note in result.notes:
                say(f"note: {note}")
            rows.append((name, *_row(result, reference)))
            numbers.append(_numbers(result, reference) | {"quality": report.to_dict(), "hash": log.hash})
            self._write(result, reference, f"estimate_{name}_{known}")
        heading = (
            "log",
            "n at the end",
            "flag up",
            "robust sd",
            "robust flag up",
            "evidence alone",
            "innov.²",
            "x real time",
            "truth",
        )
        console().print(table(f"filter {known}", heading, rows))
        say("n, flag: stated by the filter, given its model")
        say("robust: to errors of mass, moduli, sensors and steering in that model (docs/mismatch.md)")
        self.save_numbers({"filter": known, "logs": numbers})

    def _show_quality(self, report: QualityReport, *, brief: bool = False) -> None:
        """The table of the data, what it shows, and a refusal where a model would be blamed for the data."""
        if not brief:
            heading, rows = report.table()
            title = f"{report.name}: {report.rows} rows, {report.duration:.1f} s"
            console().print(table(title, heading, rows, texts=2))
        for finding in report.findings:
            say(f"{finding.severity}: {finding.sentence}")
        if report.problems and not self.accept:
            raise DataError(
                f"{report.name}: {report.problems[0].sentence} - offroad log check prints a line "
                "where one mends it; or go on with --accept"
            )

    def _filter(self, log: Log, known: str) -> LogEstimate:
        from rich.progress import Progress

        from estimators.log_estimation import estimate_log

        with Progress(console=console(), transient=True) as bar:
            task = bar.add_task(f"filtering {log.name}", total=None)

            def tell(share: float) -> None:
                bar.update(task, completed=share, total=1.0 if share > 0.0 else None)

            return estimate_log(log, known, n_prior=self.n_prior, sd=self.sd, progress=tell)

    def _write(self, result: LogEstimate, reference: np.ndarray | None, name: str) -> None:
        from agents.reports.figures.estimate_log import log_estimate_figure

        say(f"table: {write_bytes(self.out / f'{name}.csv', result.csv().encode())}")
        self.save_figure(log_estimate_figure(result, reference), name)


def _replayable(log: Log) -> bool:
    """Whether models can be replayed on the log: a drive with the torques of its wheels, or a stand-in's."""
    config = log.config
    driven = config.model == "full" and config.drivetrain == "torque"
    return driven and "steer" in log.channels and bool({"torque_f", "torque_r"} & set(log.channels))


def _distinct(names: Sequence[str]) -> list[str]:
    """File names for the logs: those that stand twice get a number."""
    return [
        name if names.count(name) == 1 else f"{name}_{names[: i + 1].count(name)}"
        for i, name in enumerate(names)
    ]


def _reference(log: Log) -> np.ndarray | None:
    """Times and true n under the front axle, which simulated logs know."""
    import numpy as np

    values = log.references.get("ref_n_f")
    if values is None or log.t is None:
        return None
    known = ~np.isnan(values)
    return np.column_stack([log.t[known], values[known]])


def _row(result: LogEstimate, reference: np.ndarray | None) -> tuple[str, ...]:
    numbers = _numbers(result, reference)
    truth = numbers["truth_at_end"]
    return (
        f"{result.stated.n[-1]:.3f} ± {result.stated.sd[-1]:.3f}",
        f"{100.0 * numbers['valid_share']:.0f} %",
        f"{result.robust.sd[-1]:.3f}",
        f"{100.0 * numbers['robust_valid_share']:.0f} %",
        f"{result.robust.posterior_n[-1]:.3f} ± {result.robust.posterior_sd[-1]:.3f}",
        "" if numbers["innovations"] is None else f"{numbers['innovations']:.2f}",
        f"{result.stated.real_time_factor:.0f}",
        "" if truth is None else f"{truth:.3f}",
    )


def _numbers(result: LogEstimate, reference: np.ndarray | None) -> dict[str, Any]:
    import numpy as np

    stated, robust = result.stated, result.robust
    updates = stated.nis[~np.isnan(stated.nis)]
    truth = inside = None
    if reference is not None and len(reference) > 0:
        truth = float(reference[-1, 1])
        low, high = (np.interp(reference[:, 0], stated.t, side) for side in (stated.low, stated.high))
        inside = float(np.mean((reference[:, 1] >= low) & (reference[:, 1] <= high)))
    return {
        "log": result.log,
        "n": float(stated.n[-1]),
        "sd": float(stated.sd[-1]),
        "low": float(stated.low[-1]),
        "high": float(stated.high[-1]),
        "valid": bool(stated.flag[-1]),
        "valid_share": float(stated.flag.mean()),
        "robust_sd": float(robust.sd[-1]),
        "robust_valid": bool(robust.valid[-1]),
        "robust_valid_share": float(robust.valid.mean()),
        "evidence": [float(robust.posterior_n[-1]), float(robust.posterior_sd[-1])],
        "innovations": float(np.mean(updates)) / stated.channels
        if len(updates) and stated.channels
        else None,
        "repairs": stated.repairs,
        "real_time_factor": stated.real_time_factor,
        "n_range": result.n_range,
        "truth_at_end": truth,
        "coverage": inside,
    }
