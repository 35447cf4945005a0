"""Every command of the pages is run by a test, or listed with the commit and the date of its last run."""

from __future__ import annotations

import datetime
import re

from page_commands import listed, normal, run_by_howto, shown


def test_a_command_is_read_without_its_comment_and_for_any_log():
    assert normal("offroad estimate LOG...   # the soil") == "offroad estimate run.csv"


def test_the_list_names_commands_that_a_page_shows_and_each_once():
    commands = [entry["command"] for entry in listed()]
    assert sorted(commands) == sorted(set(commands))
    assert set(commands) - set(shown()) == set()
    assert set(commands) & run_by_howto() == set()


def test_every_entry_has_a_commit_a_date_and_a_reason():
    for entry in listed():
        assert set(entry) in (
            {"command", "commit", "date", "reason"},
            {"command", "commit", "date", "not_run_since"},
        )
        assert re.fullmatch(r"[0-9a-f]{7,40}", entry["commit"]), entry
        assert isinstance(entry["date"], datetime.date), entry


def test_no_long_study_is_left_to_the_tests():
    """What is not listed is run by `make check`: a minute is not enough for these."""
    names = {entry["command"] for entry in listed()} | run_by_howto()
    long = re.compile(
        r"offroad (reproduce|train|demo|speed|benchmark)\b|make |pip |dask |pytest |python (benchmarks|-m)"
    )
    assert [command for command in shown() if long.match(command) and command not in names] == []
