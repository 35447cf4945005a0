"""Measured data of other people against the model."""

from __future__ import annotations

from pathlib import Path

from agents.demo.context import Run
from agents.reports.figures.wheel_rig import wheel_rig_figure
from agents.reports.page import Section, Table, figure_picture
from estimators.rig.cmu_soil_bin import CMU_WHEEL, load_cmu_single_wheel
from estimators.rig.comparison import CHANNELS, RigComparison, compare
from offroad_env.errors import DataError
from offroad_env.world.datasets import DATASETS, fetch, locate
from offroad_env.world.soils import SOILS

__all__ = ["score_table", "wheel_section"]

_NAME = "cmu_single_wheel"


def score_table(comparison: RigComparison) -> Table:
    """Errors by channel with 95 % intervals, measured less predicted; sinkage in mm."""
    rows = []
    for channel in CHANNELS:
        score = comparison.scores[channel.name]
        unit, scale = ("mm", 1e3) if channel.unit == "m" else (channel.unit, 1.0)
        low, high = (scale * value for value in score.rmse_interval)
        under, over = (scale * value for value in score.bias_interval)
        rows.append(
            (
                channel.title,
                unit,
                f"{scale * score.rmse:.1f} [{low:.1f}, {high:.1f}]",
                f"{scale * score.bias:+.1f} [{under:+.1f}, {over:+.1f}]",
                f"{scale * score.repeat_sd:.1f}",
            )
        )
    heading = ("measured less predicted", "unit", "RMSE", "bias", "scatter of repeats")
    return Table(heading=heading, rows=tuple(rows), texts=2)


def wheel_section(run: Run) -> Section:
    """The soil-bin trials, from this machine or from their publisher."""
    title = "Measured against predicted"
    try:
        path = _find_data()
    except DataError as error:
        sees = (
            "The measured data can be had neither on this machine nor by download, so this part is left out: "
            f"{error}."
        )
        return Section(name="wheel-data", title=title, sees=sees, command=f"offroad data get {_NAME}")
    result = compare(load_cmu_single_wheel(path), SOILS["cmu_sand"], CMU_WHEEL, seed=run.settings.seed)
    table = score_table(result)
    caption = "Top: measured (points) and predicted (lines). Bottom: measured less predicted."
    return Section(
        name="wheel-data",
        title=title,
        sees=_sentence(result),
        command="offroad wheel-data",
        pictures=(figure_picture(wheel_rig_figure(result), caption),),
        tables=(table,),
        notes=(
            f"The prediction is over {result.inside} of {result.trials} trials; brackets are 95 % intervals.",
            *(f"Left out: {count} trials, {reason}." for reason, count in result.outside.items()),
            f"Data: {DATASETS[_NAME].citation}; licence {DATASETS[_NAME].licence}.",
        ),
        key=tuple((f"Wheel in sand: RMSE of {row[0]}", f"{row[2]} {row[1]}") for row in table.rows),
        data={"comparison": result.to_json()},
    )


def _find_data() -> Path:
    try:
        return locate(_NAME)
    except DataError:
        return fetch(_NAME)


def _sentence(result: RigComparison) -> str:
    sinkage = {kind: [1e3 * value for value in ends] for kind, ends in result.span("sinkage").items()}
    pull = result.span("drawbar")
    return (
        "Straight ahead, over all slips, the wheel in the soil bin sinks {:.0f} to {:.0f} mm where the model "
        "with the plate-measured sand says {:.0f} to {:.0f} mm, and pulls {:+.0f} to {:+.0f} N where it says "
        "{:+.0f} to {:+.0f} N."
    ).format(*sinkage["measured"], *sinkage["predicted"], *pull["measured"], *pull["predicted"])
