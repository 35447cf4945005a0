"""What the quality checks of the data notice: ``python benchmarks/data_checks.py``.

Damages every channel of simulated drives of 30 s with bends and braking in every way of
`estimators.logs.corruptions`, and counts how often the damaged channel is named; then counts refusals of
drives in which nothing is wrong but the model: with every fault of the library at its largest plausible size.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.logs import quality
from estimators.logs.corruptions import CORRUPTIONS, corrupted, corruptible
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.world.vehicles import VEHICLES

#: Length of a drive [s].
DURATION = 30.0
#: First seeds of the drives that are damaged, and of those with a fault.
DAMAGED, HIDDEN = 35, 100


def named(log: Log, channel: str) -> bool:
    """Whether a problem of the data names the channel."""
    words = [re.findall(r"\w+", finding.sentence) for finding in quality(log).problems]
    return any(channel in one[:12] for one in words)


def damage(seed: int) -> tuple[int, list[str]]:
    """Number of damages to a drive with a receiver, and those whose channel is not named."""
    log = simulated_log(draw_case(seed, gnss=True, duration=DURATION))
    cases = [(channel, kind) for channel in corruptible(log) for kind in CORRUPTIONS]
    missed = [f"{name} {kind}" for name, kind in cases if not named(corrupted(log, name, kind), name)]
    return len(cases), missed


def refusals(first: int) -> tuple[int, list[str]]:
    """Number of drives with a fault, and the sentences of those that are refused."""
    count, refused = 0, []
    for k, name in enumerate(FAULTS):
        size = EFFECTS[name].plausible(VEHICLES["mrzr"])
        try:
            log = simulated_log(draw_case(first + k, duration=DURATION), FAULTS[name](size))
        except OffroadError:
            continue  # the vehicle sinks in
        count += 1
        refused += [f"{name}: {finding.sentence}" for finding in quality(log).problems]
    return count, refused


def main() -> None:
    """Print both counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=4, help="drives that are damaged")
    parser.add_argument("--rounds", type=int, default=3, help="drives with each fault")
    asked = parser.parse_args()
    total, often = 0, Counter[str]()
    for seed in range(DAMAGED, DAMAGED + asked.drives):
        count, missed = damage(seed)
        total += count
        often.update(missed)
        print(f"drive {seed}: {count - len(missed)} of {count} named; not: {', '.join(missed)}")
    print(f"named: {total - often.total()} of {total}")
    logs = 0
    for one in range(asked.rounds):
        count, refused = refusals(HIDDEN * (one + 1))
        logs += count
        print(*refused, sep="\n")
    print(f"drives with a fault: {logs}")


if __name__ == "__main__":
    main()
