"""Sampling control: what a plan costs in the model, and that the agent drives by it."""

from __future__ import annotations

import numpy as np
import pytest

from agents.controllers.arms import believe_prior, believe_truth
from agents.controllers.mppi import MppiAgent, MppiSettings, roll_out
from agents.controllers.protocol import Senses
from agents.driving.episode import find_agent
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at


@pytest.fixture(scope="module")
def agent():
    made = MppiAgent(believe_truth)
    made.reset(OffroadBekkerEnv(scenario="speed").briefing)
    return made


def bend(kappa):
    return Senses(0.0, 0.0, 0.0, np.full(8, kappa), 5.0, (5.0, 5.0))


def costs_of(agent, kappa, speeds, n=0.6, limit=15.0):
    """Costs of driving at constant speeds on a bend of that curvature [1/m]."""
    path = agent._laid_out(bend(kappa))
    start = np.zeros(at.STATE_SIZE)
    start[at.V_X] = 5.0
    start[at.OMEGA_F] = start[at.OMEGA_R] = 5.0 / agent._briefing.vehicle.r
    plans = np.zeros((len(speeds), agent.settings.knots, 2))
    plans[..., 0] = np.array(speeds)[:, None]
    costs = np.zeros(len(speeds))
    limits = np.full(len(path.nodes), limit)
    roll_out(start, agent._packed(n), path, plans, limits, agent._gains(), costs)
    return costs


def test_on_a_straight_the_faster_plan_costs_less(agent):
    slow, fast = costs_of(agent, 0.0, (3.0, 7.0))
    assert fast < slow < 0.0
    # 2.4 s at 5 m/s with a change of speed: the cost is the progress.
    assert -18.0 < fast < slow < -6.0


def test_in_a_tight_bend_a_plan_that_leaves_the_corridor_costs_more(agent):
    costs = costs_of(agent, 0.05, (4.0, 14.0), n=0.3)
    assert costs[1] > costs[0] + 10.0


def test_firm_soil_holds_a_speed_at_which_soft_soil_runs_wide(agent):
    soft, firm = (costs_of(agent, 0.08, (8.0,), n=n)[0] for n in (0.3, 1.0))
    assert firm < soft


def test_a_speed_from_which_the_rest_cannot_be_driven_costs(agent):
    free, bound = (costs_of(agent, 0.0, (7.0,), limit=limit)[0] for limit in (15.0, 3.0))
    assert bound > free + 10.0


def test_the_path_is_laid_out_as_the_curvatures_say(agent):
    path = agent._laid_out(bend(0.05))
    centre = np.array([0.0, 20.0])
    radii = np.linalg.norm(path.nodes[:, :2] - centre, axis=1)
    assert radii == pytest.approx(20.0, abs=0.05)
    assert path.nodes[4, :3] == pytest.approx([0.0, 0.0, 0.0])


def test_it_stays_on_the_road_and_repeats_itself():
    env = OffroadBekkerEnv(scenario="speed", terrain_info="truth")
    agent = MppiAgent(believe_truth, MppiSettings(samples=12))
    drives = []
    for _ in range(2):
        observation, info = env.reset(seed=4, options={"n": 0.6})
        agent.reset(env.briefing)
        for _ in range(150):
            observation, _, terminated, _, info = env.step(agent.act(observation))
            assert not terminated
        drives.append((info["progress"], info["cross_track_error"]))
    assert drives[0] == drives[1]
    assert drives[0][0] > 10.0


def test_the_samplers_are_known_by_name_and_the_prior_one_insures_the_whole_prior():
    _, needs = find_agent("mppi_estimate", "speed", None)
    assert needs == "estimate"
    with pytest.raises(InvalidParameter, match='terrain_info must be "truth"'):
        find_agent("mppi_truth", "speed", "none")
    briefing = OffroadBekkerEnv(scenario="speed").briefing
    belief = believe_prior(briefing, None, {})
    assert (belief.low, belief.high) == briefing.n_range
