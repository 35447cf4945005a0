"""The leaderboard: shipped files are whole, damaged ones are refused, and an agent finds its place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import agents
from agents.benchmark.leaderboard import board_names, find_board, read_board, standing, write_boards
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


def _run(folder: Path, scores: dict[str, float], seed: int = 4, knobs: str | None = "own") -> Path:
    """``benchmark.json`` of a run of these agents, as far as a board needs it."""
    summaries = [
        {
            "name": name,
            "score": {"value": score, "low": score - 1.0, "high": score + 1.0},
            "success": {"value": 0.75},
        }
        for name, score in scores.items()
    ]
    result = {"scenario": "brake", "form": "natural", "unit": "s", "seed": seed, "summaries": summaries}
    run = {
        "results": {"brake.natural": {**result, "arms": [{"episodes": [1, 2, 3]}]}},
        "arguments": {"knobs": knobs},
    }
    numbers = folder / "benchmark.json"
    numbers.write_text(json.dumps(run), encoding="utf-8")
    return numbers


def test_a_board_comes_from_the_numbers_of_a_run(tmp_path):
    (path,) = write_boards(_run(tmp_path, {"own": 9.0}), tmp_path)
    board = read_board(path)
    assert (board.episodes, board.seed, board.knobs) == (3, 4, "own")
    assert board.entries[0].failures == 0.25


def test_knobs_that_nobody_asked_for_are_those_of_the_form(tmp_path):
    (path,) = write_boards(_run(tmp_path, {"own": 9.0}, knobs=None), tmp_path)
    assert read_board(path).knobs == "common"


def test_agents_that_a_run_lacks_stay_on_the_board_and_are_named(tmp_path, capsys):
    write_boards(_run(tmp_path, {"nominal": 9.0, "oracle": 8.0}), tmp_path)
    assert capsys.readouterr().out == ""
    (path,) = write_boards(_run(tmp_path, {"nominal": 7.0}), tmp_path)
    assert [(entry.agent, entry.score) for entry in read_board(path).entries] == [
        ("nominal", 7.0),
        ("oracle", 8.0),
    ]
    assert "kept as they were: oracle" in capsys.readouterr().out


def test_agents_of_other_episodes_leave_the_board_and_are_named(tmp_path, capsys):
    write_boards(_run(tmp_path, {"nominal": 9.0, "oracle": 8.0}), tmp_path)
    (path,) = write_boards(_run(tmp_path, {"nominal": 7.0}, seed=5), tmp_path)
    assert [entry.agent for entry in read_board(path).entries] == ["nominal"]
    said = " ".join(capsys.readouterr().out.split())
    assert "3 episodes of seed 4, own knobs: oracle" in said


def test_the_shipped_boards_are_listed():
    assert board_names() == [path.stem.replace(".", ", ") for path in SHIPPED]
