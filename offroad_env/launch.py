"""The console script ``offroad``: makes sure that ``agents`` is this project's before it is imported.

Other projects install a package of that name too, and files of both then lie in one folder, or the one that
comes first on the path is found. That is noticed here, below ``agents``, which may not be importable.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

__all__ = ["foreign_agents", "main"]

#: First line of this project's `agents/__init__.py`.
_OURS = '"""Controllers, policies, the benchmark and the command line."""'


def foreign_agents() -> str | None:
    """Sentence that names the package ``agents`` of another project, or None where it is this one's."""
    found = importlib.util.find_spec("agents")
    origin = None if found is None else found.origin
    if origin is not None and Path(origin).read_text(encoding="utf-8").startswith(_OURS):
        return None
    place = origin or "a folder without __init__.py"
    there = "there is none" if found is None else f"{place} is another project's"
    return (
        f"OffroadBekker needs its own package `agents`, but {there}: two projects that install a package of "
        "this name (the OpenAI Agents SDK, for one) cannot share an environment. Install OffroadBekker into "
        "an environment of its own, for example by `make install` in its repository."
    )


def main() -> None:
    """Run the command, or say in one sentence why it cannot be found."""
    if (sentence := foreign_agents()) is not None:
        sys.stderr.write(f"{sentence}\n")
        raise SystemExit(1)
    importlib.import_module("agents.commands.cli").main()
