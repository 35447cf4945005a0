"""``offroad wheel-data``: measured against predicted forces and sinkage of a single wheel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table

__all__ = ["WheelData"]


@dataclass(kw_only=True)
class WheelData(Results):
    """Measured against predicted sinkage, drawbar pull and side force of one wheel in a soil bin.

    The trials are those of Carnegie Mellon University; get them once with: offroad data get
    cmu_single_wheel. Writes the figure wheel_data.png.
    """

    path: Positional[Path | None] = None  #: the published file; default: OFFROAD_DATA, then the cache
    soil: str = "cmu_sand"  #: what the model believes, a soil of the catalogue
    shear: Literal["independent", "resultant"] = "independent"  #: one shear strength each, or one in all
    seed: int = 0  #: of the bootstrap behind the intervals

    def run(self) -> None:
        """Load, predict, draw, and print the errors by channel."""
        from agents.demo.measured import score_table
        from agents.reports.figures.wheel_rig import wheel_rig_figure
        from estimators.rig.cmu_soil_bin import CMU_WHEEL, load_cmu_single_wheel
        from estimators.rig.comparison import compare
        from offroad_env.world.datasets import DATASETS, locate
        from offroad_env.world.descriptions import read_soil

        path = locate("cmu_single_wheel") if self.path is None else self.path
        trials = load_cmu_single_wheel(path)
        comparison = compare(trials, read_soil(self.soil).record, CMU_WHEEL, shear=self.shear, seed=self.seed)
        scores = score_table(comparison)
        title = f"{comparison.inside} of {comparison.trials} trials, brackets: 95 % intervals"
        console().print(table(title, scores.heading, scores.rows, texts=scores.texts))
        for reason, count in comparison.outside.items():
            say(f"left out: {count} trials ({reason})")
        say(f"data: {DATASETS['cmu_single_wheel'].citation}")
        self.save_figure(wheel_rig_figure(comparison), "wheel_data")
        self.save_numbers(comparison.to_json())
