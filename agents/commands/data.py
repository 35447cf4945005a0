"""``offroad data``: which measured data there are, and how to get them from their publisher."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from agents.commands.output import say, write_json

__all__ = ["Data", "Get", "List"]


@dataclass(kw_only=True)
class Get:
    """Download a data set into the cache, check it, and show its licence and citation.

    What is in the cache already is not downloaded again. The cache is OFFROAD_CACHE, by default
    the user's cache folder.
    """

    name: Positional[str]  #: a data set, see: offroad data list
    json: Path | None = None  #: also write where it is and what it is to this file

    def run(self) -> None:
        """Fetch and describe."""
        from offroad_env.datasets import DATASETS, describe, fetch

        path = fetch(self.name, progress=True)
        say(describe(self.name))
        say(f"\nfile: {path}")
        if self.json is not None:
            write_json(self.json, {"file": path, "dataset": DATASETS[self.name]})


@dataclass(kw_only=True)
class List:
    """Show the known data sets, their licences, and whether they are on this machine."""

    json: Path | None = None  #: also write the list to this file

    def run(self) -> None:
        """Print every entry of the registry."""
        from offroad_env.datasets import DATASETS, locate
        from offroad_env.errors import DataError

        found = {}
        for name, dataset in DATASETS.items():
            try:
                found[name] = locate(name)
            except DataError:
                found[name] = None  # not an error of a list
            where = found[name] or f"not on this machine - get it with: offroad data get {name}"
            for line in (
                f"{name}: {dataset.title}",
                f"  licence  {dataset.licence}",
                f"  cite     {dataset.citation}",
                f"  from     {dataset.url} ({dataset.size / 1000:.0f} kB)",
                f"  file     {where}",
            ):
                say(line)
        if self.json is not None:
            content = {name: {"file": found[name], "dataset": dataset} for name, dataset in DATASETS.items()}
            write_json(self.json, content)


#: What tyro parses for ``offroad data``.
Data = (
    Annotated[Get, tyro.conf.subcommand("get", prefix_name=False)]
    | Annotated[List, tyro.conf.subcommand("list", prefix_name=False)]
)
