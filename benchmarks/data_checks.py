"""What the quality checks of the data notice: ``python benchmarks/data_checks.py``.

Damages every channel of simulated drives of 30 s with bends and braking in every way of
`estimators.logs.corruptions`, and counts how often the damaged channel is named; then counts refusals of
drives in which nothing is wrong but the model: with every fault of the library at its largest plausible size,
and with sensors that are mounted otherwise than stated. The bounds of the checks were set on the drives of
the default seeds; ``--first`` draws others.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS, ONE_SIDED
from estimators.discrepancy.physical_ranges import NEVER_NEGATIVE
from estimators.logs import quality, read_log
from estimators.logs.corruptions import CORRUPTIONS, corrupted, corruptible
from estimators.logs.immobile_findings import hardly_driven
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.simulation.drive import Faults
from offroad_env.world.vehicles import VEHICLES

#: Length of a drive [s].
DURATION = 30.0
#: First seeds of the drives that are damaged, and of those with a fault.
DAMAGED, HIDDEN = 35, 100
#: Faults of a mounting, each in both directions.
MOUNTINGS = ("antenna_x", "imu_misalignment_pitch", "imu_misalignment_roll", "lever_arm_x", "lever_arm_z")
#: Effects that cannot be negative.
POSITIVE = (*ONE_SIDED, *NEVER_NEGATIVE, "aero_drag")


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


def yawed(angle: float) -> Faults:
    """An IMU that is turned to the left, which the library does not know."""

    def sample(sample: np.ndarray) -> None:
        a_x, a_y = sample[0], sample[1]
        sample[0] = np.cos(angle) * a_x + np.sin(angle) * a_y
        sample[1] = np.cos(angle) * a_y - np.sin(angle) * a_x

    return Faults(sample=sample)


def report_refusals(what: str, drives: Iterable[tuple[str, Callable[[], Log]]]) -> None:
    """Count sound drives, those refused, and those that are no drive; print what is said of the last two."""
    count, refused, stuck = 0, 0, 0
    for name, make in drives:
        try:
            log = make()
        except OffroadError:
            continue  # the vehicle sinks in
        found = quality(log)
        idle = [one for one in found.findings if hardly_driven(one)]
        count, refused, stuck = count + 1, refused + bool(found.problems), stuck + bool(idle)
        for finding in [*found.problems, *idle]:
            print(f"{name}: {finding.sentence}")
    print(f"{what}: {count}; refused: {refused}; stuck before there is a drive to diagnose: {stuck}")


def with_faults(first: int, *, both: bool) -> Iterator[tuple[str, Callable[[], Log]]]:
    """A drive with each fault at its largest plausible size, its sign drawn where ``both`` are asked for."""
    for k, name in enumerate(FAULTS):
        effect = EFFECTS[name]
        size = effect.plausible(VEHICLES["mrzr"])
        if both and name not in POSITIVE:
            size *= float(np.random.default_rng([first + k, 3]).choice((-1.0, 1.0)))
        size = min(max(size, effect.size.low), effect.size.high)  # a shear modulus of zero is no soil
        yield name, _drive(first + k, FAULTS[name], size)


def with_mountings(first: int) -> Iterator[tuple[str, Callable[[], Log]]]:
    """A drive with a receiver and each mounting, in both directions."""
    makers: Mapping[str, Callable[[float], Faults]] = {name: FAULTS[name] for name in MOUNTINGS}
    sizes = {name: EFFECTS[name].plausible(VEHICLES["mrzr"]) for name in MOUNTINGS}
    for name, make in {**makers, "IMU turned to the left": yawed}.items():
        for sign in (-1.0, 1.0):
            yield name, _drive(first, make, sign * sizes.get(name, 0.1), gnss=True)


def _drive(
    seed: int, make: Callable[[float], Faults], size: float, *, gnss: bool | None = None
) -> Callable[[], Log]:
    return lambda: simulated_log(draw_case(seed, duration=DURATION, gnss=gnss), make(size))


def main() -> None:
    """Print all counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=4, help="drives that are damaged")
    parser.add_argument("--rounds", type=int, default=3, help="drives with each fault")
    parser.add_argument("--mountings", type=int, default=10, help="drives with each mounting and direction")
    parser.add_argument("--first", type=int, help="seed of the first drive: a fresh sample, with drawn signs")
    parser.add_argument("--recorded", type=Path, nargs="*", default=[], help="sound drives in files")
    asked = parser.parse_args()
    fresh = asked.first is not None
    total, often = 0, Counter[str]()
    first = asked.first if fresh else DAMAGED
    for seed in range(first, first + asked.drives):
        count, missed = damage(seed)
        total += count
        often.update(missed)
        print(f"drive {seed}: {count - len(missed)} of {count} named; not: {', '.join(missed)}")
    print(f"named: {total - often.total()} of {total}")
    first = asked.first if fresh else HIDDEN
    rounds = (with_faults(first + HIDDEN * one, both=fresh) for one in range(asked.rounds))
    report_refusals("drives with a fault", chain.from_iterable(rounds))
    mounted = (with_mountings(first + k) for k in range(asked.mountings))
    report_refusals("drives with another mounting", chain.from_iterable(mounted))
    if asked.recorded:
        report_refusals("recorded drives", [(file.name, partial(read_log, file)) for file in asked.recorded])


if __name__ == "__main__":
    main()
