"""``offroad identify``: which soil parameters a drive distinguishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table
from offroad_env.errors import InvalidParameter

if TYPE_CHECKING:
    from agents.studies.identifiability.study import Finding

__all__ = ["Identify"]


@dataclass(kw_only=True)
class Identify(Results):
    """Information of a drive about n together with phi, k_phi or c, the vehicle's state being free.

    Fisher information along the drive, the best and the worst determined combination, and
    estimates over noise seeds beside the Cramer-Rao bound. Drives: straight, pulse, sine, circle,
    slalom (full model, level ground), row1 ... row8 of the paper's table, or files of logs. Writes the
    figure identify.png; identify.jsonl keeps what is done, so a second call goes on.
    """

    drives: Positional[tuple[str, ...]] = ("straight", "pulse", "sine", "circle", "slalom")  #: which
    pairs: tuple[Literal["phi", "k_phi", "c"], ...] = ("phi", "k_phi", "c")  #: partners of n
    soil: str = "dry_sand"  #: of the menu's drives: a name, a file *.yaml or inline YAML
    n: float | None = None  #: its sinkage exponent; default: the catalogue's [-]
    duration: float = 10.0  #: of the menu's drives and the rows [s]
    seeds: int = 40  #: noise seeds behind the clouds
    seed: int = 0  #: the first of them
    gnss: bool = False  #: a satellite receiver is on board, too
    jobs: int = 2  #: local processes

    def run(self) -> None:
        """Work through drives and pairs, print, draw."""
        from agents.studies.identifiability.figure import identify_figure
        from agents.studies.identifiability.study import Options, identify

        if not self.drives or not self.pairs:
            raise InvalidParameter("name at least one drive and one of --pairs phi k_phi c")
        if not 1.0 <= self.duration <= 600.0:
            raise InvalidParameter(f"duration must be in [1, 600] s, got {self.duration:g}")
        if not 2 <= self.seeds <= 10000 or self.jobs < 1:
            raise InvalidParameter(
                f"seeds must be in [2, 10000] and jobs >= 1, got {self.seeds} and {self.jobs}"
            )
        options = Options(self.soil, self.n, self.duration, self.seeds, self.seed, self.gnss)
        drives, pairs = tuple(dict.fromkeys(self.drives)), tuple(dict.fromkeys(self.pairs))
        findings = identify(drives, pairs, self.out / "identify.jsonl", options, n_jobs=self.jobs)
        for pair in pairs:
            self._show(pair, [f for f in findings if f.information.parameters[1] == pair])
        self.save_figure(identify_figure(findings), "identify")
        self.save_numbers({"findings": [_numbers(finding) for finding in findings]})

    def _show(self, pair: str, findings: list[Finding]) -> None:
        from estimators.experiments.fisher_information import PARAMETERS

        rows = []
        for finding in findings:
            sd = finding.information.bound.diagonal() ** 0.5
            low, high = finding.excess_band
            shares = finding.information.directions[0]
            rows.append(
                (
                    finding.source,
                    f"{sd[0]:.2g}",
                    f"{sd[1]:.2g}",
                    f"{shares[0]:.1%} | {shares[-1]:.1%}",
                    f"{finding.excess:.2f} ({low:.2f} ... {high:.2f})",
                )
            )
        parameter = PARAMETERS[pair]
        heading = (
            "drive",
            "least sd of n",
            f"of {pair} [{parameter.unit}]",
            "of the prior left: best | worst direction",
            "error² / bound",
        )
        console().print(table(f"n and {pair} (prior ±{parameter.sd:g} {parameter.unit})", heading, rows))
        for finding in findings:
            say(f"{finding.source}: {finding.information.in_words()}")
            if finding.failed:
                say(f"{finding.source}: {finding.failed} of {len(finding.errors)} estimates did not converge")
        say("")


def _numbers(finding: Finding) -> dict[str, Any]:
    information = finding.information
    shares, vectors = information.directions
    return {
        "drive": finding.source,
        "title": finding.title,
        "duration": finding.duration,
        "parameters": information.parameters,
        "information": information.matrix,
        "prior_sd": information.prior_sd,
        "bound": information.bound,
        "sd_if_others_known": information.alone,
        "directions": vectors.T,
        "prior_left": shares,
        "words": information.in_words(),
        "errors": finding.errors,
        "failed": finding.failed,
        "excess": finding.excess,
        "excess_band": finding.excess_band,
    }
