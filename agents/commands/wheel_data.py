"""``offroad wheel-data``: measured against predicted forces and sinkage of a single wheel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table

if TYPE_CHECKING:
    from estimators.rig.comparison import RigComparison
    from estimators.rig.trials import RigTrials

__all__ = ["WheelData"]


@dataclass(kw_only=True)
class WheelData(Results):
    """Measured against predicted sinkage, drawbar pull and side force of one wheel in a soil bin.

    The trials are those of Carnegie Mellon University; get them once with: offroad data get
    cmu_single_wheel. Writes the figure wheel_data.png. With --structure, several laws of the wheel are
    compared side by side on the trials that all of them can predict, in wheel_structures.png; the name
    ladder stands for all steps from paper to field with grousers, one law at a time. Nothing is fitted.
    """

    path: Positional[Path | None] = None  #: the published file; default: OFFROAD_DATA, then the cache
    soil: str = "cmu_sand"  #: what the model believes, a soil of the catalogue
    shear: Literal["independent", "resultant"] = "independent"  #: one shear strength each, or one in all
    structure: tuple[str, ...] = ()  #: laws of the wheel, such as full, grid, "field,ruts=none", ladder
    seed: int = 0  #: of the bootstrap behind the intervals

    def run(self) -> None:
        """Load, predict, draw, and print the errors by channel."""
        from estimators.rig.cmu_soil_bin import load_cmu_single_wheel
        from offroad_env.world.datasets import DATASETS, locate

        path = locate("cmu_single_wheel") if self.path is None else self.path
        trials = load_cmu_single_wheel(path)
        if self.structure:
            self._compare_structures(trials)
        else:
            self._compare(trials)
        say(f"data: {DATASETS['cmu_single_wheel'].citation}")

    def _compare(self, trials: RigTrials) -> None:
        """One model: a row for each channel."""
        from agents.demo.measured import score_table
        from agents.reports.figures.wheel_rig import wheel_rig_figure
        from estimators.rig.cmu_soil_bin import CMU_WHEEL
        from estimators.rig.comparison import compare
        from offroad_env.world.descriptions import read_soil

        comparison = compare(trials, read_soil(self.soil).record, CMU_WHEEL, shear=self.shear, seed=self.seed)
        scores = score_table(comparison)
        title = f"{comparison.inside} of {comparison.trials} trials, brackets: 95 % intervals"
        console().print(table(title, scores.heading, scores.rows, texts=scores.texts))
        for reason, count in comparison.outside.items():
            say(f"left out: {count} trials ({reason})")
        self.save_figure(wheel_rig_figure(comparison), "wheel_data")
        self.save_numbers(comparison.to_json())

    def _compare_structures(self, trials: RigTrials) -> None:
        """Several structures: a row for each."""
        from agents.reports.figures.rig_structures import rig_structures_figure
        from estimators.rig.cmu_soil_bin import CMU_WHEEL
        from estimators.rig.structures import compare_structures, structure_names
        from offroad_env.world.descriptions import read_soil

        names = structure_names(self.structure)
        found = compare_structures(trials, read_soil(self.soil).record, CMU_WHEEL, names, seed=self.seed)
        inside = next(iter(found.values())).trials
        title = f"{inside} of {len(trials)} trials that all can predict, RMSE, brackets: 95 % intervals"
        rows = [_structure_row(name, comparison) for name, comparison in found.items()]
        console().print(table(title, _STRUCTURE_HEADING, rows))
        self.save_figure(rig_structures_figure(found), "wheel_structures")
        self.save_numbers({name: comparison.to_json() for name, comparison in found.items()})


#: Of the table of structures.
_STRUCTURE_HEADING = (
    "structure", "sinkage\nmm", "bias\n", "straight\n", "drawbar pull\nN", "bias\n", "straight\n",
    "side force\nN", "bias\n",
)  # fmt: skip


def _structure_row(name: str, comparison: RigComparison) -> tuple[str, ...]:
    """Errors of one structure, measured less predicted; sinkage in mm."""
    from estimators.rig.structures import ladder_title

    cells = [ladder_title(name)]
    for channel, score in comparison.scores.items():
        scale = 1e3 if score.unit == "m" else 1.0
        low, high = (scale * value for value in score.rmse_interval)
        cells += [f"{scale * score.rmse:.1f} [{low:.1f}, {high:.1f}]", f"{scale * score.bias:+.1f}"]
        if channel != "side_force":
            cells.append(f"{scale * comparison.rmse_at(channel, 0.0):.1f}")
    return tuple(cells)
