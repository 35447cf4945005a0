"""One episode of a benchmark, driven once more for its page."""

from __future__ import annotations

import json

import gymnasium as gym

from agents.benchmark.natural import options_of
from agents.benchmark.runner import ENV_ID, draw_episodes
from agents.benchmark.study import BenchmarkArgs
from agents.driving.episode import Drive, find_agent
from agents.driving.playback import episode_playback
from agents.driving.unwrapped import bekker_env
from agents.reports.page import Section

__all__ = ["drive_section"]

#: Whose drive is shown, if it drives: its estimate of the soil can be seen.
_SHOWN = "aware"


def drive_section(args: BenchmarkArgs, *, terrain_info: str | None = None) -> Section:
    """The first episode of the first task, by the agent that estimates the soil if there is one.

    ``terrain_info`` is what agents that are given as ``module:Class`` observe of the soil.
    """
    task, form = args.cells[0]
    name = _SHOWN if _SHOWN in args.agents else args.agents[0]
    own = terrain_info if ":" in name else None
    agent, shown = find_agent(args.driver(name, form), task, own, form=form)
    world = json.loads(args.world) if args.world else {}
    env = gym.make(ENV_ID, terrain_info=shown, **options_of(task, form, world))
    draw = draw_episodes(task, args.episodes, args.seed, form=form, world=world)[0]
    drive = Drive(env, agent, seed=draw.seed, options=draw.options)
    try:
        for _ in drive:
            pass
        shown_env = bekker_env(env)
        playback = episode_playback(drive.log, shown_env.briefing, shown_env.plant)
    finally:
        env.close()
    return Section(
        name="drive",
        title=f"One episode: {name} on {task}",
        sees=f"The first of {args.episodes} episodes, as {name} drives it: it {drive.ending}.",
        playback=playback,
    )
