"""Model-predictive control: the model is the table's, the plan keeps its bounds, and no clock decides."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import agents.controllers.nmpc as nmpc
from agents.controllers.arms import believe_fixed, believe_truth
from agents.controllers.natural_arms import TYRE_GAINS
from agents.controllers.nmpc import NmpcAgent, soil_numbers
from agents.controllers.nmpc_arms import PREDICTIVE, make_nmpc
from agents.controllers.nmpc_problem import INPUTS, SOIL, STATES, Horizon, make_problem
from agents.controllers.nmpc_programme import SOLVERS, Programme
from agents.controllers.path_lqg import bend_dynamics
from agents.controllers.protocol import Senses, read_senses
from agents.controllers.speed_planner import Belief, limits_over_n
from agents.driving.episode import find_agent
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter

pytest.importorskip("casadi", reason="needs the extra mpc")
V, S, E = STATES.index("v"), STATES.index("s"), STATES.index("e")


@pytest.fixture(scope="module")
def briefing():
    return OffroadBekkerEnv(scenario="speed").briefing


@pytest.fixture(scope="module")
def numbers(briefing):
    return soil_numbers(briefing.vehicle, limits_over_n(briefing))


@pytest.mark.parametrize("n", [0.3, 0.6, 1.1])
def test_the_axles_of_the_problem_hold_what_the_compiled_wheel_holds(briefing, numbers, n):
    table, soil = limits_over_n(briefing), numbers.at(n, n, 1.0)
    row = int(np.argmin(np.abs(table.grid - n)))
    for axle in range(2):
        D, C, B = soil[3 * axle : 3 * axle + 3]
        fit = D * np.sin(C * np.arctan(B * table.angles))
        assert np.abs(fit - table.side[axle, row]).max() < 0.08 * table.side[axle, row].max()


def test_the_stages_are_linearised_as_finite_differences_say(briefing, numbers):
    problem, rng = make_problem(briefing.vehicle, Horizon(), 0.02), np.random.default_rng(0)
    soil = numbers.at(0.6, 0.6, 0.9)
    x = np.array([0.2, 0.1, 1.0, 6.0, -0.2, 0.3, 0.1, 1.0, 0.1, 1.0])
    u, kappa = np.array([0.1, -0.5]), 0.05
    stages = Horizon().stages
    _, A, B = (np.asarray(part) for part in problem.stage(np.tile(x, (stages, 1)).T, u, soil, kappa))
    for _ in range(5):
        dx, du = 1e-6 * rng.standard_normal(len(STATES)), 1e-6 * rng.standard_normal(len(INPUTS))
        ends = [problem.step(x + s * dx, u + s * du, soil, kappa) for s in (1.0, -1.0)]
        slope = 0.5 * (np.asarray(ends[0]) - np.asarray(ends[1])).ravel()
        assert A[:, : len(STATES)] @ dx + B[:, : len(INPUTS)] @ du == pytest.approx(
            slope, rel=1e-4, abs=1e-11
        )


def test_about_straight_driving_it_is_the_linear_bicycle_of_the_steering_by_lqg(briefing, numbers):
    """The same vehicle, written independently in `path_lqg`: side speed, yaw rate and steering."""
    dt, speed, soil = 1e-5, 6.0, numbers.at(0.6, 0.6, 1.0)
    x = np.zeros(len(STATES))
    x[V], x[STATES.index("push")] = speed, soil[SOIL.index("resistance")]
    _, jacobian = make_problem(briefing.vehicle, Horizon(), dt).short_step(x, soil, 0.0)
    rates = (np.asarray(jacobian)[:, : len(STATES)] - np.eye(len(STATES))) / dt
    places = [STATES.index(name) for name in ("e", "psi", "vy", "r", "steer")]
    stiffness = tuple(float(np.prod(soil[3 * axle : 3 * axle + 3])) for axle in range(2))
    linear, _, _ = bend_dynamics(briefing.vehicle, stiffness, speed)
    assert rates[np.ix_(places, places)] == pytest.approx(linear[:5, :5], abs=2e-3, rel=1e-3)


def planned(briefing, kappa, n, speed=7.0, replans=6):
    """States of the plan on a path of that curvature [1/m] from 15 m on."""
    return planning(briefing, kappa, n, speed, replans)._plan[0]


def planning(briefing, kappa, n, speed, replans=6):
    """The agent that has made it."""
    agent = NmpcAgent(believe_fixed((n - 0.3) / 0.8))
    agent.reset(briefing)
    preview = np.array(briefing.preview)
    path = np.concatenate([[0.0, 0.0, 0.0], np.where(preview >= 15.0, kappa, 0.0), [500.0]])
    seen = {
        "imu": np.array([0.0, 0.0, 0.0, 0.0, 0.0]),
        "motion": np.array([speed, speed, speed, 0.0, 0.0]),
        "path": path,
    }
    for _ in range(replans):  # each one linearises once more
        agent._age = agent.settings.replan
        agent.act(seen)
    return agent


def test_a_plan_goes_faster_on_the_straight_and_slows_down_before_a_bend(briefing):
    straight, bend = (planned(briefing, kappa, 0.7) for kappa in (0.0, 0.08))
    assert straight[-1, V] > 7.2
    assert bend[-1, V] < straight[-1, V] - 1.0
    assert bend[-1, S] < straight[-1, S]


def test_on_soil_with_less_grip_the_plan_enters_the_bend_more_slowly(briefing):
    soft, firm = (planned(briefing, 0.08, n)[-1, V] for n in (0.3, 1.0))
    assert soft < firm - 0.3


def test_a_plan_stays_inside_its_part_of_the_corridor(briefing):
    plan = planned(briefing, 0.08, 0.7, speed=5.0)
    assert np.abs(plan[:, E]).max() < 0.55 * briefing.corridor + 0.05


def asked_of(briefing, monkeypatch, **path):
    """Arguments of the programmes of a plan."""
    asked = []

    class Spy(Programme):
        def solve(self, *args):
            asked.append(args)
            return super().solve(*args)

    with monkeypatch.context() as patched:
        patched.setattr(nmpc, "Programme", Spy)
        planned(briefing, **path)
    return asked


@pytest.mark.parametrize("n", [0.3, 0.7])
def test_a_plan_ends_no_faster_than_what_is_seen_beyond_it_allows(briefing, monkeypatch, n):
    args = asked_of(briefing, monkeypatch, kappa=0.08, n=n, speed=8.0)[-1]
    guess, limits = args[2], args[-1]
    end = Programme(Horizon()).solve(*args)[0][-1]
    assert end[V] < np.interp(guess[-1, S], limits.stations, limits.final) + 0.02


def test_the_way_that_a_plan_gains_by_ending_too_fast_does_not_pay(briefing, monkeypatch):
    *args, limits = asked_of(briefing, monkeypatch, kappa=0.0, n=0.7, speed=7.0)[-1]
    free = limits._replace(speeds=np.full_like(limits.speeds, 15.0), final=np.full_like(limits.final, 15.0))
    slower = free._replace(final=np.full_like(limits.final, 6.5))
    ends = [Programme(Horizon()).solve(*args, each)[0][-1, V] for each in (free, slower)]
    assert ends[0] > 8.0
    assert ends[1] < 6.52


def test_on_its_way_a_plan_keeps_the_speeds_that_the_path_itself_takes(briefing, monkeypatch):
    *args, limits = asked_of(briefing, monkeypatch, kappa=0.0, n=0.7, speed=7.0)[-1]
    slow = limits._replace(speeds=np.full_like(limits.speeds, 6.0))
    free, bound = (Programme(Horizon()).solve(*args, each)[0] for each in (limits, slow))
    assert free[10:, V].min() > 7.0
    assert bound[10:, V].max() < 6.05


def test_those_speeds_are_a_share_of_what_the_soil_holds(briefing, monkeypatch):
    lateral = limits_over_n(briefing).lateral_limit(0.5, 0.5, nmpc.NmpcSettings().slip_angle)
    limits = asked_of(briefing, monkeypatch, kappa=0.08, n=0.5)[-1][-1]
    for share, speeds in (
        (nmpc.NmpcSettings().inside, limits.speeds),
        (nmpc.NmpcSettings().beyond, limits.final),
    ):
        assert 0.08 * speeds[25] ** 2 == pytest.approx(share * lateral)


def test_it_slows_down_for_a_bend_with_its_share_of_what_the_soil_brakes(briefing, monkeypatch):
    limits = asked_of(briefing, monkeypatch, kappa=0.08, n=0.5)[-1][-1]
    braking = limits_over_n(briefing).braking_limit(0.5, 0.5)
    for speeds in (limits.speeds, limits.final):
        slowing = (speeds[4] ** 2 - speeds[12] ** 2) / (2.0 * 8.0)  # from 4 to 12 m ahead
        assert slowing == pytest.approx(nmpc.NmpcSettings().brake_share * braking)
    assert nmpc.NmpcSettings().brake_share < nmpc.NmpcSettings().braking


def test_a_speed_that_cannot_be_met_does_not_lead_a_plan_out_of_the_corridor(briefing, monkeypatch):
    *args, limits = asked_of(briefing, monkeypatch, kappa=0.08, n=0.5, speed=8.0)[-1]
    slow = np.full_like(limits.final, 4.0)
    states, _ = Programme(Horizon()).solve(*args, limits._replace(brake=-0.2, speeds=slow, final=slow))
    assert states[-1, V] > 5.0
    assert np.abs(states[:, E]).max() < 0.55 * briefing.corridor + 0.1


def test_a_drive_beyond_what_the_soil_is_found_to_hold_is_taken_back(briefing, monkeypatch):
    """A belief falls within a decision, the drive does not: there is a plan all the same, and it lets go."""
    command = STATES.index("push_command")
    problem, start, *args, limits = asked_of(briefing, monkeypatch, kappa=0.0, n=0.7, speed=5.0)[-1]
    for driven, held in ((4.4, limits._replace(push=1.0)), (-4.4, limits._replace(brake=-1.0))):
        start = start.copy()
        start[[STATES.index("push"), command]] = driven
        states, _ = Programme(Horizon()).solve(problem, start, *args, held)
        assert held.brake - 0.01 < states[4:, command].min() <= states[4:, command].max() < held.push + 0.01


@pytest.mark.parametrize("kappa", [0.0, 0.08])
def test_the_plan_is_the_one_that_another_solver_finds(briefing, monkeypatch, kappa):
    for args in asked_of(briefing, monkeypatch, kappa=kappa, n=0.5, speed=8.0, replans=4)[1:]:
        ours, other = (Programme(Horizon(), solver=solver).solve(*args) for solver in ("hpipm", "osqp"))
        assert ours[0] == pytest.approx(other[0], abs=0.01)
        assert ours[1][0] == pytest.approx(other[1][0], abs=0.05)


def test_it_stays_on_the_road_and_repeats_itself_to_the_last_digit():
    env, drives = OffroadBekkerEnv(scenario="speed", terrain_info="truth"), []
    agent = NmpcAgent(believe_truth)
    for _ in range(2):
        observation, info = env.reset(seed=4, options={"n": 0.6})
        agent.reset(env.briefing)
        for _ in range(150):
            observation, _, terminated, _, info = env.step(agent.act(observation))
            assert not terminated
        drives.append((info["progress"], info["cross_track_error"]))
    assert drives[0] == drives[1]
    assert drives[0][0] > 12.0


def test_agents_by_name_have_the_belief_that_the_name_says():
    told = {name: find_agent(name, "speed", None)[1] for name in PREDICTIVE}
    assert told == {"nmpc_nominal": "none", "nmpc_belief": "estimate", "nmpc_truth": "truth"}
    natural = {name: find_agent(name, "speed", None, form="natural")[1] for name in PREDICTIVE}
    assert natural == {"nmpc_nominal": "none", "nmpc_belief": "belief", "nmpc_truth": "limits"}
    assert len(SOIL) == 12


def test_tasks_that_it_cannot_plan_are_refused():
    env = gym.make("offroad_env:OffroadBekker-v0", scenario="brake").unwrapped
    with pytest.raises(InvalidParameter, match="line"):
        make_nmpc("nmpc_truth", scenario="brake").agent.reset(env.briefing)


@pytest.mark.parametrize(
    ("name", "highest"),
    [
        ("margin", 1.5),
        ("slip_angle", 0.52),
        ("corridor", 1.0),
        ("inside", 3.0),
        ("beyond", 3.0),
        ("brake_share", 1.0),
        ("braking", 1.0),
        ("speed_max", 50.0),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name, highest):
    assert getattr(nmpc.NmpcSettings(**{name: highest}), name) == highest
    for value in (0.0, 1.01 * highest, float("nan")):
        with pytest.raises(InvalidParameter, match=name):
            nmpc.NmpcSettings(**{name: value})


@pytest.mark.parametrize("name", ["replan", "iterations"])
def test_a_plan_needs_at_least_one_iteration_and_one_step(name):
    with pytest.raises(InvalidParameter, match=name):
        nmpc.NmpcSettings(**{name: 0})


def test_a_plan_brakes_with_its_share_of_what_the_axles_hold(briefing, monkeypatch):
    limits = asked_of(briefing, monkeypatch, kappa=0.08, n=0.5)[-1][-1]
    hold = soil_numbers(briefing.vehicle, limits_over_n(briefing)).at(0.5, 0.5, 1.0)[SOIL.index("hold")]
    assert limits.brake == pytest.approx(-nmpc.NmpcSettings().braking * hold)


def rolling(briefing, command, rims, *, steer=0.0, slips=TYRE_GAINS, speed=8.0):
    """The drive command that is left with these rim speeds [m/s]."""
    agent = NmpcAgent(believe_fixed(0.5), slips=slips)
    agent.reset(briefing)
    agent._x = np.zeros(len(STATES))
    agent._x[[V, STATES.index("steer")]] = speed, steer
    senses = Senses(0.0, 0.0, 0.0, np.zeros(3), speed, rims)
    return agent._kept_rolling(command, senses)


def test_brakes_and_drive_are_let_go_where_wheels_lock_or_spin(briefing):
    assert rolling(briefing, -0.5, (7.8, 7.8)) == -0.5
    assert -0.5 < rolling(briefing, -0.5, (6.5, 7.8)) < 0.0
    assert rolling(briefing, 0.5, (8.5, 8.5)) == 0.5
    assert 0.0 < rolling(briefing, 0.5, (8.5, 11.0)) < 0.5
    assert rolling(briefing, 0.5, (8.5, 13.0)) == 0.0
    # Rigid rims are not looked after: as before.
    assert rolling(briefing, -0.5, (0.0, 0.0), slips=None) == -0.5


def test_a_locked_wheel_is_driven_until_it_rolls(briefing):
    """Soft soil holds it even without brakes, and it does not steer."""
    limit = TYRE_GAINS.brake_slip + TYRE_GAINS.slip_band
    assert rolling(briefing, 0.0, (8.0 * (1.001 - limit), 8.0)) == 0.0
    for command in (-0.5, 0.0):
        assert 0.25 < rolling(briefing, command, (2.0, 8.0)) < 0.45
        assert 0.0 < rolling(briefing, command, (5.0, 8.0)) < 0.12
    # A steered wheel rolls at the speed along its own plane.
    assert rolling(briefing, -0.5, (8.0 * np.cos(0.5), 8.0), steer=0.5) == -0.5


def test_on_natural_soils_brakes_go_as_soon_as_a_wheel_lags_behind(briefing):
    """A braked front wheel locks within a tenth of a second there, and the drive lags by two."""
    slips = make_nmpc("nmpc_truth", natural=True).agent.agent._slips
    assert rolling(briefing, -0.5, (8.0, 8.0), slips=slips) == -0.5
    assert -0.35 < rolling(briefing, -0.5, (7.68, 8.0), slips=slips) < -0.15
    assert rolling(briefing, -0.5, (7.2, 8.0), slips=slips) > 0.0


def test_where_the_linearisation_of_the_last_plan_is_of_no_use_the_cost_still_falls(briefing, monkeypatch):
    """A last plan that steers and pushes as no drive does: the plan is driven by the model itself."""
    agent = planning(briefing, 0.08, 0.5, 8.0)
    senses = Senses(0.3, 0.1, 0.0, np.full(len(briefing.preview), 0.05), 8.0, (8.0, 8.0))
    soil = agent._numbers.at(0.5, 0.5, 1.0)
    belief = Belief(0.5, 0.5, 0.5)
    limits = agent._limits(senses, belief, soil)
    wild = np.random.default_rng(3).uniform(-1.0, 1.0, (Horizon().stages, len(INPUTS))) * [0.6, 9.0]
    start = agent._rolled_out(wild, senses.curvature, soil)
    cost = agent._programme.cost(agent._problem, start, wild, limits)
    states, inputs = agent._drivable(wild, senses.curvature, soil, limits)
    assert states == pytest.approx(agent._rolled_out(inputs, senses.curvature, soil))
    assert agent._programme.cost(agent._problem, states, inputs, limits) < 0.5 * cost
    # A plan that the model does not follow is noticed, one that it follows is left as it is.
    assert not agent._strays((states, inputs), senses.curvature, soil)
    for column, near, far in ((E, 0.25, 0.35), (V, 0.9, 1.1)):
        for error, noticed in ((near, False), (far, True)):
            off = states.copy()
            off[-1, column] += error
            assert agent._strays((off, inputs), senses.curvature, soil) is noticed
    monkeypatch.setattr(agent, "_guess", lambda: (start, wild))
    monkeypatch.setattr(agent, "_solved", lambda *_: (off, inputs))
    monkeypatch.setattr(agent, "_drivable", lambda *_: (states, wild))
    agent._replan(senses, belief, soil)
    assert agent._plan[1] is wild


def test_a_programme_that_has_not_converged_gives_no_plan(briefing, monkeypatch):
    args = asked_of(briefing, monkeypatch, kappa=0.05, n=0.5)[-1]
    assert Programme(Horizon()).solve(*args) is not None
    monkeypatch.setitem(SOLVERS["hpipm"], "hpipm", {"iter_max": 2})
    assert Programme(Horizon()).solve(*args) is None


def test_on_natural_soils_it_looks_after_its_wheels_and_estimates_the_biases_of_car_sensors():
    matched, natural = make_nmpc("nmpc_truth"), make_nmpc("nmpc_truth", natural=True).agent.agent
    assert matched.agent._slips is None
    assert matched.agent.settings == nmpc.NmpcSettings()
    assert natural._slips is not None
    assert natural.settings.heading_bias > 0.0 < natural.settings.side_bias


@pytest.mark.parametrize("bias", [0.05, 0.0])
def test_a_biased_heading_is_not_taken_for_side_speed(briefing, bias):
    """Straight on, along the path, with a compass that is 0.06 rad off and a tilted accelerometer."""
    settings = nmpc.NmpcSettings(heading_bias=bias, side_bias=8.0 * bias)
    agent = NmpcAgent(believe_fixed(0.5), settings)
    agent.reset(briefing)
    seen = {
        "imu": np.array([0.0, 0.4, 0.0, 0.0, 0.0]),
        "motion": np.array([8.0, 8.0, 8.0, 0.0, 0.0]),
        "path": np.concatenate([[0.0, 0.06, 0.0], np.zeros(len(briefing.preview)), [500.0]]),
    }
    soil = agent._numbers.at(0.5, 0.5, 1.0)
    for _ in range(150):
        agent._observe(read_senses(seen), seen, soil)
    side, heading = abs(agent._x[STATES.index("vy")]), abs(agent._x[STATES.index("psi")])
    assert (side < 0.2) == (heading < 0.03) == (bias > 0.0)


@pytest.mark.parametrize("name", ["heading_bias", "side_bias"])
def test_a_bias_has_no_negative_size(name):
    with pytest.raises(InvalidParameter, match=f"{name} must be 0 or more, got -0.1"):
        nmpc.NmpcSettings(**{name: -0.1})
