"""Breaks chosen places of the code one at a time and runs the tests named for each: ``make mutants``.

The places are in ``mutants.yaml``: a file, a text that stands in it once, what replaces it, and the tests
that should notice. Each is tried in a copy of the tree. Survivors, whose tests pass, are listed: a flag,
width or gate that moves by a factor of two unnoticed is decided by nobody. Results are kept in
``benchmarks/results/mutants.jsonl`` by the content of code and tests, so that the command goes on where it
stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
COPIED = (
    "agents",
    "estimators",
    "offroad_env",
    "tests",
    "benchmarks",
    "pyproject.toml",
    "README.md",
    "docs",
    "Makefile",
)
#: A mutant that takes longer hangs: noticed [s].
LONGEST = 900.0


class Mutant(NamedTuple):
    """One change and who should notice it."""

    group: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """In one line."""
        return f"{self.group}: {self.file}: {' '.join(self.old.split())} -> {' '.join(self.new.split())}"

    def key(self) -> str:
        """Of the change, the file and its tests: what was found for it holds as long as this stays."""
        text = hashlib.sha256(repr(self).encode())
        for file in (self.file, *(test.partition("::")[0] for test in self.tests)):
            for path in sorted((ROOT / file).rglob("*.py")) if (ROOT / file).is_dir() else [ROOT / file]:
                text.update(path.read_bytes())
        return text.hexdigest()[:16]


def read_mutants() -> list[Mutant]:
    """The list; refuses an entry whose text does not stand in its file exactly once."""
    found = []
    text = (ROOT / "benchmarks" / "mutants.yaml").read_text(encoding="utf-8")
    for group, entries in yaml.load(text, yaml.BaseLoader).items():  # code, not numbers: everything is text
        for entry in entries:
            mutant = Mutant(group, entry["file"], entry["old"], entry["new"], tuple(entry["tests"]))
            count = (ROOT / mutant.file).read_text(encoding="utf-8").count(mutant.old)
            if count != 1:
                sys.exit(f"mutants.yaml: {mutant.name}: stands there {count} times")
            found.append(mutant)
    return found


def run_tests(tests: tuple[str, ...], tree: Path) -> subprocess.CompletedProcess[str]:
    """The tests in a copy of the tree, up to the first that fails."""
    options = ["-q", "-x", "-p", "no:cacheprovider", "-m", "not study"]  # those of `make check` too
    command = [sys.executable, "-m", "pytest", *options, *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False
    )


@cache
def passes_unchanged(tests: tuple[str, ...], tree: Path) -> None:
    """Refuses tests that fail without a change: they would notice everything."""
    done = run_tests(tests, tree)
    if done.returncode != 0:
        sys.exit(
            f"{' '.join(tests)} fail before anything is changed: {done.stdout[-2000:]}{done.stderr[-2000:]}"
        )


def survives(mutant: Mutant, tree: Path) -> bool:
    """Whether the tests pass with the change in a copy of the tree."""
    passes_unchanged(mutant.tests, tree)
    path = tree / mutant.file
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        done = run_tests(mutant.tests, tree)
    except subprocess.TimeoutExpired:
        return False
    finally:
        path.write_text(text, encoding="utf-8")
    if done.returncode not in (0, 1, 2):
        sys.exit(f"{mutant.name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 0


def keep_latest(path: Path, names: set[str]) -> None:
    """Leave the latest result of every mutant of the list."""
    latest = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if entry["mutant"] in names:
            latest[entry["mutant"]] = line
    path.write_text("".join(f"{line}\n" for line in latest.values()), encoding="utf-8")


def main() -> int:
    """Try those that are not known yet; 1 where one survives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="mutants whose line contains this text")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "mutants.jsonl")
    options = parser.parse_args()
    known: dict[str, bool] = {}
    if options.out.is_file():
        for line in options.out.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            known[entry["key"]] = entry["survives"]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    mutants = [mutant for mutant in read_mutants() if options.only in mutant.name]
    with tempfile.TemporaryDirectory() as folder, options.out.open("a", encoding="utf-8") as file:
        tree = Path(folder)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, tree / name)
        left = []
        for mutant in mutants:
            key, start = mutant.key(), time.perf_counter()
            if key not in known:
                known[key] = survives(mutant, tree)
                entry = {"key": key, "mutant": mutant.name, "survives": known[key]}
                file.write(f"{json.dumps(entry)}\n")
                file.flush()
                word = "SURVIVES" if known[key] else "noticed"
                print(f"{word:9s} {time.perf_counter() - start:5.0f} s  {mutant.name}", flush=True)
            if known[key]:
                left.append(mutant.name)
    if not options.only:
        keep_latest(options.out, {mutant.name for mutant in mutants})
    print(f"{len(mutants)} mutants, {len(left)} survive")
    print("\n".join(left))
    return int(bool(left))


if __name__ == "__main__":
    sys.exit(main())
