"""A number that one page repeats from another is on that page: README, overviews and their sources agree."""

from __future__ import annotations

import re
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from pathlib import Path

import pytest

from helpers import REPOSITORY

DOCS = REPOSITORY / "docs"
README = REPOSITORY / "README.md"
#: Pages with tables whose last column names the page that a row is taken from.
OVERVIEWS = (DOCS / "results.md", DOCS / "benchmark.md", DOCS / "filters.md")
LINK = re.compile(r"\]\(([\w/.-]+\.md)(?:#[\w-]+)?\)")
NUMBER = re.compile(r"(?<![\w.])(?:\d+(?:,\d{3})+|\d*\.\d+|\d+)(?:e-?\d+)?(?![\w.]*\w)")
#: In words, where a page spells them out.
WORDS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def numbers(text: str) -> list[Decimal]:
    """The numbers of a text, without its addresses and code."""
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "", text))
    for value, word in enumerate(WORDS):
        text = re.sub(rf"\b{word}\b", str(value), text, flags=re.IGNORECASE)
    return [Decimal(number.replace(",", "")) for number in NUMBER.findall(text)]


def is_rounded_from(stated: Decimal, exact: Decimal) -> bool:
    step = Decimal(1).scaleb(min(int(stated.as_tuple().exponent), 0))
    return any(exact.quantize(step, rounding) == stated for rounding in (ROUND_HALF_UP, ROUND_HALF_EVEN))


def missing(text: str, sources: list[Path]) -> list[Decimal]:
    """Numbers of a text that stand on none of its sources, not even with more digits."""
    there = {number for page in sources for number in numbers(page.read_text(encoding="utf-8"))}
    return [stated for stated in numbers(text) if not any(is_rounded_from(stated, exact) for exact in there)]


def rows() -> list[tuple[str, str, list[Path]]]:
    """Page, row without its last cell, and the pages that the last cell names."""
    found = []
    for page in OVERVIEWS:
        for line in page.read_text(encoding="utf-8").splitlines():
            *cells, last = [cell.strip() for cell in line.strip("|").split("|")]
            sources = [page.parent / link for link in LINK.findall(last)]
            if line.startswith("|") and sources:
                found.append((page.name, " | ".join(cells), sources))
    return found


def test_a_number_may_be_rounded_but_not_changed(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("errs by .0274 rad in 1,065 of `12` runs ([other](33.md)), two of 1.69")
    assert missing("errs by 0.027, in 1065, 2 of 1.7", [page]) == []
    assert missing("errs by 0.032 in 12 runs of 33", [page]) == [Decimal("0.032"), 12, 33]


@pytest.mark.parametrize(("page", "row", "sources"), rows(), ids=lambda value: str(value)[:30])
def test_a_row_of_an_overview_has_the_numbers_of_its_page(page, row, sources):
    assert missing(row, sources) == [], f"{page}: not on {[source.name for source in sources]}"


def test_the_readme_has_the_numbers_of_its_pages():
    results = README.read_text(encoding="utf-8").split("## Three results")[1].split("[All results")[0]
    parts = re.split(r"\n(?=\*\*)", results)[1:]
    assert len(parts) == 3
    for part in parts:
        sources = [REPOSITORY / link for link in LINK.findall(part)]
        assert sources
        assert missing(part, sources) == [], part
