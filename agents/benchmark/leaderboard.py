"""The leaderboard: scores of agents on test episodes of the benchmark, in files of the package.

``python -m agents.benchmark.leaderboard out/benchmark/benchmark.json`` writes or renews the file of every
task and form in it, `agents/leaderboard/TASK.FORM.json`. Agents of the file that the run lacks are kept where
it drove the same episodes, and named in any case. `offroad compare` prints where an agent of one's own
stands.
"""

from __future__ import annotations

import importlib.resources
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from agents.benchmark.study import usual_knobs
from agents.reports.output import say, write_bytes
from offroad_env.errors import DataError
from offroad_env.world.files import read_json, require_keys

__all__ = ["Board", "Entry", "board_names", "find_board", "read_board", "standing", "write_boards"]

_FOLDER = "leaderboard"
_NUMBERS = ("score", "low", "high", "failures")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An agent."""

    agent: str
    score: float  #: mean over the episodes, less is better
    low: float  #: 95 % interval of the mean
    high: float
    failures: float  #: share of the episodes [-]


@dataclass(frozen=True, kw_only=True)
class Board:
    """Agents on the same test episodes, the best first."""

    task: str
    form: str
    unit: str
    episodes: int
    seed: int
    knobs: str  #: of the arms
    entries: tuple[Entry, ...]

    @property
    def conditions(self) -> tuple[int, int, str]:
        """What scores of one board share: number and seed of the episodes, knobs of the arms."""
        return self.episodes, self.seed, self.knobs


def read_board(path: Path) -> Board:
    """A file of the leaderboard.

    Raises
    ------
    DataError
        If it is damaged, or its numbers cannot be.
    """
    table, file = read_json(path), str(path)
    texts = dict.fromkeys(("task", "form", "unit", "knobs"), str)
    require_keys(table, {**texts, "episodes": int, "seed": int, "entries": list}, file)
    entries = []
    for row in table["entries"]:
        if not isinstance(row, dict):
            raise DataError(f"{file}: an entry must be a mapping, is {row!r}")
        require_keys(row, {"agent": str, **dict.fromkeys(_NUMBERS, (int, float))}, file)
        entry = Entry(agent=row["agent"], **{key: float(row[key]) for key in _NUMBERS})
        if not (entry.low <= entry.score <= entry.high and 0.0 <= entry.failures <= 1.0):
            raise DataError(
                f"{file}: {entry.agent}: score outside of its interval, or failures outside of 0 to 1"
            )
        entries.append(entry)
    if not entries:
        raise DataError(f"{file}: a leaderboard has at least one agent")
    return Board(
        **{key: table[key] for key in (*texts, "episodes", "seed")},
        entries=tuple(sorted(entries, key=lambda entry: entry.score)),
    )


def _place(task: str, form: str) -> Path:
    return Path(str(importlib.resources.files("agents"))) / _FOLDER / f"{task}.{form}.json"


def find_board(task: str, form: str) -> Board | None:
    """The shipped board of a task and form; None where there is none."""
    path = _place(task, form)
    return read_board(path) if path.exists() else None


def board_names() -> list[str]:
    """``task, form`` of every shipped board."""
    return [path.stem.replace(".", ", ") for path in sorted(_place("", "").parent.glob("*.json"))]


def standing(board: Board, agent: str, score: float, episodes: int) -> str:
    """Where an agent with this mean score would stand."""
    better = sum(entry.score < score for entry in board.entries)
    place = f"place {better + 1} of {len(board.entries) + 1} on the leaderboard"
    text = f"{agent}: {score:.3g} {board.unit}, {place}"
    neighbours = [*board.entries[max(better - 1, 0) : better], *board.entries[better : better + 1]]
    beside = ", ".join(f"{entry.agent} {entry.score:.3g} {board.unit}" for entry in neighbours)
    text += f" of {board.task}, {board.form} (beside {beside}; {board.episodes} episodes, seed {board.seed})"
    return text if episodes >= board.episodes else f"{text}; {episodes} episodes are few for a place"


def _with_absent(board: Board, former: Board | None) -> tuple[Board, str]:
    """The board with those agents of the former one that the run lacks, and a sentence on them.

    They are kept only where they drove the same episodes; scores of others cannot be compared.
    """
    present = {entry.agent for entry in board.entries}
    absent = [entry for entry in former.entries if entry.agent not in present] if former is not None else []
    if former is None or not absent:
        return board, ""
    name, agents = f"{board.task}, {board.form}", ", ".join(entry.agent for entry in absent)
    if former.conditions != board.conditions:
        there = "{} episodes of seed {}, {} knobs".format(*former.conditions)
        return board, f"{name}: not in this run, and left out, since they drove {there}: {agents}"
    entries = sorted((*board.entries, *absent), key=lambda entry: entry.score)
    return replace(board, entries=tuple(entries)), f"{name}: not in this run, kept as they were: {agents}"


def write_boards(numbers: Path, folder: Path) -> list[Path]:
    """Boards from the ``benchmark.json`` of a run, into ``folder``; says which agents the run lacks."""
    run, written = read_json(numbers), []
    for result in run["results"].values():
        entries = [
            Entry(
                agent=arm["name"],
                score=arm["score"]["value"],
                low=arm["score"]["low"],
                high=arm["score"]["high"],
                failures=round(1.0 - arm["success"]["value"], 6),
            )
            for arm in result["summaries"]
        ]
        board = Board(
            task=result["scenario"],
            form=result["form"],
            unit=result["unit"],
            episodes=len(result["arms"][0]["episodes"]),
            seed=int(result["seed"]),
            knobs=run["arguments"]["knobs"] or usual_knobs(result["form"]),
            entries=tuple(sorted(entries, key=lambda entry: entry.score)),
        )
        path = folder / f"{board.task}.{board.form}.json"
        board, absent = _with_absent(board, read_board(path) if path.exists() else None)
        if absent:
            say(absent)
        written.append(write_bytes(path, f"{json.dumps(asdict(board), indent=1)}\n".encode()))
    return written


if __name__ == "__main__":
    write_boards(Path(sys.argv[1]), _place("", "").parent)
