"""Every bad log gets one clear sentence that says where, and nothing but a `DataError`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bad_logs import CASES, ROWS, good_rows, no_change, rig, text_of, write

from estimators.logs import read_log, read_logs
from offroad_env.errors import DataError


def sentence_of(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        read_log(path)
    return str(caught.value)


def refusal(path: Path) -> str:
    """The sentence by which a log is refused, "" if it is read."""
    try:
        read_log(path)
    except DataError as error:
        return str(error)
    return ""


def test_the_log_from_which_all_bad_ones_are_made_is_good(tmp_path):
    write(tmp_path, text_of(good_rows()))
    assert len(read_log(tmp_path / "run.csv")) == ROWS


def test_the_rig_log_from_which_all_bad_ones_are_made_is_good(tmp_path):
    rig(no_change)(tmp_path)
    assert read_log(tmp_path / "run.csv").rig


def test_no_two_cases_have_one_name():
    assert len({case.name for case in CASES}) == len(CASES) >= 40


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_log_gets_one_sentence_that_says_where(case, tmp_path):
    case.make(tmp_path)
    sentence = sentence_of(tmp_path / "run.csv")
    assert str(tmp_path / case.file) in sentence
    for part in case.expect:
        assert part in sentence, f"{part!r} is not in: {sentence}"
    assert "\n" not in sentence
    assert len(sentence.replace(str(tmp_path), "")) < 260


@pytest.mark.parametrize(
    ("name", "expect"),
    [
        ("rum.csv", "run.csv"),
        ("run.txt", ".txt"),
        ("run.yaml", "the CSV"),
        ("run", "'no ending'"),
        ("folder", "folder"),
        ("missing/run.csv", "no such file"),
    ],
)
def test_a_path_that_is_no_log_is_named_with_what_it_could_have_been(name, expect, tmp_path):
    write(tmp_path, text_of(good_rows()))
    (tmp_path / "folder").mkdir()
    for file in ("run.txt", "run"):
        (tmp_path / file).write_text("t,steer\n")
    sentence = sentence_of(tmp_path / name)
    assert str(tmp_path / name) in sentence
    assert expect in sentence


def test_two_descriptions_of_one_log_are_one_too_many(tmp_path):
    write(tmp_path, text_of(good_rows()))
    (tmp_path / "run.yml").write_text("model: full\n")
    assert "run.yml" in sentence_of(tmp_path / "run.csv")


def test_the_same_run_under_two_names_does_not_count_twice(tmp_path):
    write(tmp_path, text_of(good_rows()))
    for suffix in (".csv", ".yaml"):
        (tmp_path / f"copy{suffix}").write_bytes((tmp_path / f"run{suffix}").read_bytes())
    with pytest.raises(DataError, match=r"copy\.csv: is the same run as .*run\.csv"):
        read_logs([tmp_path / "run.csv", tmp_path / "copy.csv"])


def test_rig_and_vehicle_logs_are_not_read_as_runs_of_one_thing(tmp_path):
    for name, make in (("rig", rig(no_change)), ("car", lambda folder: write(folder, text_of(good_rows())))):
        (tmp_path / name).mkdir()
        make(tmp_path / name)
    with pytest.raises(DataError, match="wheel-rig"):
        read_logs([tmp_path / "car" / "run.csv", tmp_path / "rig" / "run.csv"])


def test_no_log_at_all_is_an_error():
    with pytest.raises(DataError, match="no log"):
        read_logs([])


def test_a_file_cut_anywhere_is_read_as_the_rows_it_still_has_or_refused(tmp_path):
    text = text_of(good_rows())
    write(tmp_path, text)
    whole = read_log(tmp_path / "run.csv")
    refused = 0
    for cut in range(0, len(text), 41):
        (tmp_path / "run.csv").write_text(text[:cut])
        if refusal(tmp_path / "run.csv"):
            refused += 1
            continue
        log = read_log(tmp_path / "run.csv")
        # The last number of the last row may have lost digits: it is a reference column.
        assert np.array_equal(log.t, whole.t[: len(log)])
        assert np.array_equal(log.channels["a_z"], whole.channels["a_z"][: len(log)])
    assert refused > 50


@pytest.mark.parametrize("file", ["run.csv", "run.yaml"])
def test_damaged_bytes_never_end_in_anything_but_a_log_or_a_sentence(file, tmp_path):
    write(tmp_path, text_of(good_rows()[:12]))
    content = (tmp_path / file).read_bytes()
    rng = np.random.default_rng(11)
    refused = 0
    for _ in range(250):
        damaged = bytearray(content)
        for position in rng.integers(0, len(content), rng.integers(1, 6)):
            damaged[position] = int(rng.integers(0, 256))
        (tmp_path / file).write_bytes(bytes(damaged))
        refused += refusal(tmp_path / "run.csv").startswith(str(tmp_path))
    assert refused > 100
