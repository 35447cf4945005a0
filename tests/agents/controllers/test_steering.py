"""Steering laws and speed control on motions whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.controllers.protocol import Senses, read_senses, to_action
from agents.controllers.pure_pursuit import PursuitGains, goal_point, look_ahead, pursuit_curvature
from agents.controllers.speed_control import SpeedController, SpeedGains
from agents.controllers.stanley import StanleyGains, stanley_steer
from offroad_env.physics.full_dynamics import available_torque
from offroad_env.physics.numerics import AIR_DENSITY, GRAVITY
from offroad_env.world.vehicles import VEHICLES

PREVIEW = np.array([0.0, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0])
MRZR = VEHICLES["mrzr"]


def senses(cross_track=0.0, heading=0.0, kappa=0.0, speed=5.0):
    return Senses(cross_track, heading, 0.0, np.full(8, kappa), speed, (speed, speed))


@pytest.mark.parametrize("kappa", [-0.08, 0.0, 0.05])
@pytest.mark.parametrize("distance", [0.3, 7.0, 33.0])
def test_the_goal_point_lies_on_the_circle_ahead(kappa, distance):
    x, y, yaw = goal_point(np.full(8, kappa), PREVIEW, distance)
    turned = kappa * distance
    exact = (math.sin(turned) / kappa, (1.0 - math.cos(turned)) / kappa) if kappa else (distance, 0.0)
    # Trapezoidal rule: kappa^2 step^2 / 12 of the distance.
    assert (x, y) == pytest.approx(exact, abs=2e-4 * distance)
    assert yaw == pytest.approx(turned)


def test_pure_pursuit_on_the_path_asks_for_the_paths_own_curvature():
    kappa = 0.05
    goal = goal_point(np.full(8, kappa), PREVIEW, 6.0)
    assert pursuit_curvature(0.0, 0.0, goal) == pytest.approx(kappa, rel=1e-3)


@pytest.mark.parametrize(("cross_track", "heading"), [(0.5, 0.0), (0.0, 0.2)])
def test_pure_pursuit_steers_back_and_is_mirror_symmetric(cross_track, heading):
    goal = goal_point(np.zeros(8), PREVIEW, 6.0)
    asked = pursuit_curvature(cross_track, heading, goal)
    assert asked < 0.0
    assert pursuit_curvature(-cross_track, -heading, goal) == pytest.approx(-asked)


def test_the_look_ahead_grows_with_speed_between_its_limits():
    gains = PursuitGains()
    distances = [look_ahead(gains, speed) for speed in (0.0, 8.0, 12.0, 100.0)]
    assert distances == sorted(distances)
    assert distances[0] == gains.shortest
    assert distances[-1] == gains.longest


def test_stanley_holds_the_circle_of_a_car_without_slip():
    kappa, L = 0.06, MRZR.l_f + MRZR.l_r
    # The front axle's path is the circle; the body points along the rear axle's course.
    rear_heading = -math.asin(MRZR.l_r * kappa)
    front = -MRZR.l_f * math.sin(rear_heading) + 0.5 * kappa * MRZR.l_f**2
    steer = stanley_steer(senses(front, rear_heading, kappa, 4.0), 4.0 * kappa, MRZR.l_f, StanleyGains())
    assert steer == pytest.approx(L * kappa, rel=1e-2)


def test_stanley_steers_back_harder_at_low_speed():
    slow, fast = (
        stanley_steer(senses(cross_track=0.5, speed=v), 0.0, MRZR.l_f, StanleyGains()) for v in (2.0, 10.0)
    )
    assert slow < fast < 0.0


def simulate_speed(controller, target, seconds, *, resistance, start=0.0):
    """A point mass with the vehicle's torque lag and a motion resistance [N]."""
    v, speed, force, speeds = controller.vehicle, start, 0.0, []
    for _ in range(round(seconds / controller.dt)):
        command = controller.command(target, speed)
        most = v.drive_torque_max if command > 0.0 else v.brake_torque_max
        force += (command * most / v.r - force) * controller.dt / v.torque_lag
        speed += (force - resistance) / v.m * controller.dt
        speeds.append(speed)
    return np.array(speeds)


def test_the_integral_finds_a_resistance_that_nobody_told():
    speeds = simulate_speed(SpeedController(MRZR, 0.02), 5.0, 30.0, resistance=3000.0)
    assert speeds[-1] == pytest.approx(5.0, abs=0.02)
    assert speeds.max() < 5.6


def test_a_saturated_command_does_not_wind_the_integral_up():
    controller = SpeedController(MRZR, 0.02)
    for _ in range(500):
        assert controller.command(30.0, 0.0) == 1.0
    # Above the target the drive must end at once, whatever went before.
    assert controller.command(5.0, 6.0) < 0.0


def test_pushing_uses_the_drive_and_pulling_the_brake():
    controller = SpeedController(MRZR, 0.02, SpeedGains(k_i=0.0))
    assert controller.command(5.0, 4.0) > 0.0
    assert controller.command(4.0, 5.0) < 0.0


@pytest.mark.parametrize(("acceleration", "speed"), [(2.2, 5.0), (2.9, 7.0), (1.5, 1.0)])
def test_who_knows_what_the_drive_loses_asks_for_what_arrives(acceleration, speed):
    controller = SpeedController(MRZR, 0.02, SpeedGains(whole_power=True))
    command = controller.command(speed, speed, acceleration=acceleration, rim_speed=speed)
    given = available_torque(MRZR, command * MRZR.drive_torque_max, speed / MRZR.r) / MRZR.r
    drag = 0.5 * AIR_DENSITY * MRZR.drag_area * speed**2 + MRZR.rolling_resistance * MRZR.m * GRAVITY
    assert command < 1.0
    assert given == pytest.approx(MRZR.m * acceleration + drag)


def test_who_asks_for_more_than_the_drive_has_gets_all_of_it():
    controller = SpeedController(MRZR, 0.02, SpeedGains(whole_power=True))
    assert controller.command(7.0, 7.0, acceleration=4.0, rim_speed=7.0) == 1.0


def test_a_spinning_wheel_gets_less_torque():
    command = [SpeedController(MRZR, 0.02).command(6.0, 4.0, rim_speed=rim) for rim in (4.0, 7.0, 8.0, 40.0)]
    assert command[0] > command[1] > command[2] > command[3] == 0.0


def test_an_observation_is_named_and_an_action_is_clipped():
    observation = {
        "imu": np.zeros(5, np.float32),
        "motion": np.array([4.0, 4.5, 4.6, 0.1, 0.2], np.float32),
        "path": np.arange(12, dtype=np.float32),
    }
    seen = read_senses(observation)
    assert (seen.cross_track, seen.heading_error, seen.target_speed, seen.speed) == (0.0, 1.0, 2.0, 4.0)
    assert seen.curvature.tolist() == list(range(3, 11))
    assert seen.distance == 11.0
    assert to_action(2.0, -3.0, 0.5).tolist() == [1.0, -1.0]
