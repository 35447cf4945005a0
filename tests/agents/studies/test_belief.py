"""The study of the belief over the soil: its scores, and the drives that it simulates."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from agents.commands.cli import main
from agents.studies.belief import study
from agents.studies.belief.figure import belief_figure
from agents.studies.belief.results import score, straight
from agents.studies.belief.simulated import STRUCTURES, clean_log
from agents.studies.belief.study import BeliefStudy, run_unit
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.soil_holds import what_soil_holds


def row(n: float, found: float, sd: float, *, answered: bool = True) -> dict:
    """A result whose phi errs as its n does."""
    stated = {"mean": found, "sd": sd, "low": found - 1.96 * sd, "high": found + 1.96 * sd}
    return {"truth": {"n": n, "phi": n}, "soil": {"n": stated, "phi": stated}, "answered": answered}


def test_scores_count_errors_coverage_and_answers():
    found = score([row(0.5, 0.52, 0.02), row(0.7, 0.66, 0.01, answered=False), row(0.9, 0.93, 0.02)])
    assert found.n_mae == pytest.approx(0.03)
    assert found.spearman == pytest.approx(1.0)
    assert found.answered == pytest.approx(2.0 / 3.0)
    assert found.n_covered == pytest.approx(2.0 / 3.0)  # the second misses by four standard deviations
    assert found.n_width == pytest.approx(2.0 * 1.96 * 0.02)
    assert found.phi_z[0] == pytest.approx((1.0 - 4.0 + 1.5) / 3.0)


def test_a_drive_is_straight_while_it_hardly_turns():
    t = np.linspace(0.0, 40.0, 4000)
    assert straight(0.014 * np.sin(t))
    assert not straight(0.06 * np.sin(t))


def test_simulated_drives_err_in_their_description_and_are_the_same_again():
    log, plant = clean_log(3)
    soil = plant.soil
    assert log.config.structure == STRUCTURES[0]
    assert log.duration == pytest.approx(30.0)
    assert soil.n == log.config.soil.n
    assert 0.7 < soil.k_phi / log.config.soil.k_phi < 1.4
    assert soil.k_phi != log.config.soil.k_phi
    again, _ = clean_log(3)
    assert again.hash == log.hash
    other, _ = clean_log(4)
    assert other.hash != log.hash


def test_limits_are_compared_with_those_of_the_vehicle_that_drives(monkeypatch):
    part = SimpleNamespace(case=("grid", "half_car"), weight=1.0, fit=SimpleNamespace(misfit=np.ones(3)))
    believed = SimpleNamespace(soil=dict, valid_share=1.0, answered=True, parts=[part])
    monkeypatch.setattr(study, "believe_log", lambda log: believed)
    monkeypatch.setattr(study, "sampled_limits", lambda belief: np.empty((0, 6)))
    monkeypatch.setattr(study, "limits_of", lambda limits: {})
    log, plant = clean_log(3)
    described = plant._replace(vehicle=log.vehicle)
    found = run_unit("simulated", "3")["true_holds"]["resistance"]
    assert found == pytest.approx(what_soil_holds(plant).resistance)
    assert abs(found / what_soil_holds(described).resistance - 1.0) > 0.002


def test_simulated_drives_begin_at_the_first_seed(monkeypatch, tmp_path):
    class SeenError(Exception):
        pass

    def units_of(path, work, units, **_):
        raise SeenError(sorted(units))

    monkeypatch.setattr(study, "run_units", units_of)
    with pytest.raises(SeenError) as seen:
        BeliefStudy(out=tmp_path, simulated=2, first_seed=200).run()
    assert seen.value.args[0] == [("simulated", "200"), ("simulated", "201")]
    with pytest.raises(InvalidParameter, match="first_seed must be 0 or more, got -1"):
        BeliefStudy(out=tmp_path, simulated=2, first_seed=-1).run()


def test_the_figure_shows_every_group():
    rows = [row(0.5, 0.52, 0.02), row(0.9, 0.93, 0.02)]
    figure = belief_figure({"tuning half": rows, "straight": rows[:1]})
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert {"tuning half (2)", "straight (1)"} <= set(labels)


def test_the_study_needs_drives(capsys, tmp_path):
    with pytest.raises(SystemExit) as leaving:
        main(["reproduce", "belief", "--out", str(tmp_path)])
    assert leaving.value.code == 1
    assert "name logs with --logs" in capsys.readouterr().err


@pytest.mark.check
def test_the_study_runs_goes_on_and_writes(tmp_path):
    numbers = tmp_path / "numbers.json"
    options = ["reproduce", "belief", "--simulated", "1", "--out", str(tmp_path), "--json", str(numbers)]
    for _ in range(2):
        with pytest.raises(SystemExit) as leaving:
            main(options)
        assert leaving.value.code == 0
    found = json.loads(numbers.read_text())
    assert len((tmp_path / "belief.jsonl").read_text().splitlines()) == 1
    assert found["scores"]["simulated"]["drives"] == 1
    assert (tmp_path / "belief.png").stat().st_size > 10000
