"""The benchmark as a page for people: what each task asks, who did it how well, what knowing n is worth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from agents.benchmark.figure import arms_figure
from agents.benchmark.learned import LearnedArm, learned_verdict
from agents.benchmark.runner import FORM_TITLES
from agents.benchmark.summary import Benchmark, Difference
from agents.controllers.natural_arms import NATURAL_FORMS
from agents.reports.page import PageVerdict, Picture, Section, Table, figure_picture
from agents.studies.value_of_n.figure import headroom_figure
from offroad_env.environment.scenarios import SCENARIOS

__all__ = ["benchmark_sections", "page_verdict", "verdict"]

#: How to read the page.
READING = (
    "Every agent drives the same courses, soils and sensor noise, so differences are counted episode by "
    "episode. Scores: less is better.",
    "oracle gets the true n, aware the estimate of the online filter, nominal assumes the one n that "
    "does best over all soils, conservative the worst n for the task. The four are one controller "
    "each task, tuned with the same budget on other episodes.",
    "Headroom: how much better the oracle scores than the better of nominal and conservative. That is what "
    "perfect knowledge is worth here, and no estimate can gain more. The share that aware recovers of it is "
    "what the filter is worth.",
    "Brackets are 95 % intervals by bootstrap over episodes. Where an interval holds zero, the episodes do "
    "not show that knowing n pays.",
    "Effect: difference of the means over the standard deviation of the paired differences. 0.2 is small, "
    "0.8 is large. Wins: share of the episodes in which the agent scores better.",
)


def _amount(value: float, unit: str) -> str:
    return f"{abs(value):.3g} {unit}"


def verdict(result: Benchmark) -> str:
    """The result on knowing n in this task, judged by the interval and not by the mean."""
    room = result.headroom
    if room is None:
        return f"{result.scenario}: {result.episodes} paired episodes; no comparison of arms was asked for."
    base = float(result.arm(result.better_uninformed).scores.mean())
    share = f" ({100.0 * abs(room.value) / base:.0f} %)" if base > 0.0 else ""
    known = "what the soil holds" if result.form in NATURAL_FORMS else "n"
    against = f"against {result.better_uninformed}, the better arm without information on {known}"
    if room.low <= 0.0:
        return (
            f"On {result.scenario}, the episodes do not show that knowing {known} pays: {room.value:+.3g} "
            f"[{room.low:+.3g}, {room.high:+.3g}] {result.unit}{share} {against}."
        )
    text = (
        f"On {result.scenario}, knowing {known} is worth {_amount(room.value, result.unit)}{share} "
        f"[{room.low:.3g}, {room.high:.3g}] {against}"
    )
    if result.recovered is not None:
        part = result.recovered
        text += (
            f"; the estimate recovers {100.0 * part.value:.0f} % of that "
            f"[{100.0 * part.low:.0f} %, {100.0 * part.high:.0f} %]"
        )
    return f"{text}."


def page_verdict(results: Mapping[tuple[str, str], Benchmark]) -> PageVerdict:
    """In how many comparisons knowing n pays, and how much of that the estimate recovers."""
    compared = [result for result in results.values() if result.headroom is not None]
    if not compared:
        return PageVerdict(light="neutral", sentence="No arms were compared: the page lists scores only.")
    pays = [result for result in compared if result.headroom is not None and result.headroom.low > 0.0]
    if len(compared) == 1:
        light = "good" if pays else "neutral"
        sentence = f"{verdict(compared[0])[:-1]}, over {_paired(compared)}"
        return PageVerdict(light=light, sentence=f"{sentence}.")  # type: ignore[arg-type]
    sentence = f"Knowing the soil pays in {len(pays)} of {len(compared)} comparisons"
    shares = [result.recovered.value for result in pays if result.recovered is not None]
    if shares:
        ends = dict.fromkeys(f"{100.0 * share:.0f}" for share in (min(shares), max(shares)))
        sentence += f"; there the estimate recovers {' to '.join(ends)} % of it"
    sentence += f" ({_paired(compared)})"
    light = "good" if len(pays) == len(compared) else "caution" if pays else "neutral"
    return PageVerdict(light=light, sentence=f"{sentence}.")  # type: ignore[arg-type]


def _paired(results: Sequence[Benchmark]) -> str:
    """How many episodes each agent has driven."""
    counts = sorted({result.episodes for result in results})
    ends = dict.fromkeys((counts[0], counts[-1]))
    plural = "" if counts == [1] else "s"
    return f"{' to '.join(map(str, ends))} paired episode{plural}"


def benchmark_sections(
    results: Mapping[tuple[str, str], Benchmark],
    physics: Picture,
    trained: Mapping[tuple[str, str], list[LearnedArm]],
    *,
    command: str,
    seconds: float,
) -> list[Section]:
    """The page: an overview, what the soil changes, then one section a task and form, then the policies."""
    tasks, forms = (" ".join(dict.fromkeys(key[i] for key in results)) for i in (0, 1))
    whole = f"{command} --scenario {tasks} --forms {forms}"
    sections = [_overview(results, whole, seconds), _physics(physics, whole)]
    sections += [_section(result, command) for result in results.values()]
    if trained:
        sections.append(_learned(results, trained, whole))
    return sections


def _learned(
    results: Mapping[tuple[str, str], Benchmark],
    trained: Mapping[tuple[str, str], list[LearnedArm]],
    command: str,
) -> Section:
    verdicts = tuple(learned_verdict(arms, results[place].unit) for place, arms in trained.items())
    rows = []
    for (task, form), arms in trained.items():
        unit = results[task, form].unit
        for arm in arms:
            each = ", ".join(f"{mean:.3g}" for mean in arm.means)
            failed = f"{_percent(arm.failed)} %"
            rows.append((task, form, arm.arm, f"{arm.score:.3g} {unit}", each, failed))
    heading = ("task", "form", "policy", "mean over training seeds", "each seed", "failures")
    return Section(
        name="policies",
        title="Trained policies",
        sees=" ".join(verdicts),
        command=command,
        tables=(Table(heading=heading, rows=tuple(rows), texts=3),),
        notes=(
            "PPO with the action interface plan: five times a second an offset to the steering of a tracker "
            "and a correction of the n behind its speed plan. ppo_aware sees the estimate, ppo_oblivious "
            "does not, ppo_memory sees its last two seconds instead.",
            "Without a speed plan: ppo_tracker gives a tracker without soil model the speed to "
            "drive; ppo_direct steers and drives, ten times a second.",
            "Brackets are Student's 95 % intervals over training seeds.",
        ),
        data={f"{task}.{form}": arms for (task, form), arms in trained.items()},
    )


def _physics(picture: Picture, command: str) -> Section:
    return Section(
        name="physics",
        title="What the soil changes in each task",
        sees="Every task has its reason in physics, written down before any agent drove it.",
        command=command,
        pictures=(picture,),
        notes=tuple(f"{task.name}: {_plain(task.reason)}" for task in SCENARIOS.values()),
    )


def _overview(results: Mapping[tuple[str, str], Benchmark], command: str, seconds: float) -> Section:
    compared = [result for result in results.values() if result.headroom is not None]
    pays = sum(result.headroom is not None and result.headroom.low > 0.0 for result in compared)
    return Section(
        name="overview",
        title="What knowing the soil is worth",
        sees=f"Knowing n pays (interval above zero) in {pays} of {len(compared)} comparisons.",
        command=command,
        pictures=(
            figure_picture(
                headroom_figure(compared),
                "Left: headroom in per cent of the better uninformed score, green where its interval "
                "excludes zero. "
                "Right: share of it that aware recovers; 100 % is the oracle, dotted 80 %.",
            ),
        )
        if compared
        else (),
        tables=(_overview_table(compared),) if compared else (),
        notes=READING,
        key=tuple((f"{r.scenario}, {r.form}", _key(r)) for r in compared),
        seconds=seconds,
    )


def _key(result: Benchmark) -> str:
    room = result.headroom
    if room is None or room.low <= 0.0:
        return "not shown to pay"
    recovered = "" if result.recovered is None else f", {100.0 * result.recovered.value:.0f} % recovered"
    return f"{_amount(room.value, result.unit)}{recovered}"


def _overview_table(results: list[Benchmark]) -> Table:
    rows = []
    for r in results:
        recovered = "-" if r.recovered is None else f"{_percent(r.recovered.value)} %"
        if r.recovered is not None:
            recovered += f" [{_percent(r.recovered.low)}, {_percent(r.recovered.high)}]"
        room = f"{r.headroom:.3g} {r.unit}"
        rows.append((r.scenario, r.form, r.better_uninformed, room, recovered, f"{r.episodes}"))
    heading = ("task", "form", "better uninformed", "headroom", "recovered by aware", "episodes")
    return Table(heading=heading, rows=tuple(rows), texts=3)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}" if math.isfinite(share) else "-"


def _section(result: Benchmark, command: str) -> Section:
    task = SCENARIOS[result.scenario]
    return Section(
        name=f"{result.scenario}_{result.form}",
        title=f"{result.scenario}, {FORM_TITLES[result.form]}",
        sees=verdict(result),
        command=f"{command} --scenario {result.scenario} --forms {result.form}",
        pictures=(figure_picture(arms_figure(result), "Every episode, and means with 95 % intervals."),),
        tables=(_scores(result), _differences(result)) if result.against else (_scores(result),),
        notes=(_plain(task.reason), f"Score: {result.measure} [{result.unit}]."),
        data=result.to_dict(),
    )


def _scores(result: Benchmark) -> Table:
    rows = tuple(
        (
            summary.name,
            f"{summary.score:.3g}",
            f"{summary.score_iqm:.3g}",
            f"{_percent(1.0 - summary.success.value)} % "
            f"[{_percent(1.0 - summary.success.high)}, {_percent(1.0 - summary.success.low)}]",
            ", ".join(f"{cause.replace('_', ' ')} {n}" for cause, n in summary.failures.items()) or "-",
            f"{1e6 * summary.step_time:.0f}",
            f"{1e6 * summary.env_time:.0f}",
        )
        for summary in result.summaries
    )
    unit = result.unit
    heading = ("agent", f"mean score [{unit}]", f"interquartile mean [{unit}]", "failures", "causes")
    return Table(heading=(*heading, "agent [us/step]", "environment [us/step]"), rows=rows)


def _differences(result: Benchmark) -> Table:
    rows = tuple(_difference_row(d, result.unit) for d in result.against)
    heading = (f"less {result.better_uninformed}", "difference", "effect", "wins")
    return Table(heading=heading, rows=rows)


def _difference_row(difference: Difference, unit: str) -> tuple[str, str, str, str]:
    return (
        difference.name,
        f"{difference.score:+.3g} {unit}",
        f"{difference.effect:+.2f}",
        f"{_percent(difference.wins.value)} % "
        f"[{_percent(difference.wins.low)}, {_percent(difference.wins.high)}]",
    )


def _plain(text: str) -> str:
    """Without the marks that set off names in sources."""
    return text.replace("`", "")
