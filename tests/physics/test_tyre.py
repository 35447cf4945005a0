"""Laws of a pneumatic tyre on soil: their limits, and that they agree with themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from offroad_env.physics.records import Soil, Tyre, Wheel
from offroad_env.physics.tyre import (
    TyreLoad,
    critical_ground_pressure,
    effective_rolling_radius,
    engaged_share,
    flexible_share,
    friction_limited_strength,
    ground_pressure,
    hard_ground_deflection,
    mobilised_in_series,
    substitute_circle_ratio,
    tread_stiffness,
    tyre_load,
    tyre_on_soil,
    tyre_stiffness,
)
from offroad_env.world.soils import SOILS
from offroad_env.world.tyres import TYRES, make_tyre

MRZR = TYRES["mrzr"]
LOAD = 3400.0
#: Compact sand, 150 kPa at 5 cm.
MODULUS, N = 150e3 / 0.05**0.8, 0.8
WHEEL = Wheel(MRZR.r, MRZR.b)


def _soil(modulus: float, n: float) -> Soil:
    """A sand of this modulus [Pa/m^n]; without the factory, whose range limits leave."""
    return SOILS["dry_sand"]._replace(k_c=0.0, k_phi=modulus, n=n)


@pytest.mark.parametrize("name", list(TYRES))
def test_a_tyre_at_eight_per_cent_of_its_radius_bears_its_stiffness_times_that(name: str) -> None:
    tyre = TYRES[name]
    load = 0.08 * tyre.r * tyre_stiffness(tyre)
    assert hard_ground_deflection(tyre, load) == pytest.approx(0.08 * tyre.r, rel=1e-12)


def test_more_pressure_or_less_load_means_less_deflection() -> None:
    loads, pressures = np.geomspace(100.0, 2e4, 30), np.geomspace(50e3, 500e3, 30)
    by_load = [hard_ground_deflection(MRZR, load) for load in loads]
    by_pressure = [hard_ground_deflection(make_tyre(MRZR, inflation=p), LOAD) for p in pressures]
    assert np.all(np.diff(by_load) > 0.0)
    assert np.all(np.diff(by_pressure) < 0.0)


def test_wongs_critical_pressure_is_bekkers_pressure_under_a_rigid_wheel() -> None:
    """Bekker's sinkage of a rigid wheel, z = [3 W / ((3 - n) b k sqrt(D))]^(2/(2n+1)), loaded by k z^n."""
    r, b, n = 0.33, 0.212, N
    z = (3.0 * LOAD / ((3.0 - n) * b * MODULUS * math.sqrt(2.0 * r))) ** (2.0 / (2.0 * n + 1.0))
    assert critical_ground_pressure(MODULUS, n, r, b, LOAD) == pytest.approx(MODULUS * z**n, rel=1e-12)


def test_a_tyre_deflects_half_as_far_as_on_a_road_where_wong_calls_it_neither_rigid_nor_flexible() -> None:
    bearing = ground_pressure(LOAD, MRZR.r, MRZR.b, hard_ground_deflection(MRZR, LOAD))

    def excess(log_modulus: float) -> float:
        return critical_ground_pressure(math.exp(log_modulus), N, MRZR.r, MRZR.b, LOAD) - bearing

    modulus = math.exp(brentq(excess, 5.0, 25.0, xtol=1e-12))
    found = tyre_load(tyre_on_soil(MRZR, _soil(modulus, N), WHEEL), LOAD, 0.0)
    assert found.deflection == pytest.approx(0.5 * hard_ground_deflection(MRZR, LOAD))


def test_wongs_criterion_parts_rigid_from_flexible_tyres() -> None:
    assert flexible_share(1e5, 2e5) < 0.06
    assert flexible_share(2e5, 1e5) > 0.94


def test_the_substitute_circle_is_the_wheel_without_deflection_and_a_flat_patch_on_hard_ground() -> None:
    assert substitute_circle_ratio(0.0, 0.03, 0.0) == 1.0
    f, z, r = 0.02, 1e-9, 0.33
    length = math.sqrt(2.0 * substitute_circle_ratio(f, z, 0.0) * r * z)
    assert length == pytest.approx(2.0 * math.sqrt(2.0 * r * f), rel=1e-3)


@pytest.mark.parametrize(("f", "z"), [(0.02, 0.05), (0.03, 0.01), (0.001, 0.04)])
def test_the_substitute_circle_without_rebound_is_schmids(f: float, z: float) -> None:
    schmid = (math.sqrt(1.0 + f / z) + math.sqrt(f / z)) ** 2
    assert substitute_circle_ratio(f, z, 0.0) == pytest.approx(schmid, rel=1e-12)


def test_the_patch_on_elastic_ground_is_the_chord_of_the_undeflected_wheel() -> None:
    f, z, r = 0.02, 0.004, 0.33
    radius = r * substitute_circle_ratio(f, z, z)
    assert 2.0 * math.sqrt(2.0 * radius * z) == pytest.approx(2.0 * math.sqrt(2.0 * r * (z + f)), rel=1e-12)


def test_a_very_hard_tyre_is_a_rigid_wheel() -> None:
    hard = make_tyre(MRZR, inflation=3e7)
    found = tyre_load(tyre_on_soil(hard, _soil(MODULUS, N), WHEEL), LOAD, 3e4)
    ratio = substitute_circle_ratio(found.deflection, 0.02, 0.0)
    assert found.load == pytest.approx(LOAD, rel=1e-3)
    assert math.sqrt(ratio) == pytest.approx(1.0, abs=0.01), "length of the patch"
    assert effective_rolling_radius(hard, MRZR.r, found.deflection) == pytest.approx(MRZR.r, rel=1e-5)


def _on(modulus: float) -> TyreLoad:
    return tyre_load(tyre_on_soil(MRZR, _soil(modulus, N), WHEEL), LOAD, 0.0)


def test_a_tyre_on_firm_ground_deflects_as_on_a_road() -> None:
    moduli = MODULUS * np.geomspace(0.1, 1e3, 12)
    deflections = [_on(k).deflection for k in moduli]
    assert np.all(np.diff(deflections) > 0.0)
    assert deflections[-1] == pytest.approx(hard_ground_deflection(MRZR, LOAD), rel=1e-4)


def test_load_and_deflection_are_solved_together() -> None:
    rng = np.random.default_rng(16)
    for _ in range(200):
        r = rng.uniform(0.15, 0.8)
        wheel = Wheel(r, r * rng.uniform(0.4, 1.0))
        tyre = make_tyre(r=wheel.r, b=wheel.b, inflation=10 ** rng.uniform(4.5, 6.0))
        modulus, n, k = 10 ** rng.uniform(4.5, 9.0), rng.uniform(0.3, 1.5), 10 ** rng.uniform(3.0, 5.0)
        pressing = wheel.r * wheel.b * 10 ** rng.uniform(3.5, 5.0)
        on_soil = tyre_on_soil(tyre, _soil(modulus, n), wheel)
        found = tyre_load(on_soil, pressing, k)
        assert found.load == pytest.approx(_balanced(tyre, modulus, n, pressing, k), rel=1e-7)
        softer = tyre_load(on_soil, pressing * (1.0 - 1e-4), k)
        slope = (found.load - softer.load) / (1e-4 * pressing)
        assert found.relief == pytest.approx(k * slope, rel=1e-2)


def test_a_load_is_found_where_the_deflection_falls_with_it_from_any_guess() -> None:
    # Stiff springs above soil of a small n: a sixth of what presses is left, seven steps away.
    rng = np.random.default_rng(17)
    for _ in range(300):
        tyre = make_tyre(r=0.467, b=0.254, inflation=10 ** rng.uniform(4.5, 5.5))
        wheel = Wheel(tyre.r, tyre.b)
        modulus, n, k = 10 ** rng.uniform(4.0, 6.0), rng.uniform(0.05, 0.3), 10 ** rng.uniform(5.0, 6.0)
        pressing = 10 ** rng.uniform(3.5, 4.6)
        on_soil = tyre_on_soil(tyre, _soil(modulus, n), wheel)
        first, again = (
            tyre_load(on_soil, pressing, k, guess) for guess in (0.0, pressing * rng.uniform(0.01, 1.0))
        )
        assert first.load + k * first.deflection == pytest.approx(pressing, rel=1e-7)
        assert again.load == pytest.approx(first.load, rel=1e-7)


def _balanced(tyre: Tyre, modulus: float, n: float, pressing: float, k: float) -> float:
    """Load W of W + k f(W) = ``pressing`` by Brent's method, f from the formulas as printed."""

    def excess(load: float) -> float:
        bearing = 3 * load / ((3 - n) * tyre.b * math.sqrt(2 * tyre.r))
        critical = modulus ** (1 / (2 * n + 1)) * bearing ** (2 * n / (2 * n + 1))
        hard = 0.08 * tyre.r * (load / (tyre_stiffness(tyre) * 0.08 * tyre.r)) ** (1 / (1 + tyre.stiffening))
        mean = load / (tyre.b * 2 * math.sqrt(2 * tyre.r * hard))
        return load + k * hard / (1 + (mean / critical) ** 4) - pressing

    root: float = brentq(excess, 1e-6 * pressing, pressing, xtol=1e-13 * pressing)
    return root


def test_soil_and_tread_in_series_bear_the_same_stress() -> None:
    for soil in np.geomspace(1e-6, 0.1, 12):
        for tread in np.geomspace(1e-6, 0.1, 12):
            for share in (1e-4, 0.1, 0.5, 0.9, 0.99):
                u = -soil * math.log1p(-share) + tread * share
                assert mobilised_in_series(u, soil, tread) == pytest.approx(share, abs=5e-5)


def test_without_tread_the_soil_follows_janosi_and_without_soil_the_tread_the_brush_model() -> None:
    for u in np.linspace(1e-4, 0.05, 40):
        assert mobilised_in_series(u, 0.012, 0.0) == pytest.approx(-math.expm1(-u / 0.012), abs=1e-9)
        assert mobilised_in_series(u, 1e-9, 0.02) == pytest.approx(min(u / 0.02, 1.0), abs=1e-5)


def test_a_rigid_wheel_shears_the_soil_and_a_flat_belt_its_tread() -> None:
    assert engaged_share(substitute_circle_ratio(0.0, 0.03, 0.0)) == 1.0
    assert engaged_share(substitute_circle_ratio(0.02, 1e-7, 0.0)) < 1e-5


def test_the_weaker_of_rubber_and_soil_decides() -> None:
    assert friction_limited_strength(0.8, 100e3, 400e3) == pytest.approx(80e3, rel=2e-3)
    assert friction_limited_strength(0.8, 100e3, 20e3) == pytest.approx(20e3, rel=2e-3)
    assert friction_limited_strength(0.8, 0.0, 5e3) == 0.0
    assert 0.96 < friction_limited_strength(0.8, 100e3, 80e3) / 80e3 < 1.0


def test_the_brush_on_hard_ground_has_the_cornering_stiffness_of_the_tyre() -> None:
    """C_alpha = k_t b L^2 / 2 over the patch of L = 2 sqrt(2 r f)."""
    f = hard_ground_deflection(MRZR, LOAD)
    k_t = tread_stiffness(MRZR, MRZR.r, MRZR.b, LOAD, f)
    assert 0.5 * k_t * MRZR.b * 8.0 * MRZR.r * f == pytest.approx(MRZR.cornering * LOAD, rel=1e-12)
