"""``offroad keys``: what descriptions of one's own may hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tyro.conf import Positional

from agents.reports.output import console, say, table

__all__ = ["Keys"]

_Section = Literal["soil", "vehicle", "tyre", "structure", "sensors", "imu", "wheel", "gnss"]
_Task = Literal["scenario", "course", "weights", "randomise", "log"]


@dataclass(kw_only=True)
class Keys:
    """Show the keys of a YAML with unit, range, default and meaning."""

    section: Positional[Literal["all"] | _Section | _Task] = "all"  #: of the YAML
    markdown: bool = False  #: all of them as the page docs/keys.md

    def run(self) -> None:
        """Print the tables."""
        import sys

        from estimators.logs.key_table import LOG_ABOUT, column_rows, log_rows
        from offroad_env.environment.reference import HEADING, SECTIONS, random_rows, reference

        if self.markdown:
            sys.stdout.write(reference())
            return
        for name, schema in SECTIONS.items():
            if self.section in ("all", name):
                say(schema.about)
                console().print(table(name, HEADING, schema.table(), texts=5))
        if self.section in ("all", "randomise"):
            say("soil, vehicle, sensors as a whole; SECTION.KEY of soil, vehicle, imu, wheel, gnss; and:")
            console().print(table("randomise", HEADING, random_rows(), texts=5))
        if self.section in ("all", "log"):
            say(LOG_ABOUT)
            console().print(table("log", HEADING, log_rows(), texts=5))
            console().print(table("columns of a log", HEADING, column_rows(), texts=5))
