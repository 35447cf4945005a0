"""``offroad drive``: one episode as a plot, a video or in a window."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from agents.commands.options import TerrainInfo, option_value
from agents.driving.world_options import WorldOptions, known_scenario
from agents.reports.output import OutputError, Results, console, say, table, write_bytes
from offroad_env.environment.scenario_descriptions import register_scenario
from offroad_env.environment.scenarios import BUILT_IN
from offroad_env.errors import DataError, InvalidParameter, OffroadError
from offroad_env.world.yaml_text import shown

if TYPE_CHECKING:
    import gymnasium as gym

    from agents.controllers.protocol import Agent
    from agents.driving.episode import Drive as Episode

__all__ = ["Drive"]

VehicleModel = Literal["half_car", "bicycle", "four_wheel"]
_USUAL, _AGENT = "track", "pure_pursuit"
#: Terrain information of which a policy can be given one for the other.
_ALIKE = (("estimate", "truth"), ("belief", "limits"))
_KEYBOARD = "keyboard"  # agent that is a person
_CONTROL_RATE = 50  # steps a second
_BEYOND = 2.0  # an action so large is no share in [-1, 1] that misses it by a little
_LONGEST = 3600.0  # [s]
_FPS = {".gif": 5, ".mp4": 25}  # pictures a second; few for GIF, which compresses badly


@dataclass(kw_only=True)
class Drive(Results):
    """Drive one episode and plot it.

    Writes the figure drive_SCENARIO_SEED.png. pure_pursuit and stanley hold a speed and know nothing of the
    soil; nominal, conservative, aware and oracle plan their speed by what they hold the soil to be.
    keyboard opens a window to drive in yourself, by the arrow keys (space brakes, escape ends the drive),
    with the estimate of n drawn as it changes.

    Scenarios: track, speed, climb, brake, ride, patches, a file of one's own.
    """

    scenario: str | None = None  #: name, *.yaml or inline YAML; default: that of the policy, or track
    agent: str = _AGENT  #: one of those above, or module:Class
    policy: Path | None = None  #: a folder of offroad train: its policy drives, in the world of its training
    terrain_info: TerrainInfo | None = None  #: what the agent is shown of the soil; default: what it needs
    n: float | None = None  #: true sinkage exponent; default: drawn from the scenario's range [-]
    seed: int = 0  #: of course, soil and noise
    model: Literal["full", "paper"] = "full"  #: full: wheel spin and slopes; paper: as published
    vehicle_model: VehicleModel = "half_car"  #: bicycle: without heave and pitch; four_wheel: with roll
    world: WorldOptions = field(default_factory=WorldOptions)  #: what is driven on and with
    duration: float | None = None  #: end the episode after this time [s]
    picture: Path | None = None  #: also write a picture half way, .png (needs the extra view)
    video: Path | None = None  #: also write a video, .mp4 or .gif (needs the extra view)
    window: bool = False  #: watch it in a window (needs the extra view)
    log: Path | None = None  #: also write the sensors' readings, .csv, .parquet or .mcap with a .yaml
    log_ground: Literal["known", "unknown"] = "known"  #: whether that .yaml holds the ground

    @classmethod
    def description(cls, arguments: Sequence[str]) -> str:
        """What the command does, with the agents that exist for the scenario among the arguments."""
        from agents.driving.episode import agent_list

        scenario = known_scenario(option_value(arguments, "--scenario", _USUAL))
        return f"{inspect.getdoc(cls)}\n\nAgents of {scenario}: {agent_list(scenario)}."

    def run(self) -> None:
        """Drive, then plot and print."""
        import gymnasium as gym

        from agents.driving.figure import drive_figure

        if self.policy is not None and self.agent != _AGENT:
            raise InvalidParameter(f"give --policy or --agent, not both: got --agent {self.agent}")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise InvalidParameter(f"picture must end in .png, got {self.picture}")
        self.window = self.window or self.agent == _KEYBOARD
        if self.window and (self.video or self.picture):
            raise InvalidParameter(
                "give --window (or the keyboard), or --video and --picture, not both: a window shows itself"
            )
        if self.log is not None and self.log.suffix.lower() not in (".csv", ".parquet", ".mcap"):
            raise InvalidParameter(f"log must end in .csv, .parquet or .mcap, got {self.log}")
        if self.duration is not None and not 0.0 < self.duration <= _LONGEST:
            raise InvalidParameter(f"duration must be in (0, {_LONGEST:g}] s, got {self.duration:g}")
        try:
            episode = self._drive(*self._make())
        except gym.error.Error as error:  # no screen, or drawing is not installed
            raise OffroadError(str(error)) from error
        summary = self._summary(episode)
        rows = [(name, _text(value)) for name, value in summary.items()]
        console().print(table(f"{self.scenario}, seed {self.seed}: {episode.ending}", ("", ""), rows))
        if episode.largest > _BEYOND:
            say(
                f"note: {self.agent} acts by up to {episode.largest:g}: steering and drive are shares from "
                "-1 to 1, what is beyond is cut off (degrees, or N m?)"
            )
        for kind, path in (("picture", self.picture), ("video", self.video), ("log", self.log)):
            if path is not None:
                say(f"{kind}: {path}")
        self.save_figure(drive_figure(episode.log), f"drive_{self.scenario}_{self.seed}")
        self.save_numbers({"summary": summary, "series": episode.log.columns()})

    def _make(self) -> tuple[gym.Env, Agent]:
        import gymnasium as gym

        from agents.benchmark.runner import ENV_ID

        self.scenario = scenario = known_scenario(self.scenario or self._usual_scenario())
        agent, terrain_info = self._driver(scenario)
        mode = "human" if self.window else "rgb_array" if self.video or self.picture else None
        steps = None if self.duration is None else max(round(self.duration * _CONTROL_RATE), 1)
        env = gym.make(
            ENV_ID,
            terrain_info=terrain_info,
            model=self.model,
            vehicle_model=self.vehicle_model,
            render_mode=mode,
            max_episode_steps=steps,
            **self._world(scenario),
        )
        return env, agent

    def _usual_scenario(self) -> str:
        """What is driven where nothing is asked for."""
        return _USUAL if self.policy is None else _scenario_of_policy(self.policy)

    def _world(self, scenario: str) -> dict[str, Any]:
        """Options of the environment: those that the policy has learnt in, but for what is asked for."""
        asked = self.world.env_options()
        if self.policy is None:
            return {"scenario": scenario, **asked}
        from agents.benchmark.natural import options_of

        form, world = _world_of_policy(self.policy)
        differs = [] if form == "matched" else [f"form {form}"]
        differs += [f"{name} {shown(value)}" for name, value in world.items()]
        if differs:
            say(f"world of the policy: {', '.join(differs)}")
        return dict(options_of(scenario, form, {**world, **asked}))

    def _driver(self, scenario: str) -> tuple[Agent, str]:
        """The agent, and the terrain information of the environment that it drives in."""
        from agents.driving.episode import find_agent

        if self.policy is not None:
            return _load_policy(self.policy, self.terrain_info)
        if self.agent == _KEYBOARD:
            from agents.controllers.keyboard import KeyboardAgent

            return KeyboardAgent(), self.terrain_info or "estimate"
        return find_agent(self.agent, scenario, self.terrain_info)

    def _drive(self, env: gym.Env, agent: Agent) -> Episode:
        from agents.driving.episode import Drive as Episode

        options = None if self.n is None else {"n": self.n}
        episode = Episode(env, agent, seed=self.seed, options=options)
        steps = _shown(episode)
        if self.log is not None:
            steps = self._measured(steps, episode, self.log)
        if self.picture is not None:
            steps = self._pictured(steps, episode, self.picture)
        try:
            if self.video is not None:
                self._record(steps, episode, self.video)
            for _ in steps:  # what a video has not used up
                pass
        finally:
            env.close()
        return episode

    def _measured(
        self, steps: Iterator[dict[str, Any]], episode: Episode, path: Path
    ) -> Iterator[dict[str, Any]]:
        from agents.driving.recording import MeasuredRun
        from estimators.logs import write_log

        run = None
        for info in steps:
            if run is None:
                run = MeasuredRun(episode.env, known_ground=self.log_ground == "known")
            else:
                run.add(episode.env)
            yield info
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
        if run is not None:
            write_log(path, run.log(path.stem))

    def _pictured(
        self, steps: Iterator[dict[str, Any]], episode: Episode, path: Path
    ) -> Iterator[dict[str, Any]]:
        from agents.driving.episode import HalfWayPicture
        from agents.reports.page import frame_png

        picture = HalfWayPicture()
        for step, info in enumerate(steps):
            picture.look(episode.env, step, info)
            yield info
        if picture.frame is not None:
            write_bytes(path, frame_png(picture.frame))

    def _record(self, steps: Iterator[dict[str, Any]], episode: Episode, path: Path) -> None:
        import numpy as np

        from agents.driving.recording import VIDEO_FORMATS, record_video

        suffix = path.suffix.lower()
        if suffix not in VIDEO_FORMATS:
            raise InvalidParameter(f"video must end in {' or '.join(VIDEO_FORMATS)}, got {path}")
        every = _CONTROL_RATE // _FPS[suffix]
        pictures = (np.asarray(episode.env.render()) for step, _ in enumerate(steps) if step % every == 0)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            record_video(pictures, path, _FPS[suffix])
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from error

    def _summary(self, episode: Episode) -> dict[str, Any]:
        import numpy as np

        info, columns = episode.info, episode.log.columns()
        summary = {
            "reached the goal": bool(info["success"]),
            "failure": info["failure"] or None,
            "true n [-]": float(info["n"]),
            **{f"drawn: {key}": _brief(value) for key, value in info.get("context", {}).items()},
            "time [s]": float(info["time"]),
            "progress [m]": float(info["progress"]),
            "length of the course [m]": float(info["path_length"]),
            "mean speed [m/s]": float(columns["speed"].mean()),
            "cross-track error, root mean square [m]": float(
                np.sqrt(np.mean(columns["cross_track_error"] ** 2))
            ),
            "deepest sinkage [mm]": 1e3
            * float(max(columns["sinkage_front"].max(), columns["sinkage_rear"].max())),
            "reward [-]": episode.reward,
        }
        if episode.log.estimating:
            summary["estimate of n at the end [-]"] = float(info["n_estimate"])
            summary["its standard deviation [-]"] = float(info["n_estimate_sd"])
        return summary


def _brief(value: Any) -> Any:
    """A drawn value; what has no name is called its own."""
    return "own" if isinstance(value, str) and value.startswith("{") else value


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}" if isinstance(value, float) else str(value or "-").replace("_", " ")


def _kind_of_policy(folder: Path) -> dict[str, Any]:
    """Settings of its training."""
    from agents.learning.policies import KIND, policy_kind

    if not (folder / KIND).exists():
        raise DataError(f"no policy in {folder} - train one with: offroad train --out {folder}")
    return policy_kind(folder)


def _scenario_of_policy(folder: Path) -> str:
    """What it has learnt; of a folder from somebody else no function is called that draws courses."""
    kind = _kind_of_policy(folder)
    name, stated = kind["scenario"], kind.get("course")
    if stated is None and name in BUILT_IN:
        return str(name)
    course = dict(stated) if isinstance(stated, dict) else {"course": None}
    if not isinstance(course.get("course", {}), dict) or course.get("base", _USUAL) not in BUILT_IN:
        raise InvalidParameter(
            f"{folder}: its scenario {shown(name)} is not built in, nor described in the folder - give "
            "--scenario (the file it was trained with)"
        )
    return register_scenario(course).name


def _world_of_policy(folder: Path) -> tuple[str, dict[str, Any]]:
    """Form and options of the environment of its training."""
    from agents.benchmark.runner import FORMS

    kind = _kind_of_policy(folder)
    form, world = kind.get("form", "matched"), kind.get("world", {})
    known = {entry.name for entry in fields(WorldOptions)}
    if form not in FORMS:
        raise DataError(f"{folder}: form must be one of {', '.join(FORMS)}, got {shown(form)}")
    if not isinstance(world, dict) or not set(world) <= known:
        raise DataError(f"{folder}: world must hold {', '.join(sorted(known))}, got {shown(world)}")
    return form, world


def _load_policy(folder: Path, terrain_info: str | None) -> tuple[Agent, str]:
    """The policy, and the terrain information it gets: by default that of its training."""
    from agents.learning.policies import load_policy

    trained = _kind_of_policy(folder)["terrain_info"]
    alike = next((group for group in _ALIKE if trained in group), None)
    if alike is not None and terrain_info is not None and terrain_info not in alike:
        raise InvalidParameter(
            f"terrain_info must be {' or '.join(alike)}, got {terrain_info}: the policy was trained with "
            f"{trained!r}, which has other numbers"
        )
    return load_policy(folder), terrain_info or trained


def _shown(episode: Episode) -> Iterator[dict[str, Any]]:
    """The steps of an episode, with a bar of the way along the course."""
    from rich.progress import Progress

    with Progress(console=console(), transient=True) as bar:
        task = bar.add_task("driving", total=None)
        for info in episode:
            bar.update(task, completed=max(info["progress"], 0.0), total=info["path_length"])
            yield info
