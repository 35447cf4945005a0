"""Names and printed text use the terms of the field; docs/glossary.md has the few of our own that remain."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from helpers import REPOSITORY

#: What an engineer would have to translate -> what to say instead.
WORDS = {
    r"hangs? together": "are correlated",
    r"everything (that )?\w+( \w+)? hangs? (on|from)": "depends on",
    r"unknown course": "unknown input, piecewise constant",
    r"(?<!un)healthy": "null (simulation), unmodified",
    r"\bby chance|\bchance\b": "p-value, probability",
    r"(beside|with) (free|unknown|unnamed) forces?": "with unknown inputs fitted jointly",
    r"\bshadows?\b": "confounded",
    r"\brivals?\b": "likelihood-ratio statistic, alternative",
    r"\bdoubt(s|ed|ful|ing)?\b": "model uncertainty, robust",
    r"\bopinions?\b": "robust estimate, model evidence",
    r"\bvouch(es|ed)?\b": "validity flag",
    r"\bown word\b": "stated standard deviation",
    r"\b(what|than) (it|they|he|she|the \w+) (says?|said)\b": "reports, states",
    r"\bsays nothing\b": "zero action",
    r"\bguid(e|es|ed)\b": "action interface (plan / tracker / direct)",
    r"\btold\b": "with / without the terrain estimate; given",
    r"\bpromptness\b": "detection delay",
    r"\bfelt\b": "information in one sample",
    r"\bcarr(y|ies|ied) (an? )?estimators?|\bcarried estimators?\b": "online filters",
    r"\btwins?\b": "matched model",
    r"\b(twin|mismatch) form\b": "matched model, model mismatch",
    r"\bgate says\b": "hold-out log-likelihood",
    r"\bhid(e|es|ing|den)? and f(ind|ound)\b": "fault detection study",
    r"\bstranger": "unmodelled fault",
    r"\bfinder\b": "search, diagnosis",
}
DOCS = REPOSITORY / "docs"
FOLDERS = ("agents", "estimators", "offroad_env", "benchmarks")
#: Other names under which commands and options are still found; nothing else may be listed here.
ALIASES = re.compile(r"^.*#: *alias.*$|^.*# alias$", re.MULTILINE)


def texts() -> Iterator[tuple[str, str]]:
    """Code with its identifiers in words, templates, the README and the documentation."""
    for folder in FOLDERS:
        for path in sorted((REPOSITORY / folder).rglob("*")):
            if path.suffix in (".py", ".j2", ".yaml") and path.is_file():
                yield str(path.relative_to(REPOSITORY)), path.read_text(encoding="utf-8")
    made = {DOCS / "gallery", DOCS / "reference"}  # when the site is built, from the code
    pages = [page for page in sorted(DOCS.rglob("*.md")) if not made & set(page.parents)]
    for page in (REPOSITORY / "README.md", *pages):
        yield str(page.relative_to(REPOSITORY)), page.read_text(encoding="utf-8")


def in_words(text: str) -> str:
    """snake_case and CamelCase as separate words, lines kept, lines of aliases left out."""
    text = ALIASES.sub("", text)
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", text)
    return text.replace("_", " ").lower()


@pytest.mark.parametrize("word", WORDS)
def test_text_uses_the_terms_of_the_field(word):
    found = [
        f"{file}:{number} {line.strip()[:100]}"
        for file, text in texts()
        for number, line in enumerate(in_words(text).splitlines(), start=1)
        if re.search(word, line)
    ]
    assert not found, "\n".join([f"say instead: {WORDS[word]}", *found])
