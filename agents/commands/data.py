"""``offroad data``: which measured data there are, how to get them, and how to make logs of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from agents.reports.output import say, write_json

if TYPE_CHECKING:
    from estimators.logs import Log

__all__ = ["Data", "Get", "List", "LogOf"]


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
        from offroad_env.world.datasets import DATASETS, describe, fetch

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
        from offroad_env.errors import DataError
        from offroad_env.world.datasets import DATASETS, UNPUBLISHED, locate

        found: dict[str, Path | None] = {}
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
        own = os.environ.get("OFFROAD_DATA")
        for name, title in UNPUBLISHED.items():
            place = None if own is None else Path(own) / name
            where = place if place is not None and place.is_dir() else "not on this machine (OFFROAD_DATA)"
            say(f"{name}: {title}\n  published by nobody; logs as they are\n  file     {where}")
        if self.json is not None:
            content = {name: {"file": found[name], "dataset": dataset} for name, dataset in DATASETS.items()}
            write_json(self.json, content)


@dataclass(kw_only=True)
class LogOf:
    """Write a measured data set in the log format of this project: data and description side by side.

    The files are looked for where `offroad data get` puts them, and in OFFROAD_DATA. The drives of the 1:10
    car
    are written as published, with the mistakes that offroad log check finds, or with --corrected put right.
    """

    name: Positional[Literal["cmu_single_wheel", "f1tenth_indoor"]]  #: which data set
    path: Positional[Path | None] = None  #: a published file, or a drive: DS1, DS2, DS3; default: all
    corrected: bool = False  #: f1tenth_indoor: with the units and the mounting that the data show
    out: Path = Path("out")  #: folder for the log

    def run(self) -> None:
        """Read, write, say where."""
        from estimators.logs import write_log

        for log in self._read():
            self.out.mkdir(parents=True, exist_ok=True)
            say(f"log: {write_log(self.out / f'{log.name}.csv', log)}")

    def _read(self) -> list[Log]:
        from estimators.logs import f1tenth_log
        from estimators.rig.cmu_soil_bin import cmu_rig_log
        from offroad_env.world.datasets import DATASETS, locate

        if self.name == "cmu_single_wheel":
            return [cmu_rig_log(locate(self.name) if self.path is None else self.path)]
        drives = DATASETS[self.name].drives
        if self.path is not None and (self.path.is_file() or self.path.name not in drives):
            return [f1tenth_log(self.path, corrected=self.corrected)]
        folder = locate(self.name).parent
        wanted = drives if self.path is None else (self.path.name,)
        return [f1tenth_log(folder / f"{drive}.csv", corrected=self.corrected) for drive in wanted]


#: What tyro parses for ``offroad data``.
Data = (
    Annotated[Get, tyro.conf.subcommand("get", prefix_name=False)]
    | Annotated[List, tyro.conf.subcommand("list", prefix_name=False)]
    | Annotated[LogOf, tyro.conf.subcommand("log", prefix_name=False)]
)
