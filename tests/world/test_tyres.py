"""Tyres of the catalogue, and what the factory refuses."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from helpers import measured_data
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Wheel
from offroad_env.physics.tyre import hard_ground_deflection, tyre_stiffness
from offroad_env.world.catalogue import UnknownNameError
from offroad_env.world.tyres import TYRES, make_tyre, require_fitting_tyre


def _rows(name: str) -> list[dict[str, str]]:
    with (measured_data("tyre_on_soil") / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_tyre_has_a_source_a_remark_and_a_record_of_floats() -> None:
    for name in TYRES:
        entry = TYRES.entry(name)
        assert min(len(entry.title), len(entry.source), len(entry.remark)) > 10
        assert all(type(value) is float for value in entry.record), "an int would compile kernels twice"


def test_the_goodyear_tyre_carries_the_published_loads_at_four_pressures_within_ten_per_cent() -> None:
    rows = [
        row for row in _rows("goodyear_335_65r22p5_load_deflection.csv") if float(row["deflection_m"]) > 0
    ]
    for row in rows:
        tyre = make_tyre("goodyear_335_65r22_5", inflation=float(row["inflation_Pa"]))
        deflection, load = float(row["deflection_m"]), float(row["load_N"])
        f_0 = 0.08 * tyre.r
        carried = tyre_stiffness(tyre) * deflection * (deflection / f_0) ** tyre.stiffening
        assert carried == pytest.approx(load, rel=0.10), row
        assert hard_ground_deflection(tyre, carried) == pytest.approx(deflection, rel=1e-9)
    assert {float(row["inflation_Pa"]) for row in rows} == {270e3, 414e3, 480e3, 650e3}


def test_the_goodyear_tyre_has_the_published_stiffness_at_four_pressures_within_ten_per_cent() -> None:
    for row in _rows("goodyear_335_65r22p5_stiffness.csv"):
        tyre = make_tyre("goodyear_335_65r22_5", inflation=float(row["inflation_Pa"]))
        load = float(row["nominal_load_N"])
        secant = load / hard_ground_deflection(tyre, load)
        assert secant == pytest.approx(float(row["vertical_stiffness_N_per_m"]), rel=0.10)
        tangent = secant * (1.0 + tyre.stiffening)
        assert tangent == pytest.approx(float(row["vertical_stiffness_N_per_m"]), rel=0.10)


def test_the_rule_for_tyres_without_a_measurement_is_right_within_a_third() -> None:
    """The three tyres that it is the mean of, at every pressure that they were measured at."""
    for name, pressures in (
        ("goodyear_335_65r22_5", (270e3, 414e3, 480e3, 650e3)),
        ("mavs_radial", (400e3, 600e3, 800e3)),
        ("crrel_light_truck", (103e3, 179e3)),
    ):
        for pressure in pressures:
            own = make_tyre(name, inflation=pressure)
            rule = make_tyre(r=own.r, b=own.b, inflation=pressure)
            assert tyre_stiffness(rule) == pytest.approx(tyre_stiffness(own), rel=0.35)


def test_a_tyre_changes_its_pressure_and_nothing_else() -> None:
    soft, hard = make_tyre("mrzr", inflation=100e3), make_tyre("mrzr", inflation=200e3)
    assert soft._replace(inflation=200e3) == hard
    assert tyre_stiffness(hard) - tyre_stiffness(soft) == pytest.approx(100e3 * soft.k_per_pressure)


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"inflation": 2.5}, "bar given as Pa"),
        ({"inflation": 150.0}, "kPa or psi"),
        ({"r": 330.0}, "mm given as m"),
        ({"mu": -0.1}, "mu must be in"),
        ({"cornering": math.nan}, "cornering must be in"),
    ],
)
def test_wrong_numbers_are_refused_with_the_likely_mistake(fields: dict[str, float], says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        make_tyre("mrzr", **fields)  # type: ignore[arg-type]


def test_a_tyre_needs_its_size_and_pressure() -> None:
    with pytest.raises(InvalidParameter, match="needs b, inflation"):
        make_tyre(r=0.33)
    with pytest.raises(UnknownNameError, match="mrzr"):
        make_tyre("mrz")
    with pytest.raises(TypeError, match="inflation"):
        make_tyre("mrzr", inflaton=1e5)  # type: ignore[call-arg]


def test_a_tyre_of_another_vehicle_does_not_fit() -> None:
    require_fitting_tyre(TYRES["mrzr"], Wheel(0.33, 0.21))
    with pytest.raises(InvalidParameter, match="radius must be within 15 %"):
        require_fitting_tyre(TYRES["goodyear_335_65r22_5"], Wheel(0.33, 0.21))


def test_larger_tyres_are_stiffer_by_the_rule() -> None:
    sizes = np.linspace(0.1, 0.8, 8)
    stiffness = [tyre_stiffness(make_tyre(r=r, b=0.6 * r, inflation=200e3)) for r in sizes]
    assert np.all(np.diff(stiffness) > 0.0)
