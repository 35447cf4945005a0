"""The ground is what its formula says, its derivatives are exact, and roughness has ISO's spectrum."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numba
import numpy as np
import pytest
from scipy.signal import welch

from offroad_env.errors import InvalidParameter
from offroad_env.physics.ground import ground_height, ground_readings, sin_cos, sinkage_exponent
from offroad_env.physics.path_geometry import path_point
from offroad_env.world import terrain
from offroad_env.world.paths import circle, straight
from offroad_env.world.terrain import (
    ISO_8608_CLASSES,
    Terrain,
    add,
    flat,
    grade,
    height_map,
    heights,
    paper_terrain,
    rough_terrain,
    soil_map,
    soil_patches_along,
)

compiled_only = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="minutes without the compiler")

GROUNDS = {
    "flat": flat(0.1),
    "grade": grade(0.2, 0.7),
    "paper": paper_terrain(0.05),
    "one wave": rough_terrain("D", np.random.default_rng(4), waves=1),
    "rough": rough_terrain("D", np.random.default_rng(5)),
    "rough grade": add(rough_terrain("E", np.random.default_rng(6), waves=37), grade(-0.1, 2.0)),
}


def points(count: int, extent: float = 100.0, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-extent, extent, (count, 2))


def test_the_vector_sine_and_cosine_agree_with_the_c_library():
    rng = np.random.default_rng(1)
    multiples = rng.integers(-60_000, 60_000, 1000) * (0.5 * math.pi)
    near = multiples + rng.normal(size=1000) * 10.0 ** rng.uniform(-16.0, -2.0, 1000)
    for x in (*rng.uniform(-1e5, 1e5, 3000), *rng.uniform(-7.0, 7.0, 1000), *near, 0.0, -0.0):
        s, c = sin_cos(x)
        # Rounding of a dozen operations on numbers up to 1; measured: 4e-16.
        assert abs(s - math.sin(x)) < 1e-15
        assert abs(c - math.cos(x)) < 1e-15


@pytest.mark.parametrize("name", GROUNDS)
def test_gradient_and_hessian_are_the_derivatives_of_the_height(name):
    ground, d = GROUNDS[name], 1e-4
    for X, Y in points(20):
        _, H_X, H_Y, H_XX, H_XY, H_YY = ground_readings(ground, X, Y)
        east, west = ground_readings(ground, X + d, Y), ground_readings(ground, X - d, Y)
        north, south = ground_readings(ground, X, Y + d), ground_readings(ground, X, Y - d)
        # Differences of second order err by d^2/6 times a third derivative of up to 10^4 amplitude / m^4.
        along_X = [(e - w) / (2.0 * d) for e, w in zip(east[:3], west[:3], strict=True)]
        along_Y = [(n - s) / (2.0 * d) for n, s in zip(north[:3], south[:3], strict=True)]
        assert along_X == pytest.approx([H_X, H_XX, H_XY], abs=1e-5)
        assert along_Y == pytest.approx([H_Y, H_XY, H_YY], abs=1e-5)


@pytest.mark.parametrize("name", GROUNDS)
def test_the_height_alone_is_the_height_among_the_readings(name):
    for X, Y in points(50):
        # The compiler may fuse a product and a sum in one of the two and not in the other.
        H = ground_readings(GROUNDS[name], X, Y)[0]
        assert ground_height(GROUNDS[name], X, Y) == pytest.approx(H, rel=1e-14, abs=1e-15)


def test_the_paper_terrain_is_the_papers_formula():
    H_0 = 0.05
    ground = paper_terrain(H_0)
    for X, Y in points(100):
        s, c = math.sin(0.5 * X), math.cos(0.5 * X)
        expected = (
            H_0 * s * s * math.cos(1.5 * Y),
            H_0 * s * c * math.cos(1.5 * Y),
            -1.5 * H_0 * s * s * math.sin(1.5 * Y),
            0.5 * H_0 * (c * c - s * s) * math.cos(1.5 * Y),
            -1.5 * H_0 * s * c * math.sin(1.5 * Y),
            -2.25 * H_0 * s * s * math.cos(1.5 * Y),
        )
        assert ground_readings(ground, X, Y) == pytest.approx(expected, abs=1e-15)


def test_a_grade_climbs_by_its_angle_towards_its_direction_and_not_across():
    ground = grade(0.1, direction=0.6)
    ahead, left = np.array([math.cos(0.6), math.sin(0.6)]), np.array([-math.sin(0.6), math.cos(0.6)])
    assert ground_height(ground, *(20.0 * ahead)) == pytest.approx(20.0 * math.tan(0.1), rel=1e-13)
    assert ground_height(ground, *(20.0 * left)) == pytest.approx(0.0, abs=1e-13)
    assert ground_readings(flat(), 3.0, 4.0) == (0.0,) * 6


def test_grounds_superpose():
    parts = [GROUNDS[name] for name in ("flat", "grade", "paper", "rough")]
    for X, Y in points(20):
        total = np.sum([ground_readings(ground, X, Y) for ground in parts], axis=0)
        assert ground_readings(add(*parts), X, Y) == pytest.approx(total, abs=1e-13)


def profile_spectrum(angle: float | None, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Frequency [cycles/m] and PSD [m^3] of straight 400 m profiles of class D, averaged over seeds."""
    rate = 8.0
    distance = np.arange(3200) / rate
    spectra = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        ground = rough_terrain("D", rng)
        a = rng.uniform(0.0, 2.0 * math.pi) if angle is None else angle
        profile = heights(ground, distance * math.cos(a), distance * math.sin(a))
        frequency, density = welch(profile, rate, nperseg=1600, detrend="linear")
        spectra.append(density)
    return frequency, np.mean(spectra, axis=0)


@compiled_only
@pytest.mark.parametrize("angle", [None, 0.0, 1.0])
def test_straight_profiles_of_rough_ground_have_the_spectrum_of_their_iso_class(angle):
    frequency, density = profile_spectrum(angle, range(60))
    for low, high in [(0.06, 0.1), (0.1, 0.2), (0.2, 0.4), (0.4, 0.8), (0.8, 1.4)]:
        band = (frequency >= low) & (frequency < high)
        iso = ISO_8608_CLASSES["D"] * (frequency[band] / 0.1) ** -2.0
        # 60 seeds x a dozen waves a band leave about 6 % of scatter. A synthesis that forgets that a wave
        # met at an angle looks longer is off by a factor pi/2.
        assert np.mean(density[band] / iso) == pytest.approx(1.0, abs=0.2)
    beyond = frequency > 1.6
    assert np.all(density[beyond] < 1e-4 * ISO_8608_CLASSES["D"] * (frequency[beyond] / 0.1) ** -2.0)


def test_each_iso_class_is_twice_as_high_as_the_one_before():
    waves = [rough_terrain(name, np.random.default_rng(3)).waves for name in "ABCDEFGH"]
    for smoother, rougher in pairwise(waves):
        assert rougher[:, 0] == pytest.approx(2.0 * smoother[:, 0], rel=1e-12)
        assert np.array_equal(rougher[:, 1:], smoother[:, 1:])
    same = rough_terrain(None, np.random.default_rng(3), roughness=64e-6)
    assert np.array_equal(same.waves, waves[1])


@compiled_only
def test_the_height_varies_as_much_as_the_described_standard_deviation():
    terrain = Terrain(ground=rough_terrain("C", np.random.default_rng(2)))
    axis = np.linspace(-400.0, 400.0, 150)
    sampled = height_map(terrain.ground, axis, axis).std()
    assert sampled == pytest.approx(terrain.describe()["height_sd"], rel=0.05)


def test_the_same_seed_gives_the_same_ground_and_any_class_uses_as_many_draws():
    first, second, third = (np.random.default_rng(8) for _ in range(3))
    assert np.array_equal(rough_terrain("B", first).waves, rough_terrain("B", second).waves)
    rough_terrain("G", third, band=(0.1, 1.0))
    assert first.random() == third.random()


def test_frequencies_are_those_of_plain_bisection():
    # Where the band is wide, the angle to its bottom is a quarter of a turn but for 1e-4 rad: rounding grows.
    for low, high, rounding in ((0.05, 1.5, 1e-14), (1.4, 1.5, 1e-14), (0.001, 10.0, 1e-11)):
        _agrees_with_bisection(low, high, rounding)


def _agrees_with_bisection(low, high, rounding):
    bins = terrain._bins(low, high, 64)
    edges = bins.edges
    for seed in range(20):
        waves = rough_terrain("C", np.random.default_rng(seed), band=(low, high)).waves
        share = np.random.default_rng(seed).random(64)
        below, above = edges[:-1].copy(), edges[1:].copy()
        variance = (1.0 - share) * terrain._variance_beyond(below, high) + share * terrain._variance_beyond(
            above, high
        )
        for _ in range(60):
            middle = 0.5 * (below + above)
            beyond = terrain._variance_beyond(middle, high) > variance
            below, above = np.where(beyond, middle, below), np.where(beyond, above, middle)
        found = terrain._draw_frequencies(bins, np.random.default_rng(seed))
        np.testing.assert_allclose(found, 0.5 * (below + above), rtol=rounding)
        np.testing.assert_allclose(np.hypot(waves[:, 1], waves[:, 2]), 2.0 * math.pi * found, rtol=1e-12)


def test_heights_broadcast_and_a_map_has_a_row_for_each_y():
    ground = GROUNDS["rough grade"]
    table = height_map(ground, [0.0, 1.0, 2.0], [5.0, 6.0])
    assert table.shape == (2, 3)
    assert table[1, 2] == ground_height(ground, 2.0, 6.0)
    assert heights(ground, 1.0, np.array([5.0, 6.0])).tolist() == table[:, 1].tolist()


def test_without_patches_the_soil_is_the_base_soil_everywhere():
    assert all(sinkage_exponent(soil_map(), 0.5, X, Y) == 0.5 for X, Y in points(20))


def test_a_patch_has_its_own_exponent_inside_and_a_later_one_lies_over_it():
    soils = soil_map([(0.0, 0.0, 5.0, 0.8), (4.0, 0.0, 2.0, 0.3)], edge=0.4)
    exponent = {x: sinkage_exponent(soils, 0.5, x, 0.0) for x in (-5.3, -5.0, -4.7, 0.0, 1.7, 2.3, 5.7, 6.3)}
    assert exponent[-5.3] == exponent[6.3] == 0.5
    assert exponent[-5.0] == pytest.approx(0.65)  # half way through the edge
    assert exponent[-4.7] == exponent[0.0] == exponent[1.7] == 0.8
    assert exponent[2.3] == exponent[5.7] == 0.3


def test_the_edge_of_a_patch_is_smooth_to_the_second_derivative():
    soils, d = soil_map([(0.0, 0.0, 5.0, 0.9)], edge=0.5), 1e-3
    n = np.array([sinkage_exponent(soils, 0.4, x, 0.0) for x in np.arange(4.6, 5.4, d)])
    assert np.all(np.diff(n) <= 0.0)
    # The third derivative of the step is at most 60 (n_1 - n_0) / edge^3 = 240; a jump in the second
    # derivative would be of order (n_1 - n_0) / edge^2 = 2 from one point to the next.
    assert np.abs(np.diff(n, 3)).max() / d**2 < 1.05 * 240.0 * d


@pytest.mark.parametrize("path", [straight(100.0), circle(8.0, laps=2.0)], ids=["straight", "circle"])
def test_patches_along_a_path_fill_its_corridor_from_start_to_end(path):
    soils = soil_patches_along(path, [(10.0, 30.0, 0.9)], half_width=2.0, edge=0.3)
    for s in np.linspace(0.0, 40.0, 161):
        x, y, yaw, _ = path_point(path, s)
        for offset in (-2.0, -1.0, 0.0, 1.0, 2.0):
            n = sinkage_exponent(soils, 0.5, x - offset * math.sin(yaw), y + offset * math.cos(yaw))
            if 11.1 < s < 28.9:  # the discs are round: 0.4 half_width plus the edge, wider outside a bend
                assert n == pytest.approx(0.9, rel=1e-14)  # overlapping discs round
            elif s < 9.0 or s > 31.0:
                assert n == 0.5
    assert sinkage_exponent(soils, 0.5, *path_point(path, 10.0)[:2]) == pytest.approx(0.7, abs=0.01)


def test_the_description_of_a_terrain_is_plain_json():
    soils = soil_map([(1.0, 2.0, 3.0, 0.7)])
    text = json.dumps(Terrain(ground=paper_terrain(0.04), soil_map=soils).describe(), allow_nan=False)
    numbers = json.loads(text)
    assert numbers["waves"] == 3
    assert numbers["patches"] == [[1.0, 2.0, 3.0, 0.7]]
    assert numbers["wavelengths"] == pytest.approx([2 * math.pi / math.hypot(1.0, 1.5), 2 * math.pi / 1.5])
    assert json.dumps(Terrain(ground=flat()).describe())


@pytest.mark.parametrize(
    ("make", "name", "mistake"),
    [
        (lambda: grade(10.0), "slope", "degrees"),
        (lambda: grade(0.1, 90.0), "direction", "degrees"),
        (lambda: paper_terrain(50.0), "H_0", "mm"),
        (lambda: paper_terrain(math.nan), "H_0", "nan"),
        (lambda: rough_terrain("Z", np.random.default_rng(0)), "iso_class", "A ... H"),
        (lambda: rough_terrain(None, np.random.default_rng(0)), "iso_class", "either"),
        (lambda: rough_terrain(None, np.random.default_rng(0), roughness=64.0), "roughness", "1e-6"),
        (lambda: rough_terrain("A", np.random.default_rng(0), band=(20.0, 0.5)), "band", "wavelength"),
        (lambda: rough_terrain("A", np.random.default_rng(0), band=(1.5, 0.05)), "band", "lowest"),
        (lambda: rough_terrain("A", np.random.default_rng(0), waves=0), "waves", "whole number"),
        (lambda: rough_terrain("A", 3), "rng", "default_rng"),
        (lambda: soil_map([(0.0, 0.0, 1.0)]), "patches", "radius"),
        (lambda: soil_map([(0.0, 0.0, 0.1, 0.5)]), "radius", "edge"),
        (lambda: soil_map([(0.0, 0.0, 1.0, 5.0)]), "n", "2.5"),
        (lambda: soil_map(edge=0.0), "edge", "0"),
        (lambda: soil_patches_along(straight(20.0), [(5.0, 30.0, 0.5)]), "sections", "20 m"),
        (lambda: soil_patches_along(straight(20.0), [(5.0, 9.0, 0.5)]), "sections", "long"),
        (lambda: add(Terrain(ground=flat())), "add", "Ground"),
    ],
)
def test_ground_that_means_nothing_is_refused_with_name_and_reason(make, name, mistake):
    with pytest.raises(InvalidParameter, match=name) as caught:
        make()
    assert mistake in str(caught.value)
