"""Learning to steer and drive: what a failure costs, what is seen of the soil, and checks side by side."""

from __future__ import annotations

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.natural import options_of
from agents.benchmark.runner import ENV_ID, draw_episodes
from agents.learning import checks
from agents.learning.action_interface import mirrored
from agents.learning.checks import drive_each, merit, scores_together
from agents.learning.emulated_belief import EmulatedBelief
from agents.learning.models import make_model, start_rolling
from agents.learning.policies import CLIP, PolicyAgent, scaled
from agents.learning.train import TrainArgs, _scaling, configuration_hash, noise_bound, train
from estimators.filters.online_soil_belief import BELIEF_VECTOR
from offroad_env.environment.vector_env import make_vec
from offroad_env.errors import InvalidParameter

pytest.importorskip("stable_baselines3")

from agents.learning.sb3_vec_env import LearningVecEnv

LATERAL, LATERAL_SD = BELIEF_VECTOR.index("lateral"), BELIEF_VECTOR.index("lateral_sd")


def episodes_with_edge(**options):
    envs = make_vec(1, autoreset_mode="SameStep", scenario="speed", threads=1)
    return LearningVecEnv(envs, action_interface="direct", **options)


def test_a_failure_gets_dearer_as_more_episodes_arrive():
    episodes = episodes_with_edge(edge=(0.002, 0.4))

    def price():
        return episodes.get_attr("weights")[0].cross_track

    assert price() == pytest.approx(0.002)
    episodes.reset()
    fail = np.array([[1.0, 0.8]], np.float32)
    while len(episodes._ends) < 1:
        episodes.step(fail)
    episodes._ends.extend([True] * 18)
    episodes._set_price()
    assert price() == pytest.approx(0.002)  # too few to judge by
    while len(episodes._ends) < 20:
        episodes.step(fail)
    assert price() == pytest.approx(0.002 + 0.398 * 0.9)
    while len(episodes._ends) < 22:  # the 21st had begun before
        _, rewards, _, _ = episodes.step(fail)
    # 0.2 a second of time and 0.1 of speed are those of the task.
    assert rewards[0] == pytest.approx(-120.0 * (0.002 + 0.398 * 0.9 + 0.3), abs=1.5)


def test_ten_seconds_of_standing_cost_as_much_as_a_failure():
    totals = []
    for idle in (None, 10.0):
        episodes = episodes_with_edge(idle=idle)
        episodes.seed(0)
        episodes.reset()
        stop = np.array([[0.0, -1.0]], np.float32)
        for _ in range(50):
            episodes.step(stop)
        totals.append(sum(float(episodes.step(stop)[1][0]) for _ in range(100)))
    assert totals[0] - totals[1] == pytest.approx(episodes.get_attr("weights")[0].failure(120.0))


def test_an_untrained_policy_that_shall_roll_asks_for_drive():
    episodes = episodes_with_edge()
    model = make_model("ppo", episodes, seed=0, settings={"n_steps": 2, "batch_size": 2})
    seen = {key: box.sample() * 0.0 for key, box in episodes.observation_space.items()}
    start_rolling(model, 0.2)
    assert model.predict(seen, deterministic=True)[0][1] == pytest.approx(0.2, abs=0.02)


def test_the_way_off_the_path_may_cost_more_than_the_price_of_a_failure_asks_for():
    totals = []
    for centre in (0.0, 0.6):
        episodes = episodes_with_edge(edge=(0.002, 0.4), centre=centre)
        episodes.seed(0)
        episodes.reset()
        off = []
        for _ in range(20):
            _, reward, done, _ = episodes.step(np.array([[0.3, 0.3]], np.float32))
            assert not done[0]
            off.append((float(reward[0]), float(episodes._seen["path"][0, 0])))
        totals.append(np.sum([reward for reward, _ in off]))
    lost = 0.6 * 0.1 * sum((error / 1.5) ** 2 for _, error in off)
    assert totals[0] - totals[1] == pytest.approx(lost, rel=0.3)
    assert lost > 0.01


def test_noise_is_held_at_first_and_drawn_anew_at_every_step_later(tmp_path, monkeypatch):
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

    held = []
    collect = OnPolicyAlgorithm.collect_rollouts

    def noted(model, *args, **options):
        found = collect(model, *args, **options)
        held.append(model.sde_sample_freq)
        return found

    monkeypatch.setattr(OnPolicyAlgorithm, "collect_rollouts", noted)
    small = {
        "total_steps": 16,
        "n_envs": 1,
        "n_steps": 4,
        "batch_size": 4,
        "n_epochs": 1,
        "check_episodes": 0,
    }
    for share, expected in ((1.0, [6, 6, 6, 6]), (0.5, [6, 6, 1, 1])):
        held.clear()
        out = tmp_path / str(share)
        train(
            TrainArgs(
                action_interface="direct", noise_steps=6, held_noise=share, eval_episodes=0, out=out, **small
            )
        )
        assert held == expected


def test_noise_that_is_drawn_anew_at_every_step_may_be_bounded_ever_more_closely(tmp_path, monkeypatch):
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

    found = []
    collect = OnPolicyAlgorithm.collect_rollouts

    def noted(model, *args, **options):
        going_on = collect(model, *args, **options)  # it bounds the noise before the first step
        found.append(float(model.policy.log_std.detach().max()))
        return going_on

    monkeypatch.setattr(OnPolicyAlgorithm, "collect_rollouts", noted)
    small = {"n_envs": 1, "n_steps": 4, "batch_size": 4, "n_epochs": 1, "check_episodes": 0}
    args = TrainArgs(
        **small,
        action_interface="direct",
        total_steps=16,
        log_std=-2.0,
        held_noise=0.5,
        last_log_std=-4.0,
        learning_rate=1e-4,
        eval_episodes=0,
        out=tmp_path,
    )
    assert [noise_bound(args, steps) for steps in (0, 7, 8, 12, 16, 17)] == [
        np.inf,
        np.inf,
        -2.0,
        -3.0,
        -4.0,
        -4.0,
    ]
    train(args)
    assert found[:2] == pytest.approx([-2.0, -2.0], abs=0.01)
    assert found[2] <= -2.0
    assert found[3] == pytest.approx(-3.0, abs=1e-6)


def test_a_policy_that_sees_what_the_path_asks_for_learns_and_drives(tmp_path):
    small = {"total_steps": 8, "n_envs": 1, "n_steps": 4, "batch_size": 4, "n_epochs": 1, "check_steps": 4}
    args = TrainArgs(
        scenario="brake", action_interface="demand", check_episodes=1, eval_episodes=1, out=tmp_path, **small
    )
    assert len(train(args).evaluation) == 1


class Proportional:
    """A network's stand-in that steers to the path and holds its speed."""

    def predict(self, seen, **_):
        path, motion = seen["path"], seen["motion"]
        bend = path[..., 5]
        steer = 3.0 * bend - 0.6 * path[..., 0] - 1.5 * path[..., 1]
        drive = 0.4 * (4.0 - motion[..., 0])
        return np.clip(np.stack([steer, drive], axis=-1), -1.0, 1.0), None


@pytest.mark.parametrize(
    ("task", "form"), [("brake", "matched"), pytest.param("climb", "natural", marks=pytest.mark.check)]
)
def test_episodes_side_by_side_score_as_one_by_one(task, form):
    draws = draw_episodes(task, 2, 0, training=True, form=form)
    scaling = {key: (np.zeros(1), np.ones(1)) for key in ("path", "motion")}
    agent = PolicyAgent(Proportional(), scaling, action_interface="direct")
    together, success = scores_together(
        agent.decide_all, task, draws, form=form, interface="direct", threads=1
    )
    each = drive_each(agent, task, draws, form=form)
    assert together == pytest.approx([episode.score for episode in each])
    assert success.tolist() == [episode.success for episode in each]


def test_more_episodes_than_are_stepped_at_a_time_score_as_one_by_one(monkeypatch):
    monkeypatch.setattr(checks, "_LANES", 2)
    draws = draw_episodes("brake", 5, 0, training=True)
    scaling = {key: (np.zeros(1), np.ones(1)) for key in ("path", "motion")}
    agent = PolicyAgent(Proportional(), scaling, action_interface="direct")
    together, success = scores_together(
        agent.decide_all, "brake", draws, form="matched", interface="direct", threads=1
    )
    each = drive_each(agent, "brake", draws, form="matched")
    assert together == pytest.approx([episode.score for episode in each])
    assert success.tolist() == [episode.success for episode in each]


class Reminded:
    """A network's stand-in that sums all it sees of three frames."""

    def predict(self, seen, **_):
        assert {key: value.shape[-1] for key, value in seen.items()} == {"path": 36, "motion": 15}
        weights = 0.05 * np.sin(np.arange(51.0))
        total = np.concatenate([seen["motion"], seen["path"]], axis=-1) @ weights
        return np.clip(np.stack([total - 0.1, 0.4 - 0.2 * total], axis=-1), -1.0, 1.0), None


def test_a_policy_with_memory_drives_side_by_side_as_it_drives_alone(monkeypatch):
    monkeypatch.setattr(checks, "_LANES", 2)
    draws = draw_episodes("speed", 3, 0, training=True)
    scaling = {"path": (np.zeros(12), np.ones(12)), "motion": (np.zeros(5), np.ones(5))}
    decided = []

    def agent():
        return PolicyAgent(Noting(), scaling, frames=3, action_interface="direct")

    class Noting(Reminded):
        def predict(self, seen, **_):
            found = super().predict(seen)
            decided.append(np.atleast_2d(found[0]))
            return found

    together, _ = scores_together(
        agent().decide_all, "speed", draws, form="matched", interface="direct", threads=1
    )
    side_by_side = np.concatenate(decided)
    decided.clear()
    each = drive_each(agent(), "speed", draws, form="matched")
    assert together == pytest.approx([episode.score for episode in each])
    assert len(decided) > 30
    for action in decided:  # also where episodes fail, whose scores are all the time limit
        assert np.abs(side_by_side - action).max(axis=1).min() < 1e-6


def limits(count, lateral):
    terrain = np.tile(
        np.array([lateral, 0, 8000, 0, 0.5, 0, 400, 0, 0.02, 0, 2, 0, 0.7, 0, 0, 100, 1]), (count, 1)
    )
    return {"terrain": terrain, "imu": np.zeros((count, 5))}


def test_an_emulated_belief_starts_at_the_prior_and_narrows_as_grip_is_used():
    belief = EmulatedBelief(200, 0.1, 0)
    seen = limits(200, 3.0)
    first = belief.shown(seen)
    assert first[:, LATERAL].mean() == pytest.approx(5.6, rel=0.05)
    seen["imu"][:, 1] = 2.4  # four fifths of the limit
    for _ in range(100):
        last = belief.shown(seen)
    assert last[:, LATERAL].mean() == pytest.approx(3.4, rel=0.15)
    assert (last[:, LATERAL_SD] / last[:, LATERAL]).mean() == pytest.approx(0.18, abs=0.04)
    belief.restart(np.arange(200) < 1)
    again = belief.shown(seen)[:, LATERAL]
    assert again[0] > 1.3 * again[1:].mean()


def test_the_errors_of_an_emulated_belief_are_as_large_as_it_states():
    rng = np.random.default_rng(1)
    belief = EmulatedBelief(2000, 0.1, 3)
    seen = limits(2000, 1.0)
    seen["terrain"][:, LATERAL] = 5.6 * np.exp(0.41 * rng.standard_normal(2000))
    seen["imu"][:, 1] = 1.5
    for _ in range(30):
        shown = belief.shown(seen)
    z = np.log(shown[:, LATERAL] / seen["terrain"][:, LATERAL]) / (shown[:, LATERAL_SD] / shown[:, LATERAL])
    assert z.mean() == pytest.approx(0.0, abs=0.1)
    assert z.std() == pytest.approx(1.0, abs=0.1)


def test_the_emulated_belief_begins_as_the_belief_does():
    env = gym.make(ENV_ID, terrain_info="belief", **options_of("speed", "natural"))
    seen, _ = env.reset(seed=0)
    env.close()
    emulated = EmulatedBelief(1, 0.1, 0).shown(limits(1, 5.0))[0]
    for name in ("lateral", "pull", "stopping", "n"):
        at = BELIEF_VECTOR.index(name)
        assert emulated[at] == pytest.approx(seen["terrain"][at], rel=0.25), name
        assert emulated[at + 1] == pytest.approx(seen["terrain"][at + 1], rel=0.25), name


def test_episodes_with_an_emulated_belief_never_show_the_limits():
    envs = make_vec(
        2, autoreset_mode="SameStep", threads=1, terrain_info="limits", **options_of("speed", "natural")
    )
    episodes = LearningVecEnv(envs, action_interface="share", belief_seed=0)
    episodes.seed(0)
    shown = [episodes.reset()]
    for _ in range(150):
        seen, _, done, infos = episodes.step(np.tile([0.0, 0.5], (2, 1)).astype(np.float32))
        shown += [seen, *(infos[i]["terminal_observation"] for i in np.flatnonzero(done))]
    assert len(shown) > 152  # some have ended
    believed = 0
    for seen in shown:
        terrain, demand, share = (np.atleast_2d(seen[key]) for key in ("terrain", "demand", "share"))
        assert (terrain[:, LATERAL_SD] > 0.1).all()
        known = terrain[:, -1:] > 0.5  # until the flag is up it is the middle of the population
        limit = np.where(known, terrain[:, LATERAL, None], 5.6)
        assert share[:, :8] == pytest.approx(np.clip(demand / limit, -4.0, 4.0), rel=1e-4, abs=1e-5)
        believed += int(known.sum())
    assert believed > 20


def test_what_an_emulated_belief_never_varies_moves_no_policy_when_the_belief_itself_does():
    from stable_baselines3.common.running_mean_std import RunningMeanStd

    belief, rows = EmulatedBelief(200, 0.1, 0), RunningMeanStd(shape=(len(BELIEF_VECTOR),))
    driven = limits(200, 3.0)
    driven["terrain"][:, LATERAL] = np.linspace(2.0, 8.0, 200)
    driven["imu"][:, 1] = 1.5
    for _ in range(100):
        rows.update(belief.shown(driven))
    scaler = SimpleNamespace(obs_rms={"terrain": rows}, epsilon=1e-8)
    usual = belief.shown(driven)
    other, softer = usual.copy(), usual.copy()
    for name, value in (("pull_slip_sd", 0.03), ("stuck", 0.1), ("stop_in", 20.0)):
        other[:, BELIEF_VECTOR.index(name)] = value
    softer[:, LATERAL] *= 0.5
    scaling = _scaling(scaler, TrainArgs(terrain_info="belief", emulated=True))
    seen = [scaled({"terrain": terrain}, scaling)["terrain"] for terrain in (usual, other, softer)]
    assert seen[1] == pytest.approx(seen[0], abs=1e-6)
    assert np.abs(seen[2] - seen[0]).max() > 0.5
    plain = _scaling(scaler, TrainArgs(terrain_info="belief"))
    assert np.abs(scaled({"terrain": other}, plain)["terrain"]).max() == CLIP


def test_an_emulated_belief_is_refused_where_none_is_observed(tmp_path):
    with pytest.raises(InvalidParameter, match='emulated needs terrain_info="belief"'):
        train(TrainArgs(emulated=True, out=tmp_path))
    envs = make_vec(1, autoreset_mode="SameStep", scenario="speed", threads=1)
    with pytest.raises(InvalidParameter, match='needs terrain_info="limits"'):
        LearningVecEnv(envs, belief_seed=0)


def test_what_was_added_to_the_arguments_leaves_former_configurations_as_they_were():
    assert configuration_hash(TrainArgs()) == configuration_hash(TrainArgs(edge=None, form="matched"))
    for change in (
        {"form": "natural"},
        {"edge": (0.0, 0.1)},
        {"first_drive": 0.1},
        {"clip_reward": 5.0},
        {"centre": 0.1},
        {"held_noise": 0.5},
        {"last_log_std": -4.0},
    ):
        assert configuration_hash(TrainArgs()) != configuration_hash(TrainArgs(**change))


def test_mirrored_rows_are_those_of_single_observations():
    envs = make_vec(2, scenario="speed", threads=1)
    seen, _ = envs.reset(seed=3)
    for i in range(2):
        alone = mirrored({key: value[i] for key, value in seen.items()})
        assert all(np.array_equal(mirrored(seen)[key][i], alone[key]) for key in alone)


def test_of_two_policies_the_one_that_fails_less_is_kept_and_the_faster_of_those_that_hardly_fail():
    def found(seconds, failures):
        success = np.arange(100) >= failures
        return merit(np.where(success, seconds, 120.0), success, 0.02)

    assert found(50.0, 3) < found(40.0, 4)
    assert found(40.0, 2) < found(50.0, 0)
    assert found(40.0, 0) < found(50.0, 2)


def test_the_policy_that_does_best_on_validation_episodes_is_saved(tmp_path, monkeypatch):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from agents.learning import keep_best

    seen, arrived = [], iter([0, 3, 1])

    def driven(predict, task, draws, **options):
        seen.append((task, draws))
        return np.full(4, 120.0), np.arange(4) < next(arrived)

    monkeypatch.setattr(keep_best, "scores_together", driven)
    scaler = VecNormalize(VecMonitor(episodes_with_edge()))
    model = PPO("MultiInputPolicy", scaler, n_steps=4, batch_size=4, n_epochs=1, device="cpu")
    best = keep_best.KeepBest(scaler, "speed", str(tmp_path / "kept"), every=4, episodes=4, env={})
    files = tmp_path / "kept.zip", tmp_path / "kept.pkl"
    model.learn(8, callback=best)
    assert len(seen) == 2  # before the second batch, and at the end
    kept = [file.read_bytes() for file in files]
    model.learn(4, callback=best, reset_num_timesteps=False)  # does worse
    assert [file.read_bytes() for file in files] == kept
    assert best.best == (pytest.approx(0.25), 120.0)
    tests = {draw.seed for draw in draw_episodes("speed", 4, 0)}
    assert seen[0] == ("speed", draw_episodes("speed", 4, 0, split="validation"))
    assert not tests & {draw.seed for draw in seen[0][1]}


def test_noise_that_is_held_at_first_is_drawn_anew_from_a_share_on():
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from agents.learning.keep_best import FreshNoise

    held = []

    class Watch(BaseCallback):
        def _on_step(self):
            held.append((self.num_timesteps, self.model.sde_sample_freq))
            return True

    scaler = VecNormalize(VecMonitor(episodes_with_edge()))
    settings = {"n_steps": 4, "batch_size": 4, "n_epochs": 1, "use_sde": True, "sde_sample_freq": 6}
    model = PPO("MultiInputPolicy", scaler, device="cpu", **settings)
    model.learn(40, callback=[FreshNoise(0.5), Watch()])
    changed = [steps for steps, frequency in held if frequency == 1]
    assert min(steps for steps, _ in held) < 20 < min(changed) <= 20 + 4 * scaler.num_envs
    assert {frequency for steps, frequency in held if steps <= 20} == {6}
    with pytest.raises(InvalidParameter, match="after must be in"):
        FreshNoise(40.0)


def test_a_run_that_is_to_fail_little_chooses_on_validation_soils(tmp_path, monkeypatch):
    from agents.learning import train as module

    splits = []

    def draws(task, episodes, seed, **options):
        splits.append(options.get("split", "test"))
        return draw_episodes(task, episodes, seed, **options)

    monkeypatch.setattr(module, "draw_episodes", draws)
    monkeypatch.setattr(
        module, "scores_together", lambda *_, **__: (np.array([40.0, 120.0]), np.array([True, False]))
    )
    small = {"total_steps": 4, "n_envs": 1, "n_steps": 4, "batch_size": 4, "n_epochs": 1, "eval_episodes": 0}
    for most, split in ((None, "training"), (0.02, "validation")):
        splits.clear()
        train(
            TrainArgs(
                action_interface="direct", most_failures=most, check_episodes=2, out=tmp_path / split, **small
            )
        )
        assert split in splits
        assert len({*splits, split, "test"}) == 2


def test_a_run_may_begin_with_its_checks_when_the_policy_arrives_somewhere(tmp_path, monkeypatch):
    from agents.learning import train as module

    checked = []

    def check(model, *_):
        checked.append(model.num_timesteps)
        return np.array([40.0]), np.array([True])

    monkeypatch.setattr(module, "_check", check)
    for start, expected in ((0, [0, 8, 16, 20]), (12, [12, 20])):
        checked.clear()
        train(
            TrainArgs(
                action_interface="direct",
                total_steps=20,
                n_envs=1,
                n_steps=4,
                batch_size=4,
                n_epochs=1,
                check_steps=8,
                check_from=start,
                eval_episodes=0,
                out=tmp_path / str(start),
            )
        )
        assert checked == expected
