"""``offroad identify`` and the study of the estimators on board: what they write, keep and refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest

from agents.commands.cli import main
from agents.studies.identifiability.study import Finding
from agents.studies.online_filters import study as carried
from estimators.experiments.fisher_information import Information


def offroad(*arguments):
    """Exit status of ``offroad`` with these arguments."""
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


SHORT = ("--pairs", "phi", "--seeds", 2, "--duration", 1, "--jobs", 1)


def test_identify_writes_its_figure_and_numbers_and_keeps_what_is_done(tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    arguments = ("identify", "sine", *SHORT, "--out", tmp_path, "--json", numbers)
    assert offroad(*arguments) == 0
    (found,) = json.loads(numbers.read_text())["findings"]
    assert found["parameters"] == ["n", "phi"]
    bound = np.array(found["bound"])
    prior = np.diag(1.0 / np.square(found["prior_sd"]))
    assert np.linalg.inv(bound) == pytest.approx(np.array(found["information"]) + prior)
    assert np.shape(found["errors"]) == (2, 2)
    assert (tmp_path / "identify.png").stat().st_size > 10000
    assert found["words"] in capsys.readouterr().out.replace("\n", " ")
    kept = (tmp_path / "identify.jsonl").read_text()
    assert offroad(*arguments) == 0
    assert (tmp_path / "identify.jsonl").read_text() == kept


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("loop",), "no drive 'loop' - one of straight"),
        (("sine", "--soil", "hard_ground"), "hard ground, which has no soil parameters"),
        (("sine", "--duration", 0.1), "duration must be in"),
        (("sine", "--seeds", 1), "seeds must be in"),
    ],
)
def test_identify_refuses_what_cannot_work_before_it_begins(arguments, message, tmp_path, capsys):
    assert offroad("identify", *arguments, "--out", tmp_path) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_errors_as_large_as_the_bound_are_in_the_band():
    information = Information(parameters=("n", "phi"), matrix=np.array([[4e4, -900.0], [-900.0, 60.0]]))
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(2), information.bound, size=400)
    parts = {"source": "made", "title": "made", "duration": 1.0, "information": information}
    low, high = Finding(**parts, errors=draws).excess_band
    assert low < Finding(**parts, errors=draws).excess < high
    assert Finding(**parts, errors=1.3 * draws).excess > high
    draws[::4] = np.nan
    assert Finding(**parts, errors=draws).failed == 100
    assert 0.8 < Finding(**parts, errors=draws).excess < 1.2


def test_the_study_of_the_estimators_on_board_counts_what_it_saw(monkeypatch):
    monkeypatch.setattr(carried, "_peer_step", lambda: None)  # another package's environment
    keys = [(name, scenario, 0, 3.0) for name in carried._CHOICES for scenario in carried._SCENARIOS]
    results = {key: carried.run_unit(*key) for key in keys}
    lines = carried.lines_of(results)
    assert [(line.estimator, line.scenario) for line in lines] == [key[:2] for key in keys]
    for line in lines:
        assert line.error_worst < 0.2
        assert line.coverage > 0.8
        assert line.peer_ratio is None
    by_name = {line.estimator: line.microseconds for line in lines if line.scenario == "track"}
    assert by_name["online_parameter_ukf"] < by_name["online_joint_ukf at 50 Hz"] < by_name["online_ukf_bank"]
