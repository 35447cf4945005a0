"""How often another structure is named: ``python benchmarks/structure_rates.py LOG... --out FILE``.

Compares the structures on each log as `offroad diagnose` does, with errors on windows to which nothing was
fitted. Results are kept by log in FILE, one JSON line each, so that a stopped run goes on. ``--sound N`` adds
N drives of this project's own model, each with a fault of the library at its largest plausible size: there no
structure may be named.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.structure_comparison import compare_structures
from estimators.logs import read_log
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.world.vehicles import VEHICLES

#: First seed and length of the drives of this project's own model [-, s].
SEED, DURATION = 100, 30.0
#: n counts as found within this of the stated one.
NEAR = 0.06


def result(log: Log) -> dict[str, Any]:
    """What the comparison finds in a log."""
    found = compare_structures([log])
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
    asked = parser.parse_args()
    lines = asked.out.read_text().splitlines() if asked.out.exists() else []
    known = {row["log"]: row for row in map(json.loads, lines)}
    jobs: dict[str, Path | Log] = {path.stem: path for path in asked.logs}
    if sum(name.startswith("sound") for name in known) < asked.sound:
        jobs |= sound(asked.sound)
    for name, job in jobs.items():
        if name in known:
            continue
        row = {"log": name} | result(read_log(job) if isinstance(job, Path) else job)
        known[name] = row
        with asked.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
    report([row for row in known.values() if row["compared"]])


def report(rows: list[dict[str, Any]]) -> None:
    """Print the rates over the logs so far."""
    own = [row for row in rows if row["log"].startswith("sound")]
    other = [row for row in rows if row not in own]
    if other:
        named = [row for row in other if row["found"]]
        near = sum(abs(row["n"] - row["stated"]) <= NEAR for row in named)
        print(f"structure named: {len(named)} of {len(other)}; n within {NEAR}: {near} of {len(other)}")
        for cause in sorted({one["id"] for row in named for one in row["causes"]}):
            count = sum(cause in [one["id"] for one in row["causes"]] for row in named)
            print(f"  {cause}: {count}")
        for channel in ("v_x", "yaw_rate", "omega_f", "omega_r"):
            gains = [row["gains"][channel] for row in named if channel in row["gains"]]
            print(f"  {channel}: {100.0 * np.median(gains):.0f} % less error (median)")
    if own:
        print(f"named on drives of this model: {sum(row['found'] for row in own)} of {len(own)}")


if __name__ == "__main__":
    main()
