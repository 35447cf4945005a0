"""The list of code changes that tests must notice: every entry can be carried out."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import yaml

from helpers import REPOSITORY


def entries() -> Iterator[tuple[str, dict]]:
    text = (REPOSITORY / "benchmarks" / "mutants.yaml").read_text(encoding="utf-8")
    for group, found in yaml.load(text, yaml.BaseLoader).items():
        for entry in found:
            yield group, entry


@pytest.mark.parametrize(("group", "entry"), list(entries()), ids=lambda value: str(value)[:60])
def test_what_is_changed_stands_in_its_file_once_and_its_tests_exist(group, entry):
    code = (REPOSITORY / entry["file"]).read_text(encoding="utf-8")
    assert code.count(entry["old"]) == 1
    assert entry["old"] != entry["new"]
    assert all((REPOSITORY / test.partition("::")[0]).exists() for test in entry["tests"])
