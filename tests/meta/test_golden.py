"""The comparison of two commits: what counts as the same, what may be listed, what is an error."""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from helpers import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "benchmarks"))

import golden
from golden_compare import CLASSES, BadEntryError, Entry, compare, read_entries, unused

RECORD = {
    "numbers.json": {
        "filter": "joint",
        "n": 0.7,
        "sd": 0.01,
        "loss": 12.5,
        "valid": True,
        "runs": 3,
        "series": [1.0, 2.0, math.nan],
        "nothing": {},
    }
}


def with_value(**changes):
    """The record with other values."""
    return {"numbers.json": RECORD["numbers.json"] | changes}


def compared(new, kind="moved", entries=(), base=RECORD):
    return compare("case", kind, base, new, entries)


@pytest.mark.parametrize("kind", CLASSES)
def test_what_is_the_same_is_identical(kind):
    result = compared(json.loads(json.dumps(RECORD)), kind)
    assert result.verdict == "identical (10 leaves)"


@pytest.mark.parametrize("kind", CLASSES)
@pytest.mark.parametrize(
    "changes",
    [
        {"filter": "bank"},
        {"valid": False},
        {"valid": 1},
        {"runs": 4},
        {"n": None},
        {"n": 0.71},
        {"series": [1.0, 2.0]},
        {"series": [1.0, 2.0, 3.0]},
        {"nothing": []},
        {"more": 1.0},
    ],
    ids=str,
)
def test_no_class_takes_another_answer(changes, kind):
    result = compared(with_value(**changes), kind)
    assert len(result.different) == 1
    assert result.verdict.startswith("DIFFERENT: 1 of 1")
    assert next(iter(changes)) in result.different[0]


@pytest.mark.parametrize(
    ("name", "value", "kinds"),
    [
        pytest.param("loss", 12.5 * (1.0 + 5e-10), {"open_loop", "fitted"}, id="merged-sum"),
        pytest.param("loss", 12.5 * (1.0 + 5e-9), {"fitted"}, id="sixth-digit"),
        pytest.param("loss", 12.5 * (1.0 + 2e-5), set(), id="another-loss"),
        pytest.param("n", 0.7 + 0.9e-4, {"fitted"}, id="within-a-hundredth-of-the-sd"),
        pytest.param("n", 0.7 + 1.1e-4, set(), id="beyond-a-hundredth-of-the-sd"),
    ],
)
def test_each_class_takes_its_own_size(name, value, kinds):
    taken = {kind for kind in CLASSES if not compared(with_value(**{name: value}), kind).different}
    assert taken == kinds


@pytest.mark.parametrize(
    ("base", "new"),
    [
        pytest.param({"value": 1.0, "low": 0.9, "high": 1.1}, {"value": 1.0004}, id="interval"),
        pytest.param({"size": 1.0, "deviation": 0.1}, {"size": 1.0009}, id="deviation"),
        pytest.param({"evidence_n": [0.7], "evidence_sd": [0.1]}, {"evidence_n": [0.7009]}, id="columns"),
        pytest.param({"n_estimate": 0.7, "n_estimate_sd": 0.1}, {"n_estimate": 0.7009}, id="own-sd"),
        pytest.param({"sizes": [[[1.0, 0.1]]]}, {"sizes": [[[1.0009, 0.1]]]}, id="pair"),
    ],
)
def test_the_standard_deviation_beside_a_number_counts(base, new):
    result = compared(base | new, "fitted", base=base)
    assert result.different == []
    assert result.within == 1
    assert 0.5 < result.largest <= 1.0


def test_another_unit_beside_an_interval_does_not_count():
    base = {"nominal": 3.5, "low": 0.2, "high": 0.5}
    assert compared(base | {"nominal": 3.5005}, "fitted", base=base).different


def test_sentences_may_differ_in_the_last_digit_of_measures_only():
    base = {"says": "2 causes: lag 0.052 s (95 %: 0.046 to 0.059), 47 % less"}
    near = {"says": "2 causes: lag 0.053 s (95 %: 0.046 to 0.058), 46 % less"}
    assert compared(near, "fitted", base=base).different == []
    assert compared(near, "moved", base=base).different
    for far in (near["says"].replace("2 c", "3 c"), near["says"].replace("0.053", "0.054")):
        assert compared({"says": far}, "fitted", base=base).different


def test_times_versions_and_places_are_left_out():
    base = {"a.json": {"seconds": 1.0, "made_by": "x", "n": 0.7, "misfit": {"seconds": [8.4]}}}
    new = {"a.json": {"seconds": 2.0, "made_by": "y", "n": 0.7, "misfit": {"seconds": [8.4]}}}
    assert compared(new, base=base).verdict == "identical (2 leaves)"


def test_a_rename_reaches_keys_and_whole_words_of_values_and_may_swap():
    base = {
        "joint.json": {"filter": "joint", "says": "joint and bank, not map_joint"},
        "bank.json": {"n": 1.0},
    }
    new = {"bank.json": {"filter": "bank", "says": "bank and joint, not map_joint"}, "joint.json": {"n": 1.0}}
    entry = Entry(case="c*", rename={"joint": "bank", "bank": "joint"}, reason="swapped")
    assert compared(new, base=base).different
    assert compared(new, entries=[entry], base=base).different == []
    assert entry.used == 3
    with pytest.raises(BadEntryError, match="two leaves are called b"):
        compared({}, entries=[Entry(case="*", rename={"a": "b"}, reason="-")], base={"a": 1, "b": 2})


def test_a_move_reaches_whole_rows_of_keys_once():
    base = {"a.json": {"joint": {"joint": {"alpha": 1.0}, "mse": 2.0, "errors": [3.0]}, "mse_low": 4.0}}
    new = {"a.json": {"bank": {"joint": {"alpha": 1.0}, "score": {"mse": 2.0, "all": [3.0]}}, "mse_low": 4.0}}
    moves = {"joint.mse": "bank.score.mse", "errors": "score.all"}
    entries = [Entry(case="*", move=moves, reason="-"), Entry(case="*", move={"joint": "bank"}, reason="-")]
    assert compared(new, entries=entries, base=base).different == []
    assert [entry.used for entry in entries] == [2, 2]
    entry = Entry(case="*", move={"b": "c.b"}, path="a.*", reason="-")
    held = compared({"a": {"c": {"b": 1}}, "b": 1}, entries=[entry], base={"a": {"b": 1}, "b": 1})
    assert held.different == []


def test_a_rename_holds_on_its_path_only():
    base = {"a": {"filter": "joint"}, "b": {"filter": "joint"}}
    entry = Entry(case="*", path="a.*", rename={"joint": "bank"}, reason="-")
    result = compared({"a": {"filter": "bank"}, "b": {"filter": "bank"}}, entries=[entry], base=base)
    assert result.different == ["b.filter: 'joint' -> 'bank'"]


@pytest.mark.parametrize(
    ("entry", "new"),
    [
        ({"path": "*.more", "allow": "added"}, with_value(more=1.0)),
        ({"path": "*", "allow": "removed"}, {"numbers.json": {"filter": "joint"}}),
        ({"path": "*.n", "allow": "changed"}, with_value(n=0.8)),
        ({"path": "*.loss", "allow": "changed", "tolerance": 1e-2}, with_value(loss=12.6)),
        ({"path": "*.loss", "allow": "open_loop"}, with_value(loss=12.5 + 1e-9)),
    ],
)
def test_a_listed_difference_is_allowed_and_only_that_one(entry, new):
    listed = Entry(case="case", reason="meant", **entry)
    result = compared(new, entries=[listed])
    assert result.different == []
    assert result.allowed == listed.used > 0
    other = Entry(case="other", reason="meant", **entry)
    assert compared(new, entries=[other]).different
    assert compared(
        with_value(filter="bank"), entries=[Entry(case="case", reason="meant", **entry)]
    ).different


def test_a_listed_tolerance_is_kept():
    entry = Entry(case="case", path="*.loss", allow="changed", tolerance=1e-3, reason="-")
    assert compared(with_value(loss=12.6), entries=[entry]).different


def test_an_entry_that_nothing_needs_is_found_once_its_cases_were_compared():
    entries = [Entry(case="c*", path="*.n", allow="changed", reason="-")]
    compared(RECORD, entries=entries)
    assert unused(entries, ["case"], ["case", "other"]) == entries
    assert unused(entries, ["case"], ["case", "c2"]) == []
    assert unused([replace(entry, varies=True) for entry in entries], ["case"], ["case", "other"]) == []


@pytest.mark.parametrize(
    "text",
    [
        "- {case: a, allow: changed}",
        "- {case: a, reason: b}",
        "- {case: a, reason: b, allow: anything}",
        "- {case: a, reason: b, allow: changed, rename: {a: b}}",
        "- {case: a, reason: b, allow: changed, paht: c}",
    ],
)
def test_a_list_that_says_too_little_is_refused(text, tmp_path):
    (tmp_path / "list.yaml").write_text(text)
    with pytest.raises(BadEntryError):
        read_entries(tmp_path / "list.yaml")


def test_the_list_of_this_commit_can_be_read():
    assert all(entry.reason for entry in read_entries(golden.DIFFERENCES))


def test_every_case_has_a_name_of_its_own_and_a_class(tmp_path):
    known = golden.cases(tmp_path)
    assert len({case.name for case in known}) == len(known)
    assert {case.kind for case in known} <= set(CLASSES)
    assert {"env", "table1"} <= {case.name for case in known if case.kind == "moved"}


def test_commands_follow_the_names_of_the_working_tree(tmp_path):
    entry = Entry(case="e*", arguments={"--filter joint": "--filter lattice", "run": "go on"}, reason="-")
    tree = golden.Tree(label="", folder=tmp_path, kept=tmp_path, sources="", arguments=(entry,))
    case = golden.Case(
        name="e", kind="moved", seconds=1.0, commands=(("run", "--filter", "joint"), ("joint",))
    )
    assert tree.commands(case) == [["go", "on", "--filter", "lattice"], ["joint"]]
    assert entry.used == 2


def test_results_are_read_from_every_kind_of_file(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.json").write_text('{"n": 0.7}')
    (tmp_path / "b.jsonl").write_text('{"key": ["ukf", 3], "result": {"n": NaN}}\n')
    (tmp_path / "c.csv").write_text("t,flag\n0.5,yes\n1e-3,no\n")
    (tmp_path / "page.html").write_text("<p>")
    found = golden.plain_result(tmp_path)
    assert math.isnan(found.pop("b.jsonl")["ukf 3"]["result"]["n"])
    assert found == {"sub/a.json": {"n": 0.7}, "c.csv": {"t": [0.5, 0.001], "flag": ["yes", "no"]}}


@pytest.mark.parametrize(
    ("listed", "new", "status"),
    [
        ("", RECORD, 0),
        ("", with_value(n=0.8), 1),
        ("- {case: env, path: '*.n', allow: changed, reason: meant}", with_value(n=0.8), 0),
        ("- {case: env, path: '*.n', allow: changed, reason: meant}", RECORD, 1),
    ],
    ids=["same", "another", "listed", "listed in vain"],
)
def test_the_exit_status_tells(listed, new, status, tmp_path, monkeypatch, capsys):
    for name in ("chrono_scm", "cmu_single_wheel", "f1tenth_indoor"):
        (tmp_path / name).mkdir()
    (tmp_path / "list.yaml").write_text(listed)
    monkeypatch.setattr(golden, "git", lambda *words: "0" * 40)
    monkeypatch.setattr(golden, "base_results", lambda *_: {"env": RECORD})
    monkeypatch.setattr(golden, "own_results", lambda *_: ("sources", {"env": new}))
    args = argparse.Namespace(
        base="HEAD", cases=["env"], keep=False, base_only=False, cache=tmp_path / "cache", data=tmp_path,
        differences=tmp_path / "list.yaml", jobs=1, json=tmp_path / "comparison.json", list=False,
    )  # fmt: skip
    assert golden.run(args) == status
    said = capsys.readouterr().out
    assert ("DIFFERENT" in said) == (status == 1 and not listed)
    assert ("of no use any more" in said) == (status == 1 and bool(listed))
    written = json.loads((tmp_path / "comparison.json").read_text())
    assert written["cases"]["env"]["leaves"] == 10


@pytest.mark.skipif(shutil.which("make") is None, reason="this machine has no make")
def test_make_asks_for_a_base():
    command = ["make", "golden", f"VENV={sys.prefix}", f"--assume-old={sys.prefix}/.installed-test"]
    apart = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS")) and k != "BASE"}
    done = subprocess.run(
        command, cwd=REPOSITORY, env=apart, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode != 0
    assert "make golden BASE=COMMIT" in done.stderr
