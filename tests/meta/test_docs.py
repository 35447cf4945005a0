"""The pages of the documentation are short enough to be read at once, and their links arrive."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from helpers import REPOSITORY

DOCS = REPOSITORY / "docs"
#: Made when the site is built.
MADE = ("gallery", "reference", "_build")
PAGES = sorted(page for page in DOCS.rglob("*.md") if page.relative_to(DOCS).parts[0] not in MADE)
LONGEST = 1200  # words of prose
#: Pages to look things up in, not to read through: tables of all keys, effects, terms, laws and functions.
REFERENCES = {"api.md", "effects.md", "equations.md", "glossary.md", "keys.md"}


def words(text: str) -> int:
    """Words of prose: headings, paragraphs and lists.

    Blocks of code, tables and the addresses of links are left out: a reader looks things up there.
    """
    text = re.sub(r"^(```|:::).*?^\1[ \t]*$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^\s*\|.*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return len(re.findall(r"\S*\w\S*", text))


def name_of(page: Path) -> str:
    return str(page.relative_to(DOCS))


def test_words_are_counted_without_code_tables_and_addresses():
    page = "# A page\n\nFour words [and](one.md) link.\n\n```\nno word\n```\n\n| none | here |\n"
    assert words(page) == 6


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_is_read_in_five_minutes(page):
    if name_of(page) in REFERENCES:
        return
    found = words(page.read_text(encoding="utf-8"))
    assert found <= LONGEST, f"{found} words: shorten the page, or move what few need into docs/details"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_line_of_a_page_is_taken_for_a_comment(page):
    """A line that begins with a per cent sign is one to the site's builder, and not shown."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^(```|:::).*?^\1[ \t]*$", "", text, flags=re.DOTALL | re.MULTILINE)
    assert re.findall(r"^\s*%.*$", text, flags=re.MULTILINE) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_question_answer_and_command_stand_apart(page):
    """As paragraphs of their own: within one they run together where the page is shown."""
    found = re.findall(r"[^\n]\n?\*\*(Answer|Command):\*\*", page.read_text(encoding="utf-8"))
    assert found == []


def anchors(page: Path) -> set[str]:
    """Places of a page that a link may name: its headings, as the site and code hosts spell them."""
    text = re.sub(r"^```.*?^```[ \t]*$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [REPOSITORY / "README.md", *PAGES], ids=lambda page: page.name)
def test_every_place_of_a_page_that_a_link_names_exists(page):
    links = re.findall(r"\]\(([^):#]*)#([^)]+)\)", page.read_text(encoding="utf-8"))
    missing = [
        f"{target}#{anchor}"
        for target, anchor in links
        if anchor not in anchors((page.parent / target) if target else page)
    ]
    assert missing == []


def test_the_overview_of_the_details_names_every_page():
    overview = DOCS / "details" / "index.md"
    named = set(re.findall(r"\]\((\w+\.md)\)", overview.read_text(encoding="utf-8")))
    assert {page.name for page in overview.parent.glob("*.md")} - {overview.name} == named


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name not in ("index.md", "equations.md")], ids=name_of
)
def test_the_caption_of_a_picture_tells_what_to_see(page):
    """A paragraph of its own in italics follows it."""
    text = page.read_text(encoding="utf-8")
    bare = re.findall(r"^!\[[^]]*\]\(([^)]*images/[^)]*)\)\n\n(?!\*)", text, flags=re.MULTILINE)
    assert bare == [], "write beneath the picture, in italics, what a reader should see in it"
