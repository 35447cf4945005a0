"""How often another structure is named: ``python benchmarks/structure_rates.py LOG... --out FILE``.

Compares the structures on each log as `offroad diagnose` does, with errors on windows to which nothing was
fitted. Results are kept by log in FILE, one JSON line each, so that a stopped run goes on. ``--sound N`` adds
N drives of this project's own model, each with a fault of the library at its largest plausible size: there no
structure may be named. ``--verdicts`` makes the whole diagnosis of each log (a minute or two) and counts the
effects that it names besides: here none is there to be named.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.structure_comparison import StructureComparison, compare_structures
from estimators.discrepancy.summarise import summarise
from estimators.logs import read_log
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.world.vehicles import VEHICLES

#: First seed and length of the drives of this project's own model [-, s].
SEED, DURATION = 100, 30.0
#: n counts as found within this of the stated one.
NEAR = 0.06


def result(log: Log, whole: bool) -> dict[str, Any]:
    """What the comparison, or the whole diagnosis, finds in a log."""
    if not whole:
        return _compared(log, compare_structures([log]))
    found = diagnose([log])
    summary = summarise(found)
    named = [one.effects for one in summary.causes if one.named and not one.structural]
    return _compared(log, found.structure) | {"verdict": str(summary.verdict), "effects": named}


def _compared(log: Log, found: StructureComparison | None) -> dict[str, Any]:
    """The comparison as a line of the file."""
    if found is None:
        return {"compared": False}
    gains = {gain.channel: 1.0 - gain.extended / gain.nominal for gain in found.gains}
    return {"compared": True, "stated": log.config.soil.n, "gains": gains, **found.to_dict()}


def sound(count: int) -> dict[str, Log]:
    """Drives of this project's own model by name, each with a fault; those that sink in are left out."""
    found: dict[str, Log] = {}
    for k, name in enumerate(FAULTS):
        if len(found) == count:
            break
        try:
            size = EFFECTS[name].plausible(VEHICLES["mrzr"])
            found[f"sound {name}"] = simulated_log(draw_case(SEED + k, duration=DURATION), FAULTS[name](size))
        except OffroadError:
            continue
    return found


def main() -> None:
    """Compare, keep, and print the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sound", type=int, default=0)
    parser.add_argument("--verdicts", action="store_true")
    asked = parser.parse_args()
    lines = asked.out.read_text().splitlines() if asked.out.exists() else []
    known = {row["log"]: row for row in map(json.loads, lines)}
    jobs: dict[str, Path | Log] = {path.stem: path for path in asked.logs}
    if sum(name.startswith("sound") for name in known) < asked.sound:
        jobs |= sound(asked.sound)
    for name, job in jobs.items():
        if name in known:
            continue
        row = {"log": name} | result(read_log(job) if isinstance(job, Path) else job, asked.verdicts)
        known[name] = row
        with asked.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
    report([*known.values()])
    verdicts = [row for row in known.values() if "verdict" in row and not row["log"].startswith("sound")]
    if verdicts:
        print(f"verdicts: {dict(Counter(row['verdict'] for row in verdicts))}")
        certain = sum(any(len(one) == 1 for one in row["effects"]) for row in verdicts)
        print(f"an effect named for certain: {certain} of {len(verdicts)}")


def report(rows: list[dict[str, Any]]) -> None:
    """Print the rates over the logs so far."""
    own = [row for row in rows if row["log"].startswith("sound")]
    other = [row for row in rows if row not in own]
    if other:
        named = [row for row in other if row.get("found")]
        near = sum(abs(row["n"] - row["stated"]) <= NEAR for row in named)
        print(f"structure named: {len(named)} of {len(other)}; n within {NEAR}: {near} of {len(other)}")
        for cause in sorted({one["id"] for row in named for one in row["causes"]}):
            count = sum(cause in [one["id"] for one in row["causes"]] for row in named)
            print(f"  {cause}: {count}")
        for channel in ("v_x", "yaw_rate", "omega_f", "omega_r"):
            gains = [row["gains"][channel] for row in named if channel in row["gains"]]
            print(f"  {channel}: {100.0 * np.median(gains):.0f} % less error (median)")
    if own:
        print(f"named on drives of this model: {sum(row.get('found', False) for row in own)} of {len(own)}")


if __name__ == "__main__":
    main()
