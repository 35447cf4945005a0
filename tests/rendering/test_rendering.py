"""Pictures and recordings: they show what is, change nothing, and say what is missing."""

from __future__ import annotations

import copy
import gc
import io
import math
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from PIL import Image

from agents.driving.figure import drive_figure
from agents.driving.recording import EpisodeLog, record_video
from helpers import run_fresh
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.rewards import ENDINGS
from offroad_env.environment.vector_env import make_vec
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.rendering import FRAME_SIZE, Renderer
from offroad_env.rendering.history import History
from offroad_env.rendering.side import SideView, axle_place

WIDTH, HEIGHT = FRAME_SIZE
ACTIONS = [np.array([0.4 * math.sin(0.1 * k), 0.5]) for k in range(12)]


def started(n=None, seed=5, **kwargs):
    env = OffroadBekkerEnv(**{"render_mode": "rgb_array", **kwargs})
    env.reset(seed=seed, options=None if n is None else {"n": n})
    return env


def same(left, right):
    """Equality of nested observations and infos, to the last bit."""
    if isinstance(left, dict):
        return left.keys() == right.keys() and all(same(left[key], right[key]) for key in left)
    if isinstance(left, tuple):
        return all(map(same, left, right))
    return np.array_equal(left, right)


def test_a_frame_is_a_new_array_of_pixels():
    env = started()
    first = env.render()
    assert first.shape == (HEIGHT, WIDTH, 3)
    assert first.dtype == np.uint8
    kept = first.copy()
    for action in ACTIONS:
        env.step(action)
    second = env.render()
    assert np.array_equal(first, kept)
    assert (first != second).any(axis=2).mean() > 0.01
    first[:] = 0  # belongs to the caller


@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
def test_looking_changes_nothing(terrain_info):
    looked, alone = (started(terrain_info=terrain_info) for _ in range(2))
    for action in ACTIONS:
        looked.render()
        looked.render()
        assert same(looked.step(action), alone.step(action))
    assert np.array_equal(looked.state, alone.state)
    assert looked.np_random.bit_generator.state == alone.np_random.bit_generator.state


def test_a_new_episode_starts_with_an_empty_history():
    used = started(seed=1, n=0.5)
    for action in ACTIONS:
        used.step(action)
        used.render()
    used.reset(seed=2, options={"n": 0.9})
    assert np.array_equal(used.render(), started(seed=2, n=0.9).render())


@pytest.mark.parametrize(
    "kwargs",
    [
        {"scenario": "speed", "terrain_info": "truth"},
        {"vehicle_model": "bicycle"},
        {"model": "paper"},
        {"vehicle": "f1tenth", "n": 0.9},
        {"n_range": (0.7, 0.7)},
    ],
    ids=lambda kwargs: " ".join(kwargs),
)
def test_every_kind_of_episode_can_be_drawn(kwargs):
    env = started(**kwargs)
    env.render()
    for action in ACTIONS[:3]:
        env.step(action)
    frame = env.render()
    # Many colours in every panel: nothing was left blank.
    for part in (
        frame[60:600, 20:780],
        frame[60:370, 810:1260],
        frame[390:520, 810:1260],
        frame[540:700, 810:1260],
    ):
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 10


def test_a_diverged_state_shows_the_last_sound_one():
    env = started()
    before = env.render()
    env.state[:] = math.nan
    env._episode["time"] += 0.02
    env._episode["ending"] = ENDINGS.index("diverged")
    after = env.render()
    differing = (before != after).any(axis=2)
    assert differing[:44].any()  # the verdict in the header
    assert not differing[44:].any()


def test_the_side_view_is_at_rest_where_the_vehicle_is():
    env = started(n=0.6)
    snapshot = env.snapshot()
    for front, offset in ((True, 0), (False, at.AXLE)):
        axle = axle_place(snapshot, front=front)
        sinkage, ground = (snapshot.readings[offset + i] for i in (at.SINKAGE, at.HEIGHT))
        assert axle.bottom == pytest.approx(ground - sinkage, abs=1e-12)
        # Settled: the springs carry the static load, up to what rolling over uneven ground adds.
        assert axle.mount == pytest.approx(axle.bottom, abs=2e-3)


def test_braking_compresses_the_front_springs():
    env = started(n=0.6)
    for _ in range(25):
        env.step(np.array([0.0, -1.0]))
    front, rear = (axle_place(env.snapshot(), front=front) for front in (True, False))
    assert front.bottom - front.mount > 2e-3
    assert rear.bottom - rear.mount < -1e-3


def test_the_enlarged_soil_touches_the_wheel():
    env = started(n=0.9)
    env.render()
    snapshot = env.snapshot()
    r = env.vehicle.r
    side = SideView(None)
    for front in (True, False):
        axle = axle_place(snapshot, front=front)
        x, line = side._surface(snapshot, axle).T
        arc = r - np.sqrt(np.maximum(r * r - x * x, 0.0)) - axle.sinkage
        under = np.abs(x) < 0.5 * math.sqrt(2.0 * r * axle.sinkage)
        assert line.min() == pytest.approx(-axle.sinkage, abs=1e-3)  # the lowest point of the wheel
        assert np.allclose(line[under & (x >= 0.0)], arc[under & (x >= 0.0)], atol=1e-9)
        assert abs(line[-1]) < 0.02  # ahead: ground that nothing has pressed yet
        assert line[0] < line[-1]  # behind: the rut


def test_history_is_thinned_to_what_a_chart_can_show():
    env = started()
    history = History()
    snapshot = env.snapshot()
    for k in range(1500):
        object.__setattr__(snapshot, "time", 0.02 * k)
        history.add(snapshot)
        history.add(snapshot)  # the same moment twice counts once
    assert len(history.rows) == 1500
    thinned = history.thinned(200)[:, history.TIME]
    assert len(thinned) <= 201
    assert thinned[0] == 0.0
    assert thinned[-1] == history.rows[-1, history.TIME]


def test_a_rendered_environment_can_be_copied():
    env = started()
    env.step(ACTIONS[0])
    env.render()
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert twin.render().shape == (HEIGHT, WIDTH, 3)
        assert same(twin.step(ACTIONS[1]), copy.deepcopy(env).step(ACTIONS[1]))


# ---------------------------------------------------------------------- windows


def test_a_window_is_fed_by_every_step_until_it_is_closed():
    pygame = pytest.importorskip("pygame")
    env = started(render_mode="human")
    try:
        assert env.render() is None
        shown = pygame.display.get_surface()
        assert shown.get_size() == FRAME_SIZE
        before = pygame.surfarray.array3d(shown)
        for action in ACTIONS[:4]:
            env.step(action)
        assert (pygame.surfarray.array3d(shown) != before).any()
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        env.step(ACTIONS[5])
        assert env._renderer.closed_by_user
        assert not pygame.display.get_init()
        env.step(ACTIONS[6])  # the episode goes on unseen
        assert env.render() is None
    finally:
        env.close()


def test_a_window_stays_open_until_the_last_environment_that_draws_in_it_is_closed():
    pygame = pytest.importorskip("pygame")
    one, other = (started(render_mode="human") for _ in range(2))
    try:
        one.close()
        other.step(ACTIONS[0])
        assert not other._renderer.closed_by_user
        assert pygame.display.get_init()
    finally:
        other.close()
    assert not pygame.display.get_init()


def test_an_environment_that_was_dropped_does_not_hold_the_window_open():
    pygame = pytest.importorskip("pygame")
    one, other = (started(render_mode="human") for _ in range(2))
    del one
    gc.collect()
    other.close()
    assert not pygame.display.get_init()


def test_a_display_that_is_gone_counts_as_closed_by_the_user():
    pygame = pytest.importorskip("pygame")
    one, other = (started(render_mode="human") for _ in range(2))
    third = None
    try:
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        one.step(ACTIONS[0])
        third = started(render_mode="human")  # opens a window of its own
        other.step(ACTIONS[0])
        assert one._renderer.closed_by_user
        assert other._renderer.closed_by_user
        third.step(ACTIONS[0])
        assert not third._renderer.closed_by_user
        pygame.display.quit()  # as other code in the process may do
        third.step(ACTIONS[1])
        assert third._renderer.closed_by_user
        third.step(ACTIONS[2])  # the episode goes on unseen
    finally:
        for env in (one, other, third):
            if env is not None:
                env.close()


def test_a_window_for_many_environments_at_once_is_refused():
    with pytest.raises(InvalidParameter, match='"human" shows one environment, got num_envs=2'):
        gym.make_vec("offroad_env:OffroadBekker-v0", 2, render_mode="human")
    alone = make_vec(1, render_mode="human")
    alone.reset(seed=0)
    alone.close()


def test_closing_twice_is_harmless_and_rendering_opens_again():
    env = started()
    env.close()
    env.render()
    env.close()
    env.close()
    assert env.render().shape == (HEIGHT, WIDTH, 3)


def test_missing_pygame_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = started()
    with pytest.raises(DependencyNotInstalled, match=r"pip install .*offroad-bekker\[view\]"):
        env.render()


def test_a_screen_is_not_needed_and_pygame_comes_late():
    output = run_fresh(
        "import os, sys\n"
        "os.environ.pop('SDL_VIDEODRIVER', None); os.environ.pop('DISPLAY', None)\n"
        "import offroad_env.rendering, gymnasium as gym\n"
        "env = gym.make('offroad_env:OffroadBekker-v0', render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "assert 'pygame' not in sys.modules and 'matplotlib' not in sys.modules\n"
        "print(env.render().shape)\n"
        "import pygame\n"
        "assert not pygame.display.get_init()\n"
    )
    assert output.strip() == f"({HEIGHT}, {WIDTH}, 3)"


def test_a_window_that_nobody_can_see_is_refused():
    output = run_fresh(
        "import os\n"
        "for name in ('SDL_VIDEODRIVER', 'DISPLAY', 'WAYLAND_DISPLAY'): os.environ.pop(name, None)\n"
        "import gymnasium as gym\n"
        "env = gym.make('offroad_env:OffroadBekker-v0', render_mode='human')\n"
        "try: env.reset(seed=0)\n"
        "except gym.error.Error as error: print(error)\n"
    )
    assert "no window can be opened (there is no screen)" in output


@pytest.mark.parametrize(("mode", "fps"), [("ansi", 50.0), ("human", 0.0), ("human", math.nan)])
def test_a_renderer_refuses_what_it_cannot_do(mode, fps):
    with pytest.raises(InvalidParameter, match="must be"):
        Renderer(mode, fps)


# ---------------------------------------------------------------------- recordings


def grey_frames(count=6, size=(64, 96)):
    """Pictures that get lighter by 40 each."""
    return [np.full((*size, 3), 40 * i, np.uint8) for i in range(count)]


def test_mp4_holds_the_pictures_in_order(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    target = tmp_path / "drive.mp4"
    frames = grey_frames(size=(65, 97))  # odd: one row and one column are left out
    assert record_video(iter(frames), target, fps=25) == 6
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mp4"]
    command = [ffmpeg, "-i", str(target), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    assert b"25 fps" in done.stderr
    read = np.frombuffer(done.stdout, np.uint8).reshape(6, 64, 96, 3)
    for frame, truth in zip(read, frames, strict=True):
        assert abs(float(frame.mean()) - float(truth.mean())) < 4.0  # lossy


def test_gif_holds_the_pictures_in_order(tmp_path):
    target = tmp_path / "drive.GIF"
    levels = (0, 64, 128, 191, 255)
    frames = [np.full((64, 96, 3), level, np.uint8) for level in levels]
    assert record_video([*frames, frames[-1]], str(target), fps=25) == 6
    with Image.open(target) as image:
        assert image.n_frames == 5
        for i, level in enumerate(levels):
            image.seek(i)
            assert abs(float(np.asarray(image.convert("RGB")).mean()) - level) < 1.0
            assert image.info["duration"] == (80 if i == 4 else 40)  # the last one was given twice


def test_wide_pictures_are_shrunk_for_gif(tmp_path):
    record_video([np.zeros((360, 1600, 3), np.uint8)] * 2, tmp_path / "wide.gif", fps=10)
    with Image.open(tmp_path / "wide.gif") as image:
        assert image.size == (800, 180)


def test_rendered_frames_become_a_video(tmp_path):
    env = started(scenario="speed")
    frames = []
    for action in ACTIONS[:4]:
        env.step(action)
        frames.append(env.render())
    assert record_video(frames, tmp_path / "drive.gif", fps=50) == 4


def broken_frames():
    yield from grey_frames(2)
    raise OSError("camera fell off")


@pytest.mark.parametrize("name", ["drive.gif", "drive.mp4"])
def test_a_broken_recording_leaves_the_old_one(tmp_path, name):
    pytest.importorskip("imageio")
    target = tmp_path / name
    target.write_bytes(b"old")
    with pytest.raises(OSError, match="camera fell off"):
        record_video(broken_frames(), target, fps=25)
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("frames", "name", "fps", "message"),
    [
        (grey_frames(), "drive.avi", 25, "must end in .gif or .mp4"),
        (grey_frames(), "drive.gif", 60, r"fps must be in \(0, 50\]"),
        (grey_frames(), "drive.mp4", 0, "fps must be in"),
        (grey_frames(), "nowhere/drive.gif", 25, "a folder that exists"),
        ([], "drive.gif", 25, "at least one picture"),
        ([], "drive.mp4", 25, "at least one picture"),
        ([np.zeros((4, 4, 3))], "drive.gif", 25, "float64 - render_mode"),
        ([np.zeros((4, 4), np.uint8)], "drive.gif", 25, r"\(H, W, 3\)"),
        (
            [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 6, 3), np.uint8)],
            "drive.gif",
            25,
            "of one size, frame 1",
        ),
        ([np.zeros((1, 4, 3), np.uint8)], "drive.mp4", 25, "at least 2 x 2"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path, frames, name, fps, message):
    with pytest.raises(InvalidParameter, match=message):
        record_video(frames, tmp_path / name, fps)
    assert not list(tmp_path.iterdir())


def test_missing_imageio_names_the_extra_and_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(DependencyNotInstalled, match=r"offroad-bekker\[view\].*\.gif"):
        record_video(grey_frames(), tmp_path / "drive.mp4", 25)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------------- logs and their figure


def logged(steps=40, **kwargs):
    env = gym.make("offroad_env:OffroadBekker-v0", **kwargs)
    _, info = env.reset(seed=4, options={"n": 0.6})
    log = EpisodeLog.start(env, info)
    infos = [info]
    for k in range(steps):
        action = np.array([0.5 * math.sin(0.1 * k), 0.6])
        _, _, terminated, _, info = env.step(action)
        log.add(action, info)
        infos.append(info)
        assert not terminated
    return env, log, infos


def test_a_log_keeps_every_step_and_finds_the_place():
    env, log, infos = logged()
    columns = log.columns()
    assert all(values.shape == (41,) for values in columns.values())
    assert np.array_equal(columns["speed"], [info["speed"] for info in infos])
    assert np.array_equal(columns["sinkage_rear"], [info["sinkage"][1] for info in infos])
    assert columns["reward"][-1] == pytest.approx(sum(infos[-1]["reward_terms"].values()), abs=1e-15)
    assert columns["steer"][1:].max() <= 0.5 * env.unwrapped.vehicle.steer_max
    # The state never went into the log: path, progress and cross-track error give the place back.
    assert columns["X"][-1] == pytest.approx(env.unwrapped.state[at.X], abs=1e-6)
    assert columns["Y"][-1] == pytest.approx(env.unwrapped.state[at.Y], abs=1e-6)


def test_a_log_refuses_the_next_episode():
    env, log, _ = logged(steps=3)
    _, info = env.reset(seed=4)
    with pytest.raises(InvalidParameter, match="info must be later"):
        log.add((0.0, 0.0), info)


def test_a_log_knows_how_the_episode_ended():
    env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed")
    _, info = env.reset(seed=0)
    log = EpisodeLog.start(env, info)
    terminated = False
    while not terminated:
        _, _, terminated, _, info = env.step(np.array([1.0, 1.0], np.float32))
        log.add((1.0, 1.0), info)
    assert log.ending == info["failure"] != ""


@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
def test_the_figure_draws_what_was_logged(terrain_info):
    _, log, _ = logged(terrain_info=terrain_info)
    figure = drive_figure(log)
    columns = log.columns()
    by_label = {axes.get_ylabel(): axes for axes in figure.axes}
    speed = by_label["speed [m/s]"].get_lines()[-1]
    assert np.array_equal(speed.get_ydata(), columns["speed"])
    labels = {line.get_label() for line in by_label["sinkage exponent n [-]"].get_lines()}
    assert ("estimate \u00b1 2 sd" in labels) == (terrain_info == "estimate")
    assert "n = 0.60" in figure.get_suptitle()
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=50)
    assert image.getbuffer().nbytes > 10_000
