"""Settings of the documentation site: ``make docs``."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from docutils import nodes
from sphinx.ext import autosummary
from sphinx.ext.napoleon.docstring import GoogleDocstring

import offroad_env

project = "OffroadBekker"
author = "The OffroadBekker authors"
copyright = author
version = release = offroad_env.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "sphinx_gallery.gen_gallery",
]
root_doc = "index"
templates_path = ["_templates"]
exclude_patterns = ["_build", "gallery/sg_execution_times.rst", "sg_execution_times.rst", "generated/.*"]
suppress_warnings = ["config.cache"]  # the functions below cannot be pickled

# ---- pages in Markdown
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

# ---- reference from docstrings
autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types, shapes and units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False


def _whole_comment(docstring: Any) -> tuple[str, list[str]]:
    """Napoleon would take what stands before a colon in the comment of a field for its type."""
    return "", docstring._dedent(docstring._consume_to_end())


GoogleDocstring._consume_inline_attribute = _whole_comment  # type: ignore[method-assign]
autosummary.WELL_KNOWN_ABBREVIATIONS += ("r.m.s.",)  # no end of a sentence
# Inventories of other projects need the network: links to them are left as text where it is missing.
intersphinx_mapping: dict[str, Any] = {}


# ---- gallery
def _colours(_: Any, __: str) -> None:
    """Okabe & Ito's colours, which colour-blind readers tell apart."""
    names = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
    mpl.rcParams["axes.prop_cycle"] = cycler(color=names)


#: Examples as a newcomer reads them; one that is not listed follows, and those that are not run come last.
_EXAMPLES = (
    "plot_first_episode", "plot_estimate_while_driving", "plot_wheel_forces", "plot_what_the_soil_holds",
    "plot_own_soil_and_vehicle", "plot_randomise", "plot_natural_soil", "plot_sensors", "plot_structures",
    "plot_four_wheels", "plot_wheel_drawing",
)  # fmt: skip


def _place(file: str) -> tuple[bool, int, str]:
    """Sorts the examples."""
    name = Path(file).stem
    return not name.startswith("plot_"), _EXAMPLES.index(name) if name in _EXAMPLES else 99, name


sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_signature": False,
    "reset_modules": ("matplotlib", _colours),
    "min_reported_time": 5,
    "within_subsection_order": _place,
    "default_thumb_file": str(Path(__file__).parent / "images" / "scenario_track.png"),
    "matplotlib_animations": True,
    "image_srcset": ["2x"],
    "abort_on_example_error": False,
    "only_warn_on_example_error": False,
}

# ---- pages
html_theme = "furo"
html_title = "OffroadBekker"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_show_sourcelink = False
html_use_index = False  # the search and the Python interface find all of it


_ENTRY = re.compile(r"^(\w[\w, ]*) : ")


def _table(rows: list[str]) -> list[str]:
    """A table in Markdown as one in reStructuredText."""
    cells: list[list[str]] = []
    for row in rows:
        *first, last = [cell.strip() for cell in row.strip("|").split("|")]
        if cells and not any(first):  # goes on from the row above
            cells[-1][-1] += f" {last}"
        elif "---" not in row:
            cells.append([*first, last])
    body = [line for row in cells for line in (f"   * - {row[0]}", *(f"     - {cell}" for cell in row[1:]))]
    return ["", ".. list-table::", "   :header-rows: 1", "", *body, ""]


def _from_markdown(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Environments describe themselves in Gymnasium's form, in Markdown."""
    if not any(line.startswith("## ") for line in lines):
        return
    found: list[str] = []
    for is_table, part in groupby(lines, key=lambda line: line.startswith("|")):
        if is_table:
            found += _table(list(part))
            continue
        for line in part:
            if line.startswith("## "):
                found += ["", f".. rubric:: {line[3:].strip()}", ""]
            elif _ENTRY.match(line):
                found += ["", _ENTRY.sub(r"- **\1**: ", line)]
            else:
                found.append(f"  {line.strip()}" if line.startswith("    ") else line)
    lines[:] = found


_NUMBER = re.compile(r"[-+.\d].{0,23}")
#: Cells with more letters are sentences.
_SENTENCE = 40


#: Where a path or a long name may be broken.
_PARTS = re.compile(r"(?<=[/._])(?=\w)")
#: Names of as many letters stay whole.
_SHORT = 22


def _mark_cells(_: Any, document: nodes.document) -> None:
    """What ``site.css`` has to know: cells with a number or sentences, and short names."""
    for literal in document.findall(nodes.literal):
        if all(len(word) <= _SHORT for word in literal.astext().split()):
            literal["classes"].append("short")
    for entry in document.findall(nodes.entry):
        text = entry.astext()
        for literal in list(entry.findall(nodes.literal)):
            _break_after_parts(literal)
        if _NUMBER.fullmatch(text):
            entry["classes"].append("number")
        elif len(text) > _SENTENCE:
            entry["classes"].append("sentence")


def _break_after_parts(literal: nodes.literal) -> None:
    """A name that is wider than its cell is broken between its parts."""
    text = literal.astext()
    if len(text) <= _SHORT or len(literal.children) != 1:
        return
    literal.clear()
    for part in _PARTS.split(text):
        literal += [nodes.Text(part), nodes.raw("", "<wbr>", format="html")]


def _without_factory(
    _: Any, what: str, name: str, obj: Any, options: Any, signature: str, returns: Any
) -> Any:
    """Python writes the default of a mutable field as ``<factory>``."""
    return (signature or "").replace("<factory>", "...") or None, returns


def _link_pictures(_: Any, document: nodes.document) -> None:
    """A picture fills the column, and a click shows it in its full size: Sphinx links scaled pictures."""
    for picture in document.findall(nodes.image):
        alone = isinstance(picture.parent, nodes.paragraph) and len(picture.parent.children) == 1
        if alone and str(picture["uri"]).endswith((".png", ".gif")):
            picture["width"] = "100%"
            picture.parent["classes"].append("figure")


def setup(app: Any) -> None:
    """Sphinx's hook."""
    app.connect("doctree-read", _mark_cells)
    app.connect("doctree-read", _link_pictures)
    app.connect("autodoc-process-signature", _without_factory)
    app.connect("autodoc-process-docstring", _from_markdown, priority=100)
