"""``offroad log check`` as a user runs it: what it writes, what it says last, and its exit status."""

from __future__ import annotations

import json

import pytest
from foreign_logs import DESCRIPTION, Foreign, write

from agents.commands.cli import main
from estimators.logs import read_log
from estimators.logs.template import log_template
from mended_logs import DEGREES, IMU, PLAIN


def offroad(*arguments) -> int:
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


def in_degrees(channels):
    return channels | {"steer": DEGREES * channels["steer"]}


@pytest.fixture
def log(tmp_path):
    """A log whose steering angle is in degrees: one line mends it."""
    return write(tmp_path, Foreign(names=PLAIN | IMU, change=in_degrees))


def check(path, *options) -> int:
    return offroad("log", "check", path, "--out", path.parent / "out", *options)


def test_lines_are_added_and_the_log_is_read_with_them(log, capsys):
    before = log.with_suffix(".yaml").read_bytes()
    assert check(log, "--append") == 0
    assert "offroad estimate: takes it" in capsys.readouterr().out
    assert log.with_suffix(".yaml").read_bytes() == before + b"units.steer: deg\n"
    assert dict(read_log(log).config.units) == {"steer": "deg"}


def test_what_no_command_reads_is_not_approved_and_stays_as_it_is(log, capsys):
    settings = log.with_suffix(".yaml")
    content = f"# Versuch Günzburg\n{DESCRIPTION}".encode("latin-1")
    settings.write_bytes(content)
    for options in ((), ("--append",)):
        assert check(log, *options) == 1
        printed = capsys.readouterr()
        assert "takes it" not in printed.out
        assert f"{settings}: is not UTF-8 text" in printed.err
        assert settings.read_bytes() == content
    assert f"nothing was added: {settings}: is not UTF-8 text" in printed.out


def test_without_a_description_nothing_is_written_but_how_to_get_one_is_said(log, capsys):
    settings = log.with_suffix(".yaml")
    settings.unlink()
    assert check(log, "--append") == 1
    printed = capsys.readouterr()
    assert not settings.exists()
    assert "offroad log template VEHICLE writes one" in printed.err
    assert "nothing was added" in printed.out
    assert f"add to {settings}, once it is there and can be read:" in printed.out
    settings.write_text(log_template("mrzr", "dry_sand"))
    assert check(log, "--append") == 0
    assert dict(read_log(log).config.units) == {"steer": "deg"}


def test_no_line_is_added_to_one_of_two_descriptions(log):
    other = log.with_suffix(".yml")
    other.write_text(DESCRIPTION)
    assert check(log, "--append") == 1
    assert log.with_suffix(".yaml").read_text() == other.read_text() == DESCRIPTION


def test_a_description_alone_is_mended_and_only_then_without_a_problem(tmp_path, capsys):
    settings, numbers = tmp_path / "run.yaml", tmp_path / "numbers.json"
    settings.write_text(DESCRIPTION.replace("start: log\n", ""))
    assert check(settings, "--json", numbers) == 0
    assert "no problem" not in capsys.readouterr().out
    assert json.loads(numbers.read_text())["lines"] == ["start: log"]
    assert check(settings, "--append") == 0
    assert f"added: {settings}" in capsys.readouterr().out
    assert settings.read_text() == DESCRIPTION
    assert check(settings) == 0
    assert capsys.readouterr().out == f"{settings}: no problem in the description\n"


def test_a_description_with_a_value_that_no_line_mends_ends_in_an_error(tmp_path, capsys):
    settings = tmp_path / "run.yaml"
    settings.write_text(DESCRIPTION.replace("r: 0.33", "r: -2.0"))
    assert check(settings, "--append") == 1
    assert "no problem" not in capsys.readouterr().out
