"""Paths are smooth curves in arc length, and a point finds its place on the branch it follows."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, cumulative_trapezoid
from scipy.special import ellipeinc

from offroad_env.errors import InvalidParameter
from offroad_env.physics.path_geometry import nearest_index, path_point, preview, project
from offroad_env.world.path_nodes import clothoid_nodes
from offroad_env.world.paths import (
    circle,
    figure_eight,
    from_waypoints,
    sine_path,
    straight,
    winding_corridor,
)

WAYPOINTS = [(0.0, 0.0), (20.0, 3.0), (35.0, 20.0), (30.0, 40.0), (50.0, 55.0)]
PATHS = {
    "straight": straight(50.0),
    "left circle": circle(12.0, laps=1.5),
    "right circle": circle(20.0, left=False),
    "sine": sine_path(150.0, 6.0, 50.0),
    "eight": figure_eight(30.0, laps=2.0),
    "waypoints": from_waypoints(WAYPOINTS),
    "corridor": winding_corridor(np.random.default_rng(7), 200.0),
}
every_path = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS.keys())


def beside(path, s: float, offset: float) -> tuple[float, float]:
    """The point ``offset`` [m] to the left of the path at arc length ``s``."""
    x, y, yaw, _ = path_point(path, s)
    return x - offset * math.sin(yaw), y + offset * math.cos(yaw)


@every_path
def test_a_path_is_written_in_its_arc_length(path):
    s = np.linspace(0.0, path.length, 8 * len(path.nodes))
    x, y, yaw, curvature = np.array([path_point(path, v) for v in s]).T
    assert path.ds == pytest.approx(0.25, rel=0.02)
    # The chord of an arc of radius R is shorter by (s/R)^2/24: here at most 3e-5, mostly far less.
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(path.length, rel=3e-5)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    along = np.cos(middle) * np.diff(x) + np.sin(middle) * np.diff(y)
    across = np.cos(middle) * np.diff(y) - np.sin(middle) * np.diff(x)
    assert np.all(along > 0.0)
    assert np.abs(across / along).max() < 2e-4, "yaw is not the direction of the path"
    slope = np.gradient(yaw, s)
    inner = slice(2, -2)
    assert np.abs(slope - curvature)[inner].max() < 5e-3, "curvature is not the rate of yaw"


def test_the_circle_and_the_sine_are_their_closed_forms_between_nodes_too():
    for s in np.linspace(0.0, PATHS["right circle"].length, 777):
        x, y, yaw, curvature = path_point(PATHS["right circle"], s)
        expected = (20.0 * math.sin(s / 20.0), -20.0 * (1.0 - math.cos(s / 20.0)), -s / 20.0, -0.05)
        assert (x, y, yaw, curvature) == pytest.approx(expected, abs=1e-8)
    for s in np.linspace(0.0, 150.0, 777):
        x, y, yaw, _ = path_point(PATHS["sine"], s)
        assert y == pytest.approx(6.0 * math.sin(2 * math.pi * x / 50.0), abs=1e-6)
        assert math.tan(yaw) == pytest.approx(
            6.0 * 2 * math.pi / 50.0 * math.cos(2 * math.pi * x / 50.0), abs=1e-5
        )


@pytest.mark.parametrize(("amplitude", "wavelength"), [(6.0, 80.0), (0.5, 6.4), (900.0, 300.0)])
def test_the_nodes_of_a_sine_lie_at_their_arc_length_of_it(amplitude, wavelength):
    path, k = sine_path(60.0, amplitude, wavelength), 2.0 * math.pi / wavelength
    squared = (amplitude * k) ** 2
    # Speed^2 = 1 + squared cos^2 = (1 + squared) (1 - m sin^2): an elliptic integral of the second kind.
    length = math.sqrt(1.0 + squared) / k * ellipeinc(k * path.nodes[:, 0], squared / (1.0 + squared))
    np.testing.assert_allclose(length, path.s, rtol=0.0, atol=1e-11)


def test_the_nodes_of_a_road_are_the_integral_of_its_curvature():
    breaks, values = np.array([0.0, 5.0, 9.0, 12.0, 31.0]), np.array([0.0, 0.0, 0.2, 0.2, -0.3])
    nodes = np.zeros((121, 4))
    clothoid_nodes(breaks, values, *gauss(6), 0.25, nodes)
    fine = np.linspace(0.0, 30.0, 120 * 256 + 1)
    yaw = cumulative_trapezoid(np.interp(fine, breaks, values), fine, initial=0.0)
    place = [cumulative_simpson(part, x=fine, initial=0.0)[::256] for part in (np.cos(yaw), np.sin(yaw))]
    np.testing.assert_allclose(nodes[:, :2], np.transpose(place), rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(nodes[:, 2], yaw[::256], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(nodes[:, 3], np.interp(fine[::256], breaks, values), rtol=0.0, atol=1e-14)


def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on 0 ... 1."""
    nodes, weight = np.polynomial.legendre.leggauss(count)
    return 0.5 * (1.0 + nodes), 0.5 * weight


def test_a_path_through_waypoints_passes_through_each_of_them_in_order():
    path = PATHS["waypoints"]
    s = [project(path, x, y, nearest_index(path, x, y))[:2] for x, y in WAYPOINTS]
    assert [abs(e) for _, e in s] == pytest.approx([0.0] * len(WAYPOINTS), abs=1e-5)
    assert np.all(np.diff([v for v, _ in s]) > 10.0)
    assert path.xy[-1] == pytest.approx(WAYPOINTS[-1], abs=1e-9)


def reach(path) -> float:
    """Largest half width [m] at which the strip along the path does not overlap itself (Federer's reach).

    The smallest circle through one point of the path and touching it at another.
    """
    xy, yaw = path.xy[::3], path.yaw[::3]
    d = xy[:, None] - xy[None, :]
    across = np.abs(d[..., 1] * np.cos(yaw) - d[..., 0] * np.sin(yaw))
    squared = (d**2).sum(axis=-1)
    apart = across > 1e-6
    return float((squared[apart] / (2.0 * across[apart])).min())


def test_two_hundred_winding_corridors_bend_gently_and_never_meet_themselves():
    for seed in range(200):
        path = winding_corridor(np.random.default_rng(seed), 300.0)
        curvature, yaw = path.curvature, path.yaw
        assert path.length == 300.0
        assert np.all(curvature[path.s < 15.0] == 0.0)
        assert np.abs(yaw).max() <= 1.3
        assert 1.0 / 40.0 < np.abs(curvature).max() <= 1.0 / 12.0
        # A clothoid takes 6 m, or a quarter of the least bend (0.65 rad of 12 m): 3.9 m.
        assert np.abs(np.diff(curvature)).max() <= path.ds / 12.0 / 3.9 * 1.001, "a jump in curvature"
        # Nodes 0.75 m apart see a circle of 12 m to 0.1 %.
        assert reach(path) > 11.98, f"seed {seed} comes too close to itself"
        assert curvature.min() < 0.0 < curvature.max(), f"seed {seed} turns one way only"


def test_the_same_seed_gives_the_same_road_and_every_road_takes_as_many_draws():
    generators = [np.random.default_rng(seed) for seed in (1, 1, 2)]
    first, again, other = (winding_corridor(rng, 150.0) for rng in generators)
    assert np.array_equal(first.nodes, again.nodes)
    assert not np.array_equal(first.nodes, other.nodes)
    reference = np.random.default_rng(2)
    reference.random((math.ceil(150.0 / (0.65 * 12.0 + 5.0)), 3))
    assert generators[2].random() == reference.random()


@every_path
def test_a_point_beside_the_path_finds_its_foot_and_its_side(path):
    rng = np.random.default_rng(3)
    for _ in range(100):
        s, offset = rng.uniform(0.0, path.length), rng.uniform(-3.0, 3.0)
        hint = int(s / path.ds) + int(rng.integers(-4, 5))
        found, cross_track, yaw, curvature, _ = project(path, *beside(path, s, offset), hint)
        assert found == pytest.approx(s, abs=1e-6)
        assert cross_track == pytest.approx(offset, abs=1e-6)
        assert (yaw, curvature) == pytest.approx(path_point(path, s)[2:], abs=1e-6)


def test_the_foot_is_the_nearest_point_of_the_whole_corridor():
    path = PATHS["corridor"]
    fine = np.array([path_point(path, s)[:2] for s in np.linspace(0.0, path.length, 20_001)])
    rng = np.random.default_rng(11)
    for _ in range(50):
        x, y = beside(path, rng.uniform(2.0, 198.0), rng.uniform(-8.0, 8.0))
        _, cross_track, *_ = project(path, x, y, nearest_index(path, x, y))
        nearest = np.hypot(*(fine - (x, y)).T).min()
        assert abs(cross_track) == pytest.approx(nearest, abs=1e-4)


def test_progress_is_continuous_for_a_vehicle_that_weaves_along_the_path():
    path = PATHS["corridor"]
    index, last = 0, None
    for t in np.arange(0.0, 190.0, 0.05):
        s, cross_track, _, _, index = project(path, *beside(path, t, 4.0 * math.sin(0.3 * t)), index)
        if last is not None:
            assert abs(s - last[0]) < 0.06
            assert abs(cross_track - last[1]) < 0.07
        last = (s, cross_track)


def test_at_a_crossing_the_vehicle_stays_on_the_branch_that_it_follows():
    path = PATHS["eight"]
    lap = 0.5 * path.length
    # Half a lap later the path crosses the origin in the other direction, and again in the second lap.
    for crossing in (0.5 * lap, lap, 1.5 * lap):
        index = int((crossing - 5.0) / path.ds)
        for s in np.arange(crossing - 5.0, crossing + 5.0, 0.4):
            found, cross_track, _, _, index = project(path, *beside(path, s, 0.8), index)
            assert found == pytest.approx(s, abs=1e-6)
            assert cross_track == pytest.approx(0.8, abs=1e-6)


def test_before_its_start_and_behind_its_end_the_path_goes_on_straight():
    path = PATHS["left circle"]
    s, cross_track, yaw, curvature, index = project(path, -4.0, 0.5, 0)
    assert (s, cross_track, yaw, curvature, index) == (-4.0, 0.5, 0.0, 0.0, 0)
    last = len(path.nodes) - 1
    x, y = beside(path, path.length + 3.0, -1.0)
    s, cross_track, yaw, curvature, index = project(path, x, y, last)
    assert (s, cross_track, curvature) == pytest.approx((path.length + 3.0, -1.0, 0.0), abs=1e-9)
    assert yaw == pytest.approx(3.0 * math.pi, abs=1e-9)


@pytest.mark.parametrize("hint", [-50, 10**6])
def test_a_hint_off_the_path_is_taken_as_its_end(hint):
    path = PATHS["straight"]
    assert project(path, 20.0, 1.0, hint)[:2] == pytest.approx((20.0, 1.0), abs=1e-9)


def test_near_the_centre_of_a_bend_the_foot_stays_finite_and_on_the_path():
    path = PATHS["left circle"]
    for x, y in [(0.0, 12.0), (0.01, 12.0), (-0.02, 11.9), (0.3, 12.5)]:
        s, cross_track, *_ = project(path, x, y, 40)
        assert -1.0 < s < path.length + 1.0
        assert cross_track == pytest.approx(12.0, abs=0.7)


def test_the_preview_of_a_circle_is_its_curvature_and_the_angle_ahead():
    path = PATHS["right circle"]
    distances, out = np.array([0.0, 5.0, 10.0, 500.0]), np.empty((4, 2))
    preview(path, 7.0, distances, out)
    assert out[:3, 0] == pytest.approx(-0.05)
    assert out[:3, 1] == pytest.approx(-distances[:3] / 20.0, abs=1e-9)
    assert out[3, 0] == 0.0, "behind the end the path is straight"
    assert out[3, 1] == pytest.approx(-2.0 * math.pi + 7.0 / 20.0, abs=1e-9)


@every_path
def test_a_path_survives_pickling_and_has_its_columns_by_name(path):
    copy = pickle.loads(pickle.dumps(path))
    assert np.array_equal(copy.nodes, path.nodes)
    assert copy.s[-1] == pytest.approx(path.length)
    assert np.array_equal(np.column_stack([copy.xy, copy.yaw, copy.curvature]), path.nodes)
    copy.xy[0] = 99.0
    assert np.array_equal(copy.nodes, path.nodes), "a column shares memory with the path"


@pytest.mark.parametrize(
    ("make", "name", "reason"),
    [
        (lambda: straight(0.0), "length", "[1, 1e5]"),
        (lambda: straight("50"), "length", "'50'"),
        (lambda: circle(0.5), "radius", "[2, 1e4]"),
        (lambda: circle(10.0, laps=-1.0), "laps", "-1"),
        (lambda: sine_path(100.0, 20.0, 10.0), "radius", "0.126"),
        (
            lambda: winding_corridor(np.random.default_rng(0), radius_range=(40.0, 12.0)),
            "radius_range",
            "largest",
        ),
        (lambda: winding_corridor(np.random.default_rng(0), max_heading=60.0), "max_heading", "degrees"),
        (lambda: winding_corridor(5), "rng", "default_rng"),
        (lambda: from_waypoints([(0.0, 0.0), (1.0, 0.0)]), "points", "N >= 3"),
        (lambda: from_waypoints([(0.0, 0.0), (5.0, 0.0), (5.0, 0.0)]), "points", "coincide"),
        (lambda: from_waypoints([(0.0, 0.0), (math.nan, 0.0), (5.0, 0.0)]), "points", "nan"),
        (lambda: from_waypoints([(0.0, 0.0), (10.0, 0.0), (0.0, 0.5)]), "radius", "2"),
    ],
)
def test_a_path_that_cannot_be_is_refused_with_name_and_reason(make, name, reason):
    with pytest.raises(InvalidParameter, match=name) as caught:
        make()
    assert reason in str(caught.value)
