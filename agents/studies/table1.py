"""``offroad reproduce table1``: the eight rows of the paper's table."""

from __future__ import annotations

from dataclasses import dataclass

from agents.commands.output import Results

__all__ = ["Table1"]


@dataclass(kw_only=True)
class Table1(Results):
    """The eight rows of the paper's table."""

    quick: bool = False  #: few seeds and short runs

    def run(self) -> None:
        """Run the rows."""
