"""The page of a study: its result in a sentence, its figures, its tables."""

from __future__ import annotations

from agents.reports.output import Record
from agents.reports.page import PageVerdict, Picture, Section, Table, render_page

__all__ = ["render_study"]

#: Lines that name files: they are no results.
_FILES = ("figure:", "numbers:", "page:", "policies:", "report:")


def render_study(study: str, what: str, record: Record, *, command: str, footer: str) -> str:
    """The page as HTML text.

    Parameters
    ----------
    study
        Its name.
    what
        What it shows, in some words.
    record
        What it has shown.
    """
    said = [line for line in record.lines if not line.startswith(_FILES)]
    sentence = said[0] if said else what
    tables = tuple(
        Table(heading=_one_line(heading), rows=rows, texts=texts)
        for _, heading, rows, texts in record.tables
        if any(heading) and rows
    )
    titles = ". ".join(_raised(title) for title, *_ in record.tables if title)
    pictures = tuple(
        Picture(png=png, caption=caption or f"{_raised(name.replace('_', ' '))}.")
        for name, png, caption in record.figures
    )
    sections = [
        Section(name="figures", title="Result", sees=f"{_raised(what)}.", pictures=pictures, command=command)
    ]
    if tables or said[1:]:
        notes = tuple(_sentence(line) for line in said[1:])
        sees = f"{_raised(titles)}." if titles else "All that was computed."
        sections.append(Section(name="numbers", title="Numbers", sees=sees, tables=tables, notes=notes))
    return render_page(
        sections,
        title=f"Study: {study.replace('_', ' ')}",
        intro=f"This page is one run of a study: {what}.",
        footer=footer,
        verdict=PageVerdict(light="neutral", sentence=_sentence(sentence)),
    )


def _one_line(heading: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(" ".join(name.split()) for name in heading)


def _raised(text: str) -> str:
    if "_" in text.split(" ")[0]:
        return text  # a name from the code
    return text[:1].upper() + text[1:]


def _sentence(text: str) -> str:
    text = _raised(text.strip())
    return text if text.endswith((".", "!", "?")) else f"{text}."
