"""``offroad diagnose`` on files that cannot be right: one sentence, exit status 1, nothing written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bad_logs import CASES

from agents.commands.cli import main
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs import write_log


def _diagnose(folder, capsys) -> tuple[int, str]:
    """Exit status of the command and what it said on standard error."""
    with pytest.raises(SystemExit) as leaving:
        main(["diagnose", str(folder / "run.csv"), "--out", str(folder / "out")])
    return leaving.value.code, capsys.readouterr().err.strip()


def test_every_bad_file_ends_in_one_sentence_and_leaves_nothing(tmp_path, capsys):
    assert len(CASES) >= 40
    for i, case in enumerate(CASES):
        folder = tmp_path / str(i)
        folder.mkdir()
        case.make(folder)
        code, said = _diagnose(folder, capsys)
        assert code == 1, case.name
        assert len(said.splitlines()) == 1, case.name
        assert all(part in said for part in case.expect), f"{case.name}: {said}"
        assert not (folder / "out").exists(), case.name


@pytest.fixture(scope="module")
def run():
    return simulated_log(draw_case(6, road="flat", gnss=True, duration=20.0))


@pytest.mark.parametrize(
    ("channel", "change", "expect"),
    [
        ("yaw_rate", np.degrees, "deg/s"),
        ("speed", lambda v: 3.6 * v, "km/h"),
        ("a_y", lambda a: a / 9.81, "a_y is in g"),
        ("omega_f", lambda omega: 9.55 * omega, "rpm"),
        ("yaw_rate", np.negative, "sign"),
        ("a_z", lambda a: np.full_like(a, 0.25), "stuck"),
        ("a_y", lambda a: np.where(np.arange(len(a)) < len(a) // 2, a, a[len(a) // 2]), "moves on: stuck"),
    ],
)
def test_readable_data_that_cannot_be_right_name_the_channel_and_fail(
    run, channel, change, expect, tmp_path, capsys
):
    write_log(
        tmp_path / "run.csv", replace(run, channels=run.channels | {channel: change(run.channels[channel])})
    )
    code, said = _diagnose(tmp_path, capsys)
    assert code == 1
    assert len(said.splitlines()) == 1
    assert channel in said
    assert expect in said
    # What was found is written all the same.
    assert "DATA PROBLEM" in (tmp_path / "out" / "diagnosis.html").read_text()


def test_a_run_too_short_for_a_diagnosis_says_how_long_it_must_be(run, tmp_path, capsys):
    kept = run.t < 2.0
    short = replace(run, t=run.t[kept], channels={k: v[kept] for k, v in run.channels.items()}, references={})
    write_log(tmp_path / "run.csv", short)
    code, said = _diagnose(tmp_path, capsys)
    assert code == 1
    assert "3 s" in said
