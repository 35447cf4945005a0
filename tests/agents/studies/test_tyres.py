"""The study of tyres: directions of the published effects of inflation pressure."""

from __future__ import annotations

import pytest

from agents.studies.tyres.results import field_ruts, load_deflection, pressure_effects, rut_ranks
from agents.studies.tyres.study import TyreStudy
from helpers import measured_data
from offroad_env.errors import InvalidParameter


def test_inflation_pressure_acts_in_the_published_direction_on_ruts_resistance_and_pull() -> None:
    folder = measured_data("tyre_on_soil")
    assert all(effect.agrees for effect in (*pressure_effects(folder), *field_ruts(folder)))
    ruts, rank = rut_ranks(folder)
    assert rank > 0.5
    # The level is another matter: plate sinkage is no rut.
    assert all(0.05 < one.model / one.published < 1.0 for one in ruts)


def test_the_load_deflection_curves_are_met_within_ten_per_cent() -> None:
    points = load_deflection(measured_data("tyre_on_soil"))
    assert len(points) == 28
    assert all(abs(point.model / point.load - 1.0) < 0.10 for point in points)


def test_without_the_published_tables_the_study_says_where_it_looked(tmp_path) -> None:
    with pytest.raises(InvalidParameter, match="OFFROAD_DATA"):
        TyreStudy(data=tmp_path).run()
