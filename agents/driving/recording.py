"""Recording an episode: pictures to a video file, readings to columns, measurements to a log."""

from __future__ import annotations

import math
import os
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from estimators.logs import Log, Recorder, StartSpec, TerrainSpec, config_of, truth_of
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.path_geometry import PathTable, path_point

if TYPE_CHECKING:
    from PIL import Image

__all__ = ["VIDEO_FORMATS", "EpisodeLog", "MeasuredRun", "record_video"]

VIDEO_FORMATS = (".gif", ".mp4")

#: Fastest GIF that viewers show as it is meant: they slow down pictures shorter than 20 ms.
_GIF_FPS = 50.0
_GIF_WIDTH = 800  # [pixels]: GIF compresses moving pictures badly


def record_video(frames: Iterable[np.ndarray], path: str | os.PathLike[str], fps: float) -> int:
    """Write pictures as a video, MP4 (H.264) or GIF by the suffix of ``path``.

    The file appears when it is complete: it is written beside its place under another name, which is
    removed if anything goes wrong. Frames are taken one by one, so a generator needs no memory.

    Parameters
    ----------
    frames
        (H, W, 3) uint8 arrays, red first, all of one size. MP4 needs an even size: an odd last row
        or column is left out.
    path
        File to write; its folder must exist.
    fps
        Pictures a second [1/s]. GIF counts in hundredths of a second and allows at most 50; its pictures
        are shrunk to a width of 800 pixels, and equal neighbours become one that stays longer.

    Returns
    -------
    int
        Number of pictures written.

    Raises
    ------
    InvalidParameter
        For another suffix, a folder that does not exist, a rate that is not positive (or above 50 for
        GIF), no pictures, or pictures of another shape or type.
    gymnasium.error.DependencyNotInstalled
        For MP4 without imageio and its ffmpeg.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     record_video((np.full((2, 2, 3), i, np.uint8) for i in range(3)), f"{folder}/grey.gif", 10)
    3
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in VIDEO_FORMATS:
        raise InvalidParameter(f"a video's name must end in {' or '.join(VIDEO_FORMATS)}, got {path.name!r}")
    fastest = _GIF_FPS if suffix == ".gif" else 1000.0
    if not 0.0 < fps <= fastest:
        raise InvalidParameter(f"fps must be in (0, {fastest:g}] for {suffix}, got {fps!r}")
    write = _write_gif if suffix == ".gif" else _write_mp4
    if not path.parent.is_dir():
        raise InvalidParameter(f"a video needs a folder that exists, got {str(path.parent)!r}")
    unfinished = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{suffix}")
    try:
        counted = _Counted(_checked(frames))
        write(counted, unfinished, float(fps))
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return counted.count


class _Counted:
    """An iterator that counts its items."""

    def __init__(self, frames: Iterator[np.ndarray]) -> None:
        self._frames, self.count = frames, 0

    def __iter__(self) -> _Counted:
        return self

    def __next__(self) -> np.ndarray:
        frame = next(self._frames)
        self.count += 1
        return frame


def _checked(frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """The frames, refused if one differs from the first or is no picture."""
    shape = None
    for i, frame in enumerate(frames):
        frame = np.asarray(frame)
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8 or 0 in frame.shape:
            raise InvalidParameter(
                f"frames must be (H, W, 3) uint8, frame {i} is {frame.shape} {frame.dtype} "
                '- render_mode="rgb_array"?'
            )
        if shape is not None and frame.shape != shape:
            raise InvalidParameter(
                f"frames must be of one size, frame {i} is {frame.shape}, the first {shape}"
            )
        shape = frame.shape
        yield frame
    if shape is None:
        raise InvalidParameter("frames must not be empty: a video needs at least one picture")


def _write_gif(frames: Iterator[np.ndarray], path: Path, fps: float) -> None:
    from PIL import Image

    first = _shrunk(Image.fromarray(next(frames)))
    palette = _palette(first)

    def indexed(image: Image.Image) -> Image.Image:
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    rest = (indexed(_shrunk(Image.fromarray(frame))) for frame in frames)
    duration = 10 * round(100.0 / fps)
    indexed(first).save(path, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0)


def _shrunk(image: Image.Image) -> Image.Image:
    """The picture, no wider than a GIF should be."""
    if image.width <= _GIF_WIDTH:
        return image
    return image.resize((_GIF_WIDTH, max(round(image.height * _GIF_WIDTH / image.width), 1)))


def _palette(first: Image.Image) -> Image.Image:
    """One palette for all pictures, as a palette of its own for each would make still areas shimmer.

    Half of it fits the first picture, the rest covers all colours evenly for what comes later.
    """
    from PIL import Image

    fitted = (first.quantize(colors=128, dither=Image.Dither.NONE).getpalette("RGB") or [])[: 3 * 128]
    levels = (0, 64, 128, 191, 255)
    even = [part for r in levels for g in levels for b in levels for part in (r, g, b)]
    holder = Image.new("P", (1, 1))
    holder.putpalette(fitted + even)
    return holder


def _write_mp4(frames: Iterator[np.ndarray], path: Path, fps: float) -> None:
    try:
        import imageio_ffmpeg
        from imageio.v2 import get_writer

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:  # a RuntimeError: the package, but no program in it
        raise DependencyNotInstalled(
            "MP4 needs imageio with its ffmpeg, which is not installed: "
            'pip install "offroad-bekker[view]", or choose a name that ends in .gif'
        ) from error
    frame = next(frames)
    height, width = (2 * (size // 2) for size in frame.shape[:2])
    if not height or not width:
        raise InvalidParameter(f"MP4 needs pictures of at least 2 x 2 pixels, got {frame.shape}")
    # macro_block_size=1: no rescaling to multiples of 16; H.264 itself asks for an even size only.
    options = {"codec": "libx264", "quality": 7, "macro_block_size": 1}
    writer = get_writer(path, format="FFMPEG", mode="I", fps=fps, **options)
    try:
        for picture in chain((frame,), frames):
            writer.append_data(picture[:height, :width])
    finally:  # ``with`` would leave ffmpeg running after an error, to make the file anew
        writer.close()


#: Column of an episode -> how it is read from the environment's info.
_READINGS: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "time": lambda info: info["time"],
    "progress": lambda info: info["progress"],
    "cross_track_error": lambda info: info["cross_track_error"],
    "heading_error": lambda info: info["heading_error"],
    "speed": lambda info: info["speed"],
    "slip_front": lambda info: info["slip"][0],
    "slip_rear": lambda info: info["slip"][1],
    "sinkage_front": lambda info: info["sinkage"][0],
    "sinkage_rear": lambda info: info["sinkage"][1],
    "n_front": lambda info: info["n_front"],
    "n_rear": lambda info: info["n_rear"],
    "n_estimate": lambda info: info["n_estimate"],
    "n_estimate_sd": lambda info: info["n_estimate_sd"],
    "reward": lambda info: sum(info["reward_terms"].values()),
}


@dataclass(kw_only=True)
class EpisodeLog:
    """The course of one episode, one row a control step; row 0 is the start.

    Made by `start` after ``reset``, fed by `add` after every ``step``.
    """

    path: PathTable  #: reference path
    scenario: str
    corridor: float  #: half width of the corridor [m]
    target_speed: float  #: [m/s], 0 = as fast as possible
    n_range: tuple[float, float]  #: prior of the sinkage exponent: uniform [-]
    steer_max: float  #: steering angle of action 1 [rad]
    estimating: bool  #: whether an estimator runs; otherwise its columns hold the prior
    stretches: tuple[tuple[float, float, float], ...] = ()  #: of another n: from, to along the path [m], n
    ending: str = ""  #: "goal", the failure, or "" (time over, or not ended yet)
    rows: list[tuple[float, ...]] = field(default_factory=list)

    @classmethod
    def start(cls, env: Any, info: Mapping[str, Any]) -> EpisodeLog:
        """The log of the episode that ``env.reset()`` has just started, with its ``info`` as row 0."""
        base = env.unwrapped
        briefing, snapshot = base.briefing, base.snapshot()
        low, high = briefing.n_range
        log = cls(
            path=snapshot.course.path,
            scenario=briefing.scenario,
            corridor=briefing.corridor,
            target_speed=briefing.target_speed,
            n_range=briefing.n_range,
            steer_max=briefing.vehicle.steer_max,
            estimating=snapshot.estimate is not None,
            stretches=tuple(
                (start, end, low + place * (high - low)) for start, end, place in snapshot.course.sections
            ),
        )
        log.add((0.0, 0.0), info)
        return log

    def add(self, action: Iterable[float], info: Mapping[str, Any]) -> None:
        """Append what ``action`` led to: the ``info`` of the step.

        Raises
        ------
        InvalidParameter
            When the time of ``info`` is not later than the last row's: a reset needs a new log.
        """
        steer, drive = (min(max(float(value), -1.0), 1.0) for value in action)
        if self.rows and info["time"] <= self.rows[-1][0]:
            raise InvalidParameter(
                f"info must be later than {self.rows[-1][0]:g} s, got {info['time']:g} s "
                "- a log of the episode before?"
            )
        self.rows.append((*(float(read(info)) for read in _READINGS.values()), steer * self.steer_max, drive))
        self.ending = "goal" if info["success"] else info["failure"]

    def columns(self) -> dict[str, np.ndarray]:
        """Name -> (T,) array in SI: readings of ``info``, ``X``, ``Y`` [m], ``steer`` [rad], ``drive`` [-].

        ``steer`` and ``drive`` are the commands that led to the row (drive below 0 brakes). X and Y
        are the true position, put together from path, progress and cross-track error.
        """
        table = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), len(_READINGS) + 2)
        columns = dict(zip((*_READINGS, "steer", "drive"), table.T.copy(), strict=True))
        places = np.array(
            [
                _beside(self.path, s, error)
                for s, error in zip(columns["progress"], columns["cross_track_error"], strict=True)
            ]
        ).reshape(-1, 2)
        return columns | {"X": places[:, 0], "Y": places[:, 1]}


class MeasuredRun:
    """Measurements of the sensors in one episode, as a log (`estimators.logs`).

    The description holds the believed soil, never the true one, and the settled start. Truth is in the
    ``ref_*`` columns, for looking.

    Parameters
    ----------
    env
        From ``gym.make``, just reset.
    known_ground
        Whether the description holds the ground, as from a map, or only how rough it is.
    """

    def __init__(self, env: Any, *, known_ground: bool = True) -> None:
        base = env.unwrapped
        truth, snapshot = base.plant, base.snapshot()
        x, y, yaw, v_x = (float(snapshot.state[i]) for i in (at.X, at.Y, at.YAW, at.V_X))
        belief = truth._replace(vehicle=base.briefing.vehicle, soil=base.briefing.soil)
        config = config_of(belief, base.sensors, StartSpec(x=x, y=y, yaw=yaw, v_x=v_x))
        if not known_ground:
            rms = math.sqrt(0.5 * float(np.square(truth.ground.waves[:, 0]).sum()))
            config = replace(config, terrain=TerrainSpec(kind="unknown", rms=max(rms, 1e-3)))
        measured = base.measurements()
        self._recorder = Recorder(config, period=measured.period)
        self._recorder.start(measured.samples[0], truth_of(snapshot.state, snapshot.readings))

    def add(self, env: Any) -> None:
        """Append the control period that ``env.step()`` has just driven; one that broke off has none."""
        base = env.unwrapped
        measured, snapshot = base.measurements(), base.snapshot()
        if len(measured.samples):
            truth = truth_of(snapshot.state, snapshot.readings)
            self._recorder.hold(measured.command, measured.samples, truth)

    def log(self, name: str) -> Log:
        """The log so far.

        Raises
        ------
        InvalidParameter
            Before the first step.
        """
        return self._recorder.log(name)


def _beside(path: PathTable, s: float, left: float) -> tuple[float, float]:
    """The point ``left`` [m] to the left of the path at arc length ``s`` [m]."""
    x, y, yaw, _ = path_point(path, float(s))
    return x - left * math.sin(yaw), y + left * math.cos(yaw)
