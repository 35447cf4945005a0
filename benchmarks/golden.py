"""The main commands on two commits, and whether their numbers are the same: ``make golden BASE=COMMIT``.

Runs the cases below on BASE, checked out into a temporary worktree, and on the working tree as it is; then
compares what they wrote leaf by leaf (`golden_compare` says what may differ). Exit status 1 where anything
differs, or where an entry of ``golden_differences.yaml`` is of no use any more; 2 where a case breaks down.

It knows the commands, the environment's name and their files, nothing of the code: what moves does not
concern it. The commands are those of the base; where one is called otherwise in the working tree, an entry
of the list says so. Results are kept by commit below ``out/golden``, so that a base runs once; the working
tree runs anew, unless ``--keep`` finds results of the very same sources.

Both sides run without fused multiply-add instructions. With them the compiler chooses anew, whenever a kernel
or one that calls it changes, which multiplications share a rounding with an addition, and every drive differs
in its last bits although no operation was changed. Without them the same operations in the same order give
the same numbers, bit for bit. (On processors that cannot do without, last bits may differ.)

Left out, besides times, versions and places: figures and pages, which show the numbers that are compared;
the demo's learning, which ends by the clock - ``train`` with a number of steps stands in for it.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml
from golden_compare import Comparison, Entry, compare, read_entries, unused

ROOT = Path(__file__).resolve().parents[1]
DIFFERENCES = Path(__file__).with_name("golden_differences.yaml")
#: First word of the command that drives the environment; the others are for `offroad`.
ENVIRONMENT = "golden_env"
#: Leaves that are printed of a case that differs, and written to ``--json``.
PRINTED, WRITTEN = 8, 1000
#: Words of commands that stand for a folder.
DATA = "{data}"
#: A processor without fused multiply-add, where numba can make code for one: see above.
UNFUSED = (
    {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "+sse4.2,+avx,+avx2"}
    if platform.machine() in ("x86_64", "AMD64")
    else {}
)
#: Calls an entry point of a source tree, and nothing of another one.
_CALL = """\
import importlib, sys
from pathlib import Path
tree, module, function = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
sys.argv[:4] = ["offroad"]
sys.meta_path[:] = [f for f in sys.meta_path if not getattr(f, "__module__", "").startswith("__editable__")]
entry = importlib.import_module(module)
print("entry point:", entry.__file__)
assert Path(entry.__file__).is_relative_to(tree), f"not from {tree}"
try:
    getattr(entry, function)()
finally:
    own = {path.parent.name for path in tree.glob("*/__init__.py")}
    for name, loaded in list(sys.modules.items()):
        if name.partition(".")[0] in own and getattr(loaded, "__file__", None):
            assert Path(loaded.__file__).is_relative_to(tree), f"{loaded.__file__} is not from {tree}"
"""


class GoldenError(RuntimeError):
    """The comparison cannot be made."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """Commands whose results are compared."""

    name: str
    kind: str  #: class of `golden_compare`
    seconds: float  #: about what it takes: the longest cases begin first
    commands: tuple[tuple[str, ...], ...]  #: one after the other, in one folder


def _estimates(log: str, filters: Iterable[str]) -> list[tuple[str, ...]]:
    return [
        ("estimate", log, "--filter", name, "--n-prior", "0.7", "--out", "estimate", "--json", f"{name}.json")
        for name in filters
    ]


def cases(data: Path) -> list[Case]:
    """All cases, for the logs in a folder of measured data."""
    own, mapped = ("parameter", "joint", "bank"), ("map_joint", "map_bank", "map_ekf")
    result: list[Case] = []

    def add(name: str, kind: str, seconds: float, *commands: str | Sequence[str]) -> None:
        words = (tuple(line.split() if isinstance(line, str) else line) for line in commands)
        result.append(Case(name=name, kind=kind, seconds=seconds, commands=tuple(words)))

    numbers = "--out . --json numbers.json"
    parts = "soil forward exponent drive estimate arms diagnose wheel-data"
    add("env", "moved", 10, f"{ENVIRONMENT} joint bank")
    add("demo", "fitted", 50, f"demo --quick --only {parts} --out .")
    add("train", "moved", 9, f"train --total-steps 4096 --check-episodes 0 --threads 1 {numbers}")
    add("table1", "moved", 70, f"reproduce table1 --quick --n-jobs 1 {numbers}")
    add("mismatch", "fitted", 70, f"reproduce mismatch --quick --n-jobs 1 {numbers}")
    hidden = "steer_lag steer_delay payload rut_drag accel_bias_z slip_sinkage pose_delay yaw_moment n_step"
    add(
        "diagnosis",
        "fitted",
        85,
        "reproduce diagnosis --nulls 2 --whites 1 --seeds 1 --power-seeds 0 --pairs 1 --removed 0 "
        f"--stranger-seeds 1 --same 1 --effects {hidden} --n-jobs 1 {numbers}",  # alias
    )
    tasks = {"track": 19, "speed": 70, "climb": 30, "brake": 16, "ride": 17, "patches": 22}
    for task, seconds in tasks.items():
        add(f"benchmark-{task}", "moved", seconds, f"benchmark --quick --tasks {task} --n-jobs 1 --out .")
    for log in sorted((data / "chrono_scm").glob("*.yaml")):
        add(f"diagnose-{log.stem}", "fitted", 25, f"diagnose {DATA}/chrono_scm/{log.stem}.csv --out .")
    rig = "diagnose log/cmu_single_wheel.csv --rig --out rig"
    add(
        "diagnose-soil_bin", "fitted", 17, "data log cmu_single_wheel --out log", rig, f"wheel-data {numbers}"
    )
    for drive in ("DS1", "DS2", "DS3"):
        log = f"data log f1tenth_indoor {DATA}/f1tenth_indoor/{drive}.csv"
        mended = (f"{log} --corrected --out log", f"diagnose log/{drive}.csv --out diagnosis")
        published = (f"{log} --out published", f"diagnose published/{drive}.csv --out published")
        add(f"diagnose-{drive}", "fitted", 65, *mended, *published)
    driven = "drive --model paper --agent stanley --duration 15 --seed 3 --n 0.7 --log run.csv --out ."
    paper = f"{driven} --json drive.json"
    add("estimate-paper", "fitted", 42, paper, *_estimates("run.csv", [*own, *mapped]))
    log = f"{DATA}/chrono_scm/clay_0.05_sin02_R0.csv"
    add("estimate-chrono", "fitted", 20, *_estimates(log, [*own, mapped[0]]))
    return result


def plain_result(folder: Path) -> dict[str, Any]:
    """Every file of numbers below a folder, by its name: columns of CSV, units of JSON lines by key."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            found[name] = json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".yaml":
            # Through text: what YAML knows besides, such as dates, becomes a string.
            found[name] = json.loads(
                json.dumps(yaml.safe_load(path.read_text(encoding="utf-8")), default=str)
            )
        elif path.suffix == ".jsonl":
            units = list(map(json.loads, path.read_text(encoding="utf-8").splitlines()))
            for unit in units:
                unit.pop("crc", None)  # of the line with its stamp, which differs between commits
            found[name] = {" ".join(map(str, unit.pop("key"))): unit for unit in units}
        elif path.suffix == ".csv":
            with path.open(encoding="utf-8", newline="") as file:
                head, *rows = csv.reader(line for line in file if not line.startswith("#"))
            found[name] = {key: [_cell(row[i]) for row in rows] for i, key in enumerate(head)}
    return found


def _cell(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


@dataclass(frozen=True, kw_only=True)
class Tree:
    """Sources, and where the results of their cases are kept."""

    label: str
    folder: Path
    kept: Path
    sources: str  #: commit, or digest of the files
    arguments: tuple[Entry, ...] = ()  #: words of commands that are others here

    def commands(self, case: Case) -> list[list[str]]:
        """The commands of a case in the words of this tree."""
        entries = [entry for entry in self.arguments if fnmatchcase(case.name, entry.case)]
        return [_said(list(command), entries) for command in case.commands]

    def call(self, command: Sequence[str]) -> list[str]:
        """A command as a process of Python."""
        if command[0] == ENVIRONMENT:
            script = Path(__file__).with_name(f"{ENVIRONMENT}.py")
            return [sys.executable, str(script), str(self.folder), "env.json", *command[1:]]
        project = tomllib.loads((self.folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        module, _, function = project["scripts"]["offroad"].partition(":")
        return [sys.executable, "-c", _CALL, str(self.folder), module, function, *command]


def _said(command: list[str], entries: Sequence[Entry]) -> list[str]:
    """A command with the words of the entries replaced by theirs; a word may stand for several."""
    for entry in entries:
        for old, new in entry.arguments.items():
            words, i = old.split(), 0
            while i < len(command):
                if command[i : i + len(words)] == words:
                    command[i : i + len(words)] = new.split()
                    entry.used += 1
                    i += len(new.split()) - 1
                i += 1
    return command


def run_case(tree: Tree, case: Case, data: Path) -> dict[str, Any]:
    """What the commands of a case write and how they end; raises `GoldenError` where one breaks down."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    own = UNFUSED | {
        "PYTHONPATH": str(tree.folder),
        "OFFROAD_DATA": str(data),
        "PYTHONHASHSEED": "0",
        "MPLBACKEND": "Agg",
    }
    ends = []
    with tempfile.TemporaryDirectory(prefix="golden-") as name:
        for command in tree.commands(case):
            filled = [word.replace(DATA, str(data)) for word in tree.call(command)]
            done = subprocess.run(
                filled,
                cwd=name,
                env=os.environ | single | own | {"MPLBACKEND": "Agg"},
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode not in (0, 1) or "Traceback (most recent call last)" in done.stderr:
                raise GoldenError(f"{' '.join(command)} (status {done.returncode}): {done.stderr[-3000:]}")
            said = done.stderr.strip().splitlines()[-1:] if done.returncode else []
            ends.append({"status": done.returncode, "said": said})
        return {"ends": ends, **plain_result(Path(name))}


@cache
def _digest_of_data(data: Path) -> str:
    files = (path for path in sorted(data.rglob("*")) if path.is_file())
    listing = "".join(f"{path.relative_to(data)} {path.stat().st_size}\n" for path in files)
    return hashlib.sha256(listing.encode()).hexdigest()[:16]


def made_with(tree: Tree, case: Case, data: Path) -> dict[str, Any]:
    """What a kept result must have been made with to be of use."""
    script = Path(__file__).with_name(f"{ENVIRONMENT}.py").read_bytes() if case.name == "env" else b""
    return {
        "sources": tree.sources,
        "commands": tree.commands(case),
        "script": hashlib.sha256(script).hexdigest()[:16],
        "data": _digest_of_data(data),
        "code": UNFUSED,
        "machine": f"{platform.node()} {platform.machine()} Python {platform.python_version()}",
        "packages": {name: version(name) for name in ("numpy", "numba", "scipy", "gymnasium")},
    }


def kept_results(tree: Tree, chosen: Sequence[Case], data: Path) -> dict[str, Any]:
    """Earlier results that hold, by case."""
    found = {}
    for case in chosen:
        path = tree.kept / f"{case.name}.json"
        kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        if kept.get("made_with") == made_with(tree, case, data):
            found[case.name] = kept["files"]
    return found


def run_cases(tree: Tree, missing: Sequence[Case], data: Path, jobs: int) -> dict[str, Any]:
    """Run cases and keep their results; those that break down are not among them."""
    done: dict[str, Any] = {}
    broken, lock, begin = [], threading.Lock(), time.perf_counter()

    def run_one(case: Case) -> None:
        start, word = time.perf_counter(), ""
        content = {"made_with": made_with(tree, case, data)}
        try:
            content["files"] = run_case(tree, case, data)
        except GoldenError as error:
            word = f"  BROKE DOWN: {error}"
        content["seconds"] = time.perf_counter() - start
        with lock:
            if word:
                broken.append(case.name)
            else:
                _write(tree.kept / f"{case.name}.json", content)
                done[case.name] = content["files"]
            share = f"{len(done) + len(broken)}/{len(missing)}"
            print(f"{share:>6}  {tree.label}  {case.name:<28} {content['seconds']:6.1f} s{word}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run_one, sorted(missing, key=lambda case: -case.seconds)))
    print(f"== {tree.label}: {time.perf_counter() - begin:.0f} s", flush=True)
    return done


def _write(path: Path, content: Any) -> None:
    """Whole or not at all; several may write the same base's results."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
        json.dump(content, file)
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def git(*words: str) -> str:
    """What git says about this repository."""
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise GoldenError(f"git {words[0]}: {done.stderr.strip()}")
    return done.stdout.strip()


def digest_of_sources() -> str:
    """Digest of all files of the working tree that git knows or would add, but for texts and tests."""
    text = hashlib.sha256()
    for name in sorted(set(git("ls-files", "-co", "--exclude-standard").splitlines())):
        path = ROOT / name
        apart = name.split("/")[0] in ("docs", "tests", "benchmarks") or name.endswith(".md")
        if path.is_file() and not apart:
            text.update(name.encode() + b"\0" + path.read_bytes())
    return text.hexdigest()[:16]


@contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """A worktree of a commit, for a while."""
    with tempfile.TemporaryDirectory(prefix="golden-base-") as name:
        folder = Path(name).resolve() / commit[:10]
        git("worktree", "add", "--detach", str(folder), commit)
        try:
            yield folder
        finally:
            git("worktree", "remove", "--force", str(folder))


def base_results(commit: str, kept: Path, chosen: Sequence[Case], data: Path, jobs: int) -> dict[str, Any]:
    """Result of every case of a commit, which is checked out if one is missing."""
    tree = Tree(label=f"base {commit[:7]}", folder=Path(), kept=kept, sources=commit)
    done = kept_results(tree, chosen, data)
    missing = [case for case in chosen if case.name not in done]
    print(f"== {tree.label}: {len(done)} cases kept, {len(missing)} to run", flush=True)
    if missing:
        with checked_out(commit) as folder:
            done |= run_cases(replace(tree, folder=folder), missing, data, jobs)
    broken = [case.name for case in chosen if case.name not in done]
    if broken:
        raise GoldenError(f"{tree.label}: {', '.join(broken)} broke down")
    return done


def own_results(
    place: Path, entries: Sequence[Entry], chosen: Sequence[Case], data: Path, args: argparse.Namespace
) -> tuple[str, dict[str, Any]]:
    """Digest of the working tree's sources, and the result of every case that does not break down."""
    sources = digest_of_sources()
    renamed = tuple(entry for entry in entries if entry.arguments)
    tree = Tree(label="working tree", folder=ROOT, kept=place, sources=sources, arguments=renamed)
    done = kept_results(tree, chosen, data) if args.keep else {}
    missing = [case for case in chosen if case.name not in done]
    print(f"== {tree.label}: {len(done)} cases kept, {len(missing)} to run", flush=True)
    done |= run_cases(tree, missing, data, args.jobs) if missing else {}
    if digest_of_sources() != sources:
        print("NOTE: the sources changed while the cases ran")
    return sources, done


def chosen_cases(known: Sequence[Case], globs: Sequence[str]) -> list[Case]:
    """Cases by name or glob; all without any."""
    lost = [glob for glob in globs if not any(fnmatchcase(case.name, glob) for case in known)]
    if lost:
        raise GoldenError(f"no case {lost[0]!r} - known: {', '.join(case.name for case in known)}")
    return [case for case in known if not globs or any(fnmatchcase(case.name, glob) for glob in globs)]


def report(comparisons: Sequence[Comparison], entries: Sequence[Entry], stale: Sequence[Entry]) -> None:
    """Verdict by case, the first leaves that differ, the differences that are listed."""
    print("== comparison")
    for comparison in comparisons:
        print(f"{comparison.case:<28} [{comparison.kind}] {comparison.verdict}")
        for said in comparison.different[:PRINTED]:
            print(f"    {said}")
        if len(comparison.different) > PRINTED:
            print(f"    ... {len(comparison.different) - PRINTED} more")
    for entry in entries:
        if entry.used:
            print(f"listed, {entry.used} times: {entry}")
    for entry in stale:
        print(f"ERROR: listed, but of no use any more: {entry}")


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    kept = Path(os.environ.get("OFFROAD_GOLDEN") or ROOT / "out" / "golden")
    data = Path(os.environ.get("OFFROAD_DATA") or ROOT.parent / "shared" / "data")
    parser.add_argument("--base", metavar="COMMIT", help="what the working tree is compared with")
    parser.add_argument("--cases", nargs="*", default=[], metavar="CASE", help="names or globs; default all")
    parser.add_argument("--keep", action="store_true", help="use earlier results of exactly these sources")
    parser.add_argument("--base-only", action="store_true", help="run what is missing of the base, no more")
    parser.add_argument("--cache", type=Path, default=kept, help="of results (OFFROAD_GOLDEN, %(default)s)")
    parser.add_argument("--data", type=Path, default=data, help="measured data (OFFROAD_DATA, %(default)s)")
    parser.add_argument("--differences", type=Path, default=DIFFERENCES, help="what may differ (%(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (%(default)s)")
    parser.add_argument("--json", type=Path, help="also write the comparison to this file")
    parser.add_argument("--list", action="store_true", help="name the cases")
    return parser.parse_args()


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    data, kept = args.data.resolve(), args.cache.resolve()
    known = cases(data)
    chosen = chosen_cases(known, args.cases)
    if args.list:
        print("\n".join(f"{case.name:<28} {case.kind:<7} {case.seconds:4.0f} s" for case in chosen))
        return 0
    if not args.base:
        raise GoldenError("name what to compare with: make golden BASE=COMMIT")
    for name in ("chrono_scm", "cmu_single_wheel", "f1tenth_indoor"):
        if not (data / name).is_dir():
            raise GoldenError(f"{data} lacks {name}: name the folder of measured data by --data")
    entries = read_entries(args.differences)
    commit = git("rev-parse", "--verify", f"{args.base}^{{commit}}")
    old = base_results(commit, kept / commit, chosen, data, args.jobs)
    if args.base_only:
        return 0
    place = kept / f"working-{hashlib.sha256(str(ROOT).encode()).hexdigest()[:8]}"
    sources, new = own_results(place, entries, chosen, data, args)
    comparisons = [
        compare(case.name, case.kind, old[case.name], new[case.name], entries)
        for case in chosen
        if case.name in new
    ]
    stale = unused(entries, [one.case for one in comparisons], [case.name for case in known])
    report(comparisons, entries, stale)
    if args.json:
        _write(args.json, summary(commit, sources, comparisons, entries))
    broken = [case.name for case in chosen if case.name not in new]
    if broken:
        raise GoldenError(f"the working tree breaks down: {', '.join(broken)}")
    return int(bool(stale) or any(comparison.different for comparison in comparisons))


def summary(
    commit: str, sources: str, comparisons: Sequence[Comparison], entries: Sequence[Entry]
) -> Mapping[str, Any]:
    """The comparison as JSON takes it."""
    found = {}
    for one in comparisons:
        found[one.case] = {**vars(one), "different": one.different[:WRITTEN], "verdict": one.verdict}
    return {
        "base": commit,
        "sources": sources,
        "cases": found,
        "listed": [{"entry": str(entry), "used": entry.used} for entry in entries],
    }


def main() -> int:
    """Exit status: 1 where anything differs, 2 where the comparison cannot be made."""
    try:
        return run(arguments())
    except (GoldenError, ValueError) as error:
        print(f"golden: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
