"""Pictures of long studies, drawn again from the numbers that the pages print: nothing is simulated.

python benchmarks/page_figures.py                      # writes into docs/images
python benchmarks/page_figures.py --only mismatch --out /tmp

Tables are read from the page itself, so that picture and table cannot differ. Numbers that only the study's
first picture showed lie beside that picture, as read from it.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from agents.benchmark.statistics import Interval
from agents.benchmark.summary import Benchmark
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.studies.fault_detection.figure import diagnosis_figure
from agents.studies.fault_detection.one_log import Numbers
from agents.studies.fault_detection.results import share_of
from agents.studies.model_mismatch.figure import mismatch_figure
from agents.studies.model_mismatch.study import BARS
from agents.studies.speed.figure import speed_figure
from agents.studies.speed.study import Ratio, Speed
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


#: Bar of the rates -> row of their table, and the share that is required (least, most).
RATES = {
    "false alarms, upper end": ("no fault: false alarms", 0.0, 0.07),
    "one effect: detected": ("one effect at twice its limit: detected", 0.95, 1.0),
    "one effect: truth in a set": ("truth in the set", 0.95, 1.0),
    "one effect: interval holds the truth": ("interval holds the truth", 0.9, 0.98),
    "two effects: truths in the sets": ("two effects: truths in the sets", 0.9, 1.0),
    "true effect not in the library: wrong name": ("both together", 0.0, 0.05),
    "files in another order: same verdict": ("files and library in another order: same verdict", 1.0, 1.0),
}


def rates_of(rows: list[list[str]]) -> list[Numbers]:
    """Bars of the diagnosis, from the table of its rates."""
    found = {cells[0]: cells for cells in rows}
    bars = []
    for what, (row, least, most) in RATES.items():
        hits, count = int(found[row][2].split()[0]), int(found[row][1])
        bars.append({"what": what, "least": least, "most": most} | share_of(hits, count))
    return bars


def diagnosis_rates() -> Figure:
    page, beside = DOCS / "details" / "diagnosis_rates.md", DOCS / "images" / "diagnosis_rates.json"
    kept = json.loads(beside.read_text(encoding="utf-8"))
    points = [
        {"size": point["size"]} | share_of(point["hits"], point["count"]) for point in kept["power"]["points"]
    ]
    numbers = {
        "confusion": kept["confusion"],
        "bars": rates_of(table_of(page, "logs")),
        "power": kept["power"] | {"points": points},
    }
    return diagnosis_figure(numbers)


def ratio_of(cells: list[str]) -> Ratio:
    """A row of the table of speeds."""
    # "vector of 64 / `env.step`, both with X, by the clock": what comes after the peer holds for both.
    ours, _, rest = cells[0].replace("`", "").partition(" / ")
    peer, *how = rest.split(", ")
    both = [part.removeprefix("both ") for part in how if part.startswith("both ")]
    value = INTERVAL.search(cells[2])
    promise = re.search(r"at \w+ ([\d.]+)", cells[3])
    nan = float("nan")
    measured = map(float, value.groups()) if value else (nan, nan, nan)
    middle, low, high = measured
    return Ratio(
        ours=" ".join([ours, *both]),
        peer=peer,
        kind=cells[1],
        clock="by the clock" in how,
        value=middle,
        low=low,
        high=high,
        ours_us=nan,
        peer_us=nan,
        bar=float(promise.group(1)) if promise else None,
    )


def speed() -> Figure:
    page = DOCS / "speed.md"
    ratios = [ratio_of(cells) for cells in table_of(page, "ours / peer") if cells[1] in ("rate", "time")]
    steps: dict[str, dict[int, tuple[float, float]]] = {"vector": {}, "vector with the UKF": {}}
    for size, *times in table_of(page, "environments in the vector")[1:]:
        (cpu, clock), (cpu_filter, clock_filter) = (map(float, cell.split("/")) for cell in times)
        steps["vector"][int(size)] = (cpu, clock)
        steps["vector with the UKF"][int(size)] = (cpu_filter, clock_filter)
    return speed_figure(
        Speed(ratios=tuple(ratios), sides_us={}, vector_us=steps, missing=(), processors=2, rounds=5)
    )


FIGURES: dict[str, Callable[[], Figure]] = {
    "benchmark": benchmark, "diagnosis_rates": diagnosis_rates, "mismatch": mismatch, "speed": speed,
}  # fmt: skip


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
