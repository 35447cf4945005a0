"""Does a diagnosis of rig trials ever crash? ``python benchmarks/random_rigs.py --out FILE [--count N]``.

Rigs are drawn at random: one to six slip angles, conditions, repeats and channels that are left out, and a
fault up to three times as large as is believable, or none. A refusal in one sentence is no crash; a section
of a diagnosis that broke down is counted apart. Results are kept in FILE, one line a rig, so that a stopped
run goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.studies.runner import Key, run_units, stamp_of
from estimators.discrepancy.faults.rig import (
    RIG_FAULTS,
    UNMODELLED_RIG_FAULTS,
    RigFault,
    draw_rig_case,
    simulated_trials,
)
from estimators.discrepancy.rig_diagnosis import diagnose_rig
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.wording import terminal_lines
from estimators.logs.log import Log
from estimators.logs.writing import content_hash
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.physics.numerics import GRAVITY
from offroad_env.world.vehicles import VEHICLES

#: First seed.
SEED = 40_000
#: Largest size of a fault in believable ones, and of one that no library holds in shares of the load.
LARGEST, UNMODELLED = 3.0, 0.3
#: Channels that a rig may lack, but for one.
CHANNELS = ("drawbar", "side_force", "torque", "sinkage")


def drawn_rig(seed: int) -> Log:
    """Trials with faults, of which conditions, repeats and channels are missing."""
    rng = np.random.default_rng([seed, 17])
    case = draw_rig_case(seed)
    angles = np.sort(rng.choice(np.linspace(0.0, 1.3, 27), size=int(rng.integers(1, 7)), replace=False))
    case = replace(case, angles=tuple(angles.tolist()))
    log = simulated_trials(case, _fault(rng, case.load, case.r))
    keep = _kept(rng, log.channels["condition"])
    there = rng.choice(CHANNELS, size=int(rng.integers(1, 5)), replace=False)
    settings = [name for name in log.channels if name not in CHANNELS]
    channels = {name: log.channels[name][keep] for name in (*settings, *there)}
    if rng.random() < 0.2:
        # A rig whose settings are written down as they were wanted.
        channels["load"] = np.full(keep.sum(), float(np.mean(channels["load"])))
    log = replace(log, channels=channels)
    return replace(log, hash=content_hash(log))


def _fault(rng: np.random.Generator, load: float, r: float) -> RigFault | None:
    """None, a fault of the library, or one that it lacks; of either sign."""
    kind = rng.random()
    if kind < 0.15:
        return None
    if kind < 0.3:
        return UNMODELLED_RIG_FAULTS[str(rng.choice(list(UNMODELLED_RIG_FAULTS)))](
            UNMODELLED * float(rng.uniform(-1.0, 1.0))
        )
    name = str(rng.choice(list(RIG_FAULTS)))
    vehicle = VEHICLES["mrzr"]._replace(m=4.0 * load / GRAVITY, r=r, b=0.65 * r)
    size = LARGEST * float(rng.uniform(-1.0, 1.0)) * EFFECTS[name].plausible(vehicle)
    parameter = EFFECTS[name].size
    return RIG_FAULTS[name](min(max(size, 0.9 * parameter.low), 0.9 * parameter.high))


def _kept(rng: np.random.Generator, condition: np.ndarray) -> np.ndarray:
    """Trials that were made: a share of the conditions, and of their repeats."""
    numbers = np.unique(condition)
    made = rng.random(len(numbers)) < rng.uniform(0.5, 1.0)
    made[:4] = True
    repeats = rng.random(len(condition)) < rng.choice([0.4, 0.8, 1.0])
    return np.asarray(made[np.searchsorted(numbers, condition)] & repeats)


def diagnosed(_kind: str, seed: int) -> dict[str, Any]:
    """Outcome for one rig."""
    start = time.process_time()
    try:
        log = drawn_rig(seed)
        summary = summarise(diagnose_rig([log]))
        json.dumps(summary.to_dict(), allow_nan=False)
        outcome, failed = str(summary.verdict), dict(summary.failed)
        terminal_lines(summary)
    except OffroadError as error:
        outcome, failed = f"refused: {type(error).__name__}", {"sentence": str(error)}
    except Exception as error:
        outcome, failed = f"crash: {type(error).__name__}", {"sentence": str(error)}
    return {"outcome": outcome, "failed": failed, "seconds": time.process_time() - start}


def main() -> None:
    """Diagnose what is missing, and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--n-jobs", type=int, default=1)
    options = parser.parse_args()
    stamp = stamp_of("estimators.discrepancy.rig_diagnosis", "estimators.discrepancy.faults.rig")
    keys: list[Key] = [("rig", SEED + k) for k in range(options.count)]
    results = run_units(
        options.out, diagnosed, dict.fromkeys(keys, stamp), label="rigs", n_jobs=options.n_jobs
    )
    for outcome, count in Counter(result["outcome"] for result in results.values()).most_common():
        print(f"{count:4d}  {outcome}")
    broken = Counter(part for result in results.values() for part in result["failed"])
    print(f"sections that broke down: {dict(broken) or 'none'}")
    print(f"{sum(result['seconds'] for result in results.values()) / len(results):.1f} s of one core a rig")


if __name__ == "__main__":
    main()
