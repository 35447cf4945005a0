"""Bounds of the dependencies: the oldest versions allowed are listed, the newest lie inside."""

from __future__ import annotations

import tomllib

from packaging.requirements import Requirement
from packaging.version import Version

from helpers import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NEEDED = [Requirement(line) for line in PROJECT["dependencies"]]
EXTRAS = [Requirement(line) for lines in PROJECT["optional-dependencies"].values() for line in lines]


def pinned(file: str) -> dict[str, Version]:
    lines = (REPOSITORY / "constraints" / file).read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {name.lower().replace("_", "-"): Version(version) for name, version in pairs}


def test_the_oldest_versions_are_the_lower_bounds():
    lowest = {
        need.name.lower(): min(Version(part.version) for part in need.specifier if part.operator == ">=")
        for need in NEEDED
    }
    assert pinned("oldest.txt") == lowest


def test_the_newest_versions_lie_inside_the_bounds():
    newest = pinned("newest.txt")
    outside = [
        f"{need} has {newest[need.name.lower()]}"
        for need in (*NEEDED, *EXTRAS)
        if need.name.lower() in newest and newest[need.name.lower()] not in need.specifier
    ]
    assert outside == []
    assert {need.name.lower() for need in NEEDED} <= set(newest)
