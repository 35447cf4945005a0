"""Natural soil: fields with the stated spread and reach, patches of whole soils, and drives over both."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.packing import pack, unpack
from offroad_env.simulation.fleet import make_fleet, simulate_fleet_commands
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.natural_soil import (
    SoilSpread,
    matern_correlation,
    natural_soil,
    reference_pressure,
    soil_maps,
)
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

BASE = SOILS["lete_sand"]
SPREAD = SoilSpread(K=0.1)
STATED = np.array([SPREAD.pressure, SPREAD.n, SPREAD.c, SPREAD.tan_phi, SPREAD.K])
FIELDS = 24


def deviations(field, X, Y, base=BASE):
    """(5, ...) of log p(5 cm), n, log c, log tan(phi), log K from the base."""
    here = soil_maps(field, base, X, Y)
    return np.stack(
        [
            np.log(here.pressure / reference_pressure(base)),
            here.n - base.n,
            np.log(here.c / base.c),
            np.log(np.tan(here.phi) / math.tan(base.phi)),
            np.log(here.K / base.k_x),
        ]
    )


def correlation_at(distance, length):
    """Correlation (FIELDS, 5) of each number over a distance, from pairs of places all over the plane."""
    rng, found = np.random.default_rng(7), []
    for seed in range(FIELDS):
        field = natural_soil(BASE, seed, correlation_length=length, spread=SPREAD)
        X, Y = rng.uniform(-60.0 * length, 60.0 * length, (2, 1500))
        turn = rng.uniform(0.0, 2.0 * math.pi, 1500)
        here = deviations(field, X, Y)
        there = deviations(field, X + distance * np.cos(turn), Y + distance * np.sin(turn))
        found.append(np.mean(here * there, axis=1) / np.mean(here**2, axis=1))
    return np.array(found)


@pytest.mark.parametrize("length", [1.0, 5.0, 20.0])
def test_the_spread_over_the_plane_is_the_stated_one(length):
    rng = np.random.default_rng(1)
    for seed in range(4):
        field = natural_soil(BASE, seed, correlation_length=length, spread=SPREAD)
        X, Y = rng.uniform(-100.0 * length, 100.0 * length, (2, 4000))
        found = deviations(field, X, Y)
        # 4000 places that hardly know each other: 1.1 % of sampling error; three of them, and the mean.
        np.testing.assert_allclose(found.std(axis=1), STATED, rtol=0.05)
        assert (np.abs(found.mean(axis=1)) < 0.07 * STATED).all()


@pytest.mark.parametrize("length", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("share", [0.25, 1.0, 2.0])
def test_the_correlation_falls_to_one_over_e_at_the_correlation_length(length, share):
    found = correlation_at(share * length, length).ravel()
    error = found.std() / math.sqrt(found.size)
    # The finite number of waves leaves the mean of the ratio 0.02 low.
    assert abs(found.mean() - matern_correlation(share * length, length)) < 3.0 * error + 0.025
    assert matern_correlation(length, length) == pytest.approx(math.exp(-1.0))


def test_the_parameters_are_correlated_as_asked_and_otherwise_not():
    asked = np.eye(5)
    asked[0, 1] = asked[1, 0] = -0.6
    asked[2, 3] = asked[3, 2] = -0.4
    rng, found = np.random.default_rng(3), []
    for seed in range(8):
        field = natural_soil(BASE, seed, correlation_length=2.0, spread=SPREAD, correlation=asked)
        found.append(np.corrcoef(deviations(field, *rng.uniform(-300.0, 300.0, (2, 2000)))))
    np.testing.assert_allclose(np.mean(found, axis=0), asked, atol=0.04)


def test_every_parameter_stays_one_of_a_soil_however_wide_the_spread():
    wild = SoilSpread(pressure=0.5, n=0.2, c=0.5, tan_phi=0.5, K=0.5)
    X, Y = np.random.default_rng(5).uniform(-500.0, 500.0, (2, 20000))
    soft = make_soil("heavy_clay", n=0.66, phi=1.3)
    here = soil_maps(natural_soil(soft, 2, correlation_length=1.0, spread=wild), soft, X, Y)
    for values in (here.pressure, here.c, here.K):
        assert (values > 0.0).all()
    assert ((here.n > 0.05) & (here.n < 2.5)).all()
    assert here.n.min() < 0.1, "some places do come to the end of the range"
    assert ((here.phi > 0.0) & (here.phi < 0.5 * math.pi)).all()


def test_the_exponent_turns_about_five_centimetres():
    """Without spread of p(5 cm) a field of n leaves that pressure as it is, for a plate of any width."""
    base = SOILS["lete_sand"]
    field = natural_soil(base, 4, spread=SoilSpread(pressure=0.0, n=0.1, c=0.0, tan_phi=0.0))
    here = soil_maps(field, base, np.linspace(0.0, 50.0, 200), 0.0)
    assert here.n.std() > 0.05
    np.testing.assert_allclose(here.pressure, reference_pressure(base), rtol=1e-12)


def test_a_seed_is_a_field():
    X, Y = np.random.default_rng(0).uniform(-20.0, 20.0, (2, 50))
    one, same, other = (natural_soil(BASE, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(deviations(one, X, Y), deviations(same, X, Y))
    assert np.abs(deviations(one, X, Y) - deviations(other, X, Y)).max() > 0.01
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(natural_soil(BASE, rng).waves, one.waves)
    assert np.abs(natural_soil(BASE, rng).waves - one.waves).max() > 0.01


def test_a_patch_is_another_whole_soil_with_a_smooth_edge():
    inside, none = SOILS["snow"], SoilSpread(pressure=0.0, n=0.0, c=0.0, tan_phi=0.0)
    field = natural_soil(BASE, 1, spread=none, patches=[(10.0, 0.0, 4.0, inside)], edge=1.0)
    X = np.linspace(0.0, 20.0, 2001)
    here = soil_maps(field, BASE, X, 0.0)
    for places, soil in ((np.abs(X - 10.0) <= 3.5, inside), (np.abs(X - 10.0) >= 4.5, BASE)):
        np.testing.assert_allclose(here.n[places], soil.n, rtol=1e-12)
        np.testing.assert_allclose(here.pressure[places], reference_pressure(soil), rtol=1e-12)
        np.testing.assert_allclose(here.c[places], soil.c, rtol=1e-12)
        np.testing.assert_allclose(here.phi[places], soil.phi, rtol=1e-12)
        np.testing.assert_allclose(here.K[places], soil.k_x, rtol=1e-12)
    for values in here:
        steps = np.abs(np.diff(values)) / np.ptp(values)
        assert steps.max() < 0.05, "1 cm of a 1 m edge changes no parameter by a twentieth of the jump"


def drive(field, seconds=4.0, **kinds):
    plant = make_plant(VEHICLES["mrzr"], BASE, flat(), soil_field=field, **kinds)
    state, warm = settled_state(plant, v_x=4.0)
    commands = np.tile([0.05, 900.0, 0.0], (round(seconds / 0.02), 1))
    return plant, simulate_commands(plant, state, warm, commands)


@pytest.mark.parametrize(
    "kinds",
    [{}, pytest.param({"structure": "grid", "vehicle_model": "four_wheel"}, marks=pytest.mark.check)],
)
def test_a_vehicle_meets_at_each_wheel_the_soil_of_that_place(kinds):
    field = natural_soil(BASE, 11, correlation_length=2.0, patches=[(12.0, 0.0, 3.0, SOILS["clay"])])
    _, run = drive(field, **kinds)
    for axle in [at.READINGS_SIZE + i * at.AXLE for i in range(4)] if kinds else [0, at.AXLE]:
        X, Y = run.readings[:, axle + at.WHEEL_X], run.readings[:, axle + at.WHEEL_Y]
        there = soil_maps(field, BASE, X, Y)
        np.testing.assert_allclose(run.readings[:, axle + at.EXPONENT], there.n, rtol=1e-12)
        assert np.ptp(there.n) > 0.2, "it went through the patch"
        # Softer ground at 5 cm is deeper ground.
        if axle >= at.READINGS_SIZE + 2 * at.AXLE:
            continue  # the rear wheels run in the ruts of the front ones
        outside = np.abs(X - 12.0) > 4.0
        depth, pressure = run.readings[outside, axle + at.SINKAGE], there.pressure[outside]
        assert np.corrcoef(np.log(depth), np.log(pressure))[0, 1] < -0.3


def test_a_field_without_waves_or_patches_changes_nothing():
    empty = natural_soil(BASE, 0)._replace(waves=np.empty((0, 12)))
    _, with_it = drive(empty, 1.0)
    _, without = drive(None, 1.0)
    np.testing.assert_array_equal(with_it.states, without.states)


def test_a_fleet_on_natural_soil_drives_as_its_vehicles_alone():
    field = natural_soil(BASE, 6, correlation_length=3.0)
    plant, run = drive(field, 1.0)
    assert unpack(pack(plant)).soil_field is not None
    fleet = make_fleet([plant, plant])
    state, warm = settled_state(plant, v_x=4.0)
    found = simulate_fleet_commands(fleet, state, warm, np.tile([0.05, 900.0, 0.0], (50, 1)))
    np.testing.assert_array_equal(found.states[-1, 0], run.states[-1])
    with pytest.raises(InvalidParameter, match="soil field"):
        make_fleet([plant, plant._replace(soil_field=natural_soil(BASE, 7))])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: natural_soil(SOILS["hard_ground"], 0), "deformable"),
        (lambda: natural_soil(BASE, 0, correlation_length=0.0), "correlation_length must be in"),
        (lambda: natural_soil(BASE, 0, spread=SoilSpread(c=5.0)), "per cent"),
        (lambda: natural_soil(make_soil(BASE, n=0.1), 0), "a smaller spread"),
        (lambda: natural_soil(BASE, 0, correlation=2.0 * np.eye(5)), "covariance"),
        (lambda: natural_soil(BASE, 0, correlation=np.eye(3)), "shape"),
        (lambda: natural_soil(BASE, 0, correlation=1.8 * np.ones((5, 5)) - 0.8 * np.eye(5)), "semidefinite"),
        (lambda: natural_soil(BASE, 0, waves=3), "waves"),
        (lambda: natural_soil(BASE, 0, patches=[(0.0, 0.0, 0.1, BASE)]), "edge/2"),
        (lambda: natural_soil(BASE, 0, patches=[(0.0, 0.0, 1.0, 0.4)]), r"patches\[0\]"),
        (lambda: natural_soil(BASE, 0, patches=[(0.0, 0.0, 1.0, SOILS["hard_ground"])]), "hard ground"),
        (
            lambda: make_plant(
                VEHICLES["mrzr"], SOILS["hard_ground"], flat(), soil_field=natural_soil(BASE, 0)
            ),
            "soil_field",
        ),
    ],
)
def test_a_field_that_means_nothing_is_refused(make, said):
    with pytest.raises(InvalidParameter, match=said):
        make()
