"""Pictures of long studies, drawn again from the numbers that the pages print: nothing is simulated.

python benchmarks/page_figures.py                      # writes into docs/images
python benchmarks/page_figures.py --only mismatch --out /tmp

Tables are read from the page itself, so that picture and table cannot differ.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from agents.benchmark.statistics import Interval
from agents.benchmark.summary import Benchmark
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.studies.model_mismatch.figure import mismatch_figure
from agents.studies.model_mismatch.study import BARS
from agents.studies.value_of_n.figure import headroom_figure
from estimators.experiments.mismatch_comparison import MismatchSummary
from estimators.experiments.model_mismatch import MISMATCHES
from estimators.filters.registry import FILTERS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
#: Rows of the tables of model mismatch, in the order of `MISMATCHES`.
MISMATCH_ROWS = (
    "none (matched model)", "mass ±10 %", "map height error 1 cm", "map shift 0.5 m", "k_phi ±20 %",
    "IMU bias, 2° misaligned", "steering lag 50 ms", "slip sinkage", "all together",
)  # fmt: skip
#: A value with its interval: 4.1 [2.4, 6.5]
INTERVAL = re.compile(r"(-?[\d.]+) \[(-?[\d.]+), (-?[\d.]+)\]")


def table_of(page: Path, first: str) -> list[list[str]]:
    """Rows of the tables of a page whose heading begins with that cell, heading included."""
    rows: list[list[str]] = []
    inside = False
    for line in page.read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            inside = False
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        inside = inside or cells[0] == first
        if inside and not set(line) <= set("|-"):
            rows.append(cells)
    return rows


def interval_of(text: str) -> Interval | None:
    """Value and interval in a cell; None where there is none."""
    found = INTERVAL.search(text)
    return Interval(*map(float, found.groups())) if found else None


def summary_of(name: str, mismatch: str, cell: str) -> MismatchSummary:
    """One entry "error / coverage / flag" of a table of model mismatch, each in per cent."""
    parts = re.sub(r"\(.*\)", "", cell).split("/")
    error, coverage, flag = (float(part.replace("-", "nan").strip()) / 100.0 for part in parts)
    nan = float("nan")
    return MismatchSummary(name, mismatch, 0, error, nan, coverage, flag, nan, nan, 0, nan)


def summaries_of(page: Path) -> list[MismatchSummary]:
    """All entries of the tables of model mismatch of a page."""
    found, names = [], dict(zip(MISMATCH_ROWS, MISMATCHES, strict=True))
    filters: list[str] = []
    for row in table_of(page, "mismatch"):
        if row[0] == "mismatch":
            filters = [cell.strip("`") for cell in row[1:]]
        elif filters[0] in FILTERS:
            found += [summary_of(f, names[row[0]], cell) for f, cell in zip(filters, row[1:], strict=True)]
    return found


def mismatch() -> Figure:
    return mismatch_figure(
        summaries_of(DOCS / "mismatch.md"), summaries_of(DOCS / "details" / "mismatch_filters.md"), BARS
    )


def result_of(cells: list[str]) -> Benchmark:
    """A row of the benchmark's table, with as much as the picture needs."""
    task, form = re.sub("`", "", cells[0]).split(", ", 1)
    found = re.match(r"(\w+) ([\d.]+) (\w+)", cells[1])
    assert found is not None, cells
    better, base, unit = found.groups()
    episode = EpisodeResult(
        seed=0, n=0.0, success=True, failure="", time=0.0, progress=0.0, score=float(base), reward=0.0,
        cross_track_rms=0.0, step_time=0.0, env_time=0.0,
    )  # fmt: skip
    recovered = interval_of(cells[4].replace(" %", ""))
    return Benchmark(
        scenario=task,
        form=form,
        seed=0,
        measure="",
        unit=unit,
        arms=(ArmResult(name=better, time_limit=0.0, episodes=(episode,)),),
        summaries=(),
        finished_by_all=0,
        headroom=interval_of(cells[3]),
        better_uninformed=better,
        against=(),
        recovered=recovered
        and Interval(recovered.value / 100.0, recovered.low / 100.0, recovered.high / 100.0),
    )


def benchmark() -> Figure:
    rows = table_of(DOCS / "benchmark.md", "task, form")
    return headroom_figure([result_of(row) for row in rows if row[0] != "task, form"])


FIGURES: dict[str, Callable[[], Figure]] = {"benchmark": benchmark, "mismatch": mismatch}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=list(FIGURES), default=list(FIGURES))
    parser.add_argument("--out", type=Path, default=DOCS / "images")
    arguments = parser.parse_args()
    for name in arguments.only:
        path = arguments.out / f"{name}.png"
        FIGURES[name]().savefig(path, dpi=130, pil_kwargs={"optimize": True})
        print(path)


if __name__ == "__main__":
    main()
