"""The leaderboard: shipped files are whole, damaged ones are refused, and an agent finds its place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import agents
from agents.benchmark.leaderboard import find_board, read_board, standing, write_boards
from offroad_env.errors import DataError

SHIPPED = sorted((Path(agents.__file__).parent / "leaderboard").glob("*.json"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_board_is_whole_and_named_by_its_task_and_form(path):
    board = read_board(path)
    assert path.name == f"{board.task}.{board.form}.json"
    assert board == find_board(board.task, board.form)
    assert [entry.score for entry in board.entries] == sorted(entry.score for entry in board.entries)
    assert board.episodes >= 100


def test_an_agent_stands_between_those_who_are_better_and_worse():
    board = find_board("brake", "natural")
    best = board.entries[0]
    count = len(board.entries) + 1
    assert f"place 1 of {count}" in standing(board, "own", best.score - 1.0, 100)
    assert f"place {count} of {count}" in standing(board, "own", 39.0, 100)
    second = standing(board, "own", best.score + 1e-6, 20)
    assert f"place 2 of {count}" in second
    assert best.agent in second
    assert "few" in second
    assert find_board("brake", "mismatch") is None


@pytest.mark.parametrize(
    ("key", "value"),
    [("entries", []), ("entries", [1]), ("task", 3), ("episodes", None), ("seed", "x")],
)
def test_a_damaged_board_is_refused(tmp_path, key, value):
    table = json.loads(SHIPPED[0].read_text(encoding="utf-8"))
    path = tmp_path / "board.json"
    path.write_text(json.dumps({**table, key: value}), encoding="utf-8")
    with pytest.raises(DataError):
        read_board(path)


def test_a_score_outside_of_its_interval_is_refused(tmp_path):
    table = json.loads(SHIPPED[0].read_text(encoding="utf-8"))
    table["entries"][0]["low"] = table["entries"][0]["score"] + 1.0
    path = tmp_path / "board.json"
    path.write_text(json.dumps(table), encoding="utf-8")
    with pytest.raises(DataError, match="interval"):
        read_board(path)


def test_a_board_comes_from_the_numbers_of_a_run(tmp_path):
    summary = {"name": "own", "score": {"value": 9.0, "low": 8.0, "high": 10.0}, "success": {"value": 0.75}}
    result = {"scenario": "brake", "form": "natural", "unit": "s", "seed": 4, "summaries": [summary]}
    run = {
        "results": {"brake.natural": {**result, "arms": [{"episodes": [1, 2, 3]}]}},
        "arguments": {"knobs": "own"},
    }
    numbers = tmp_path / "benchmark.json"
    numbers.write_text(json.dumps(run), encoding="utf-8")
    (path,) = write_boards(numbers, tmp_path)
    board = read_board(path)
    assert (board.episodes, board.seed, board.knobs) == (3, 4, "own")
    assert board.entries[0].failures == 0.25
