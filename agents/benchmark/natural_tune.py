"""Tune the knobs of the natural form: ``python -m agents.benchmark.natural_tune --task speed``.

*Common knobs*: one search for the oracle; the other arms drive with what it finds, nominal at the place in
the population that is best with these. *Own knobs*: the same search for each arm, its own knobs included.
*Predictive knobs*: those of model-predictive control by the true limit; then nominal's place and the belief's
insurance with these. All on training episodes. Candidates are a low-discrepancy sample; the better ones drive
more episodes. What is in `agents.controllers.natural_tuned` already is kept unless it is searched anew.
"""

from __future__ import annotations

import runpy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from agents.benchmark.natural import options_of
from agents.benchmark.runner import draw_episodes, run_jobs
from agents.benchmark.tune import COMMON, OWN
from agents.controllers import natural_tuned
from agents.controllers.arms import ARMS, Arm, ArmSettings
from agents.controllers.natural_arms import make_natural_arm
from agents.controllers.nmpc_arms import PREDICTIVE, make_nmpc
from agents.learning.checks import merit
from offroad_env.errors import InvalidParameter

__all__ = [
    "BOXES",
    "PREDICTIVE_BOX",
    "NaturalTuneArgs",
    "search",
    "tune_common",
    "tune_own",
    "tune_predictive",
]

Box = Mapping[str, tuple[float, float]]

#: Knobs of a task with the ranges that are searched. Tyres let go within fewer degrees than rigid rims.
BOXES: dict[str, Box] = {
    **{task: box for task, box in COMMON.items() if task != "patches"},
    "speed": {
        "margin": (0.25, 0.8),
        "feed_forward": (0.0, 1.2),
        "brake_share": (0.1, 0.7),
        "speed_max": (8.0, 15.0),
    },
    "brake": {"brake_share": (0.4, 1.6)},
    # Tyres pull most at a slip of 0.9 on nearly all soils. At 0.3 one soil in ten pulls less by a tenth of
    # the weight, at 0.6 by 0.015.
    "climb": {"slip_share": (0.3, 1.0)},
}
#: Of model-predictive control. The ranges lie around what some 100 training episodes had shown before.
PREDICTIVE_BOX: Box = {
    "margin": (0.6, 0.9),
    "inside": (0.6, 1.3),
    "beyond": (0.5, 1.1),
    "brake_share": (0.25, 0.45),
    "speed_max": (11.0, 15.0),
}
#: Of nominal with common knobs: places in the population.
_PLACES = (0.02, 0.1, 0.18, 0.26, 0.36, 0.5)
_PLACE_EPISODES = 40
#: Of the belief with predictive knobs: standard deviations over which it is insured.
_INSURANCES = (0.0, 0.4, 0.7, 1.0, 1.5)


class Stage(NamedTuple):
    """How many of the candidates drive how many training episodes."""

    candidates: int
    episodes: int


#: Of model-predictive control: as many episodes as for the arms, but more of them at the end, since failures
#: are rare; those that fail in more than this share are chosen by their failures. By the mean alone, in which
#: a failure counts as the time limit, settings were found that failed in 5 of 100 test episodes.
_PREDICTIVE_STAGES, _MOST_FAILURES = (Stage(16, 10), Stage(6, 20), Stage(2, 80)), 0.02


@dataclass(frozen=True, kw_only=True)
class NaturalTuneArgs:
    """Arguments of the search; the budget is the same for every arm."""

    task: str = "speed"
    knobs: tuple[str, ...] = ("common", "own")  #: or "predictive", of `speed` alone
    arms: tuple[str, ...] = tuple(ARMS)  #: whose own knobs are searched
    seed: int = 0  #: of candidates and training episodes
    n_jobs: int = 1
    stages: tuple[Stage, ...] = (Stage(24, 10), Stage(6, 20), Stage(2, 40))
    most_failures: float = 1.0  #: share of failures above which the fewer are better, whatever the mean

    @property
    def budget(self) -> int:
        """Episodes of a search."""
        return sum(stage.candidates * stage.episodes for stage in self.stages)


class Found(NamedTuple):
    """The outcome of a search."""

    settings: dict[str, float]
    score: float  #: mean of the last stage's training episodes
    episodes: int = 0  #: that were driven; none where it was not searched


def _made(arm: str, task: str, settings: Mapping[str, float]) -> Arm:
    if arm in PREDICTIVE:
        return make_nmpc(arm, scenario=task, natural=True, knobs=settings)
    return make_natural_arm(arm, scenario=task, settings=ArmSettings(**settings))


def search(arm: str, candidates: Sequence[Mapping[str, float]], args: NaturalTuneArgs) -> Found:
    """The best of ``candidates`` for an arm, by successive halving."""
    left = list(candidates)
    for stage in args.stages:
        left = left[: stage.candidates]
        draws = draw_episodes(args.task, stage.episodes, args.seed, form="natural", training=True)
        jobs = {i: _made(arm, args.task, settings) for i, settings in enumerate(left)}
        found = run_jobs(
            args.task, jobs, draws, n_jobs=args.n_jobs, env_options=options_of(args.task, "natural")
        )
        merits = [merit(found[i].scores, found[i].success, args.most_failures) for i in jobs]
        left = [left[i] for i in sorted(jobs, key=merits.__getitem__)]
    return Found(dict(left[0]), min(merits)[1], args.budget)


def _sample(box: Box, args: NaturalTuneArgs) -> list[dict[str, float]]:
    rows = qmc.Halton(len(box), rng=np.random.default_rng(args.seed)).random(args.stages[0].candidates)
    ends = np.array(list(box.values()))
    values = ends[:, 0] + rows * (ends[:, 1] - ends[:, 0])
    return [{name: round(float(v), 4) for name, v in zip(box, row, strict=True)} for row in values]


def tune_common(args: NaturalTuneArgs) -> dict[str, Found]:
    """Knobs that all arms share, by the oracle; and the place of nominal. ``z`` of aware is 1."""
    oracle = search("oracle", _sample(BOXES[args.task], args), args)
    return {
        "oracle": oracle,
        "nominal": _one_knob("nominal", oracle.settings, "n", _PLACES, args),
        "conservative": Found(oracle.settings, float("nan")),
        "aware": Found({**oracle.settings, "z": 1.0}, float("nan")),
    }


def _one_knob(
    arm: str, settings: Mapping[str, float], knob: str, values: Sequence[float], args: NaturalTuneArgs
) -> Found:
    """The best value of one knob, the others kept."""
    each = replace(args, stages=(Stage(len(values), _PLACE_EPISODES),))
    return search(arm, [{**settings, knob: value} for value in values], each)


def tune_predictive(args: NaturalTuneArgs) -> dict[str, Found]:
    """Knobs of model-predictive control by the true limit; nominal's place, the belief's insurance."""
    if args.task != "speed":
        raise InvalidParameter(f"predictive knobs are searched for 'speed', got {args.task!r}")
    args = replace(args, stages=_PREDICTIVE_STAGES, most_failures=_MOST_FAILURES)
    truth = search("nmpc_truth", _sample(PREDICTIVE_BOX, args), args)
    return {
        "nmpc_truth": truth,
        "nmpc_nominal": _one_knob("nmpc_nominal", truth.settings, "n", _PLACES, args),
        "nmpc_belief": _one_knob("nmpc_belief", truth.settings, "z", _INSURANCES, args),
    }


def tune_own(args: NaturalTuneArgs) -> dict[str, Found]:
    """Knobs of each arm, the same search for all."""
    boxes = {arm: {**BOXES[args.task], **OWN.get(arm, {})} for arm in args.arms}
    return {arm: search(arm, _sample(box, args), args) for arm, box in boxes.items()}


def write_settings(path: Path, args: NaturalTuneArgs, found: Mapping[tuple[str, str], Found]) -> None:
    """Write the module of tuned settings; what is not in ``found`` is kept. Keys: (arm, knobs)."""
    held = runpy.run_path(str(path))  # anew: another search may have written
    runs, table = dict(held["RUNS"]), dict(held["SETTINGS"])
    for (arm, knobs), result in found.items():
        table[args.task, arm, knobs] = result.settings
        score = f"{result.episodes} episodes: {result.score:.4g} in training"
        runs[f"{args.task} {arm} {knobs}"] = (
            f"seed {args.seed}, {score}" if result.episodes else "not searched"
        )
    lines = [str(natural_tuned.__doc__).join(('"""', '"""')), "", "from __future__ import annotations", ""]
    lines += ['__all__ = ["RUNS", "SETTINGS"]', "", "#: (task arm knobs) -> the search, with its mean score."]
    lines += ["RUNS: dict[str, str] = {", *(f'    "{key}": "{runs[key]}",' for key in sorted(runs)), "}", ""]
    lines += ['#: (task, arm, knobs) -> fields of `ArmSettings`; of `NmpcSettings` where arm is "nmpc_...".']
    lines += ["SETTINGS: dict[tuple[str, str, str], dict[str, float]] = {"]
    for key in sorted(table):
        lines.append(f'    ("{key[0]}", "{key[1]}", "{key[2]}"): {{')
        lines += [f'        "{name}": {value:g},' for name, value in table[key].items()]
        lines.append("    },")
    path.write_text("\n".join([*lines, "}"]) + "\n", encoding="utf-8")


def main() -> None:
    """Tune one task and rewrite `agents.controllers.natural_tuned`."""
    import tyro

    args = tyro.cli(NaturalTuneArgs, description=__doc__)
    for knobs, written, tune in (
        ("common", "common", tune_common),
        ("own", "own", tune_own),
        ("predictive", "common", tune_predictive),
    ):
        if knobs in args.knobs:
            found = {(arm, written): result for arm, result in tune(args).items()}
            write_settings(Path(natural_tuned.__file__), args, found)


if __name__ == "__main__":
    main()
