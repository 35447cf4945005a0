"""The page of a study: each figure with a caption that tells what to see."""

from __future__ import annotations

import ast

import pytest

from agents.reports.output import Record
from agents.reports.study import render_study
from helpers import REPOSITORY

STUDIES = sorted((REPOSITORY / "agents" / "studies").glob("*/study.py"))


def captions(path):
    """Captions of the figures that a module writes; None where there is none."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "save_figure":
            yield ast.literal_eval(node.args[2]) if len(node.args) > 2 else None


def test_the_caption_stands_below_its_figure():
    record = Record(lines=["n errs by 2 %"], figures=[("errors", b"png", "Lower is better.")])
    page = render_study("errors", "errors of n", record, command="offroad", footer="")
    assert "<figcaption>Lower is better.</figcaption>" in " ".join(page.split())


def test_the_titles_of_several_tables_are_sentences_and_names_from_the_code_keep_their_letters():
    tables = [("first table", ("row",), (("1",),), 0), ("every filter", ("row",), (("1",),), 0)]
    record = Record(lines=["all", "map_ukf_bank: no error"], tables=tables)
    page = render_study("errors", "errors of n", record, command="offroad", footer="")
    assert "First table. Every filter." in page
    assert "map_ukf_bank: no error." in page


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.parent.name)
def test_every_figure_of_a_study_has_a_caption(path):
    assert [caption for caption in captions(path) if not (caption or "").endswith(".")] == []
