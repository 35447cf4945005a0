"""Drives on flexible tyres, described as if on rigid rims: ``python benchmarks/tyre_drives.py``.

Simulates drives in the natural world (an unknown road, soil that scatters, numbers within their tolerances)
on tyres of 80 to 200 kPa, with the laws of a grid or of a field; counts how often the comparison of
structures names the tyres, with which n and which pressure. ``--rigid`` leaves the tyres out: how often they
are named where there are none. Bounds were set on seeds 1 to 10.
"""

from __future__ import annotations

import argparse

import numpy as np

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.structure_comparison import StructureComparison, compare_structures
from offroad_env.errors import OffroadError
from offroad_env.simulation.drive import Faults
from offroad_env.world.structures import read_structure

#: Length of a drive [s], and pressures [Pa].
DURATION, PRESSURES = 40.0, (80e3, 200e3)
#: What counts as near: of n, and as a factor of the pressure.
NEAR_N, NEAR_PRESSURE = 0.06, 1.6


def truth(seed: int, *, rigid: bool) -> str:
    """The laws of a drive's wheels, and their tyres."""
    rng = np.random.default_rng([seed, 77])
    pressure, laws = float(rng.uniform(*PRESSURES)), str(rng.choice(["grid", "field"]))
    return laws if rigid else f"{laws},tyre=mrzr,tyre_inflation={pressure:.0f}"


def drive(seed: int, laws: str) -> tuple[float, StructureComparison | None] | None:
    """True n of a drive and what is found in it; None where the vehicle sinks in."""
    case = draw_case(seed, road="unknown", natural=True, duration=DURATION, gnss=True)
    structure = read_structure(laws)
    try:
        log = simulated_log(case, Faults(plant=lambda plant: plant._replace(structure=structure)))
    except OffroadError:
        return None
    return case.n, compare_structures([log])


def main() -> None:
    """Print each drive and all counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--first", type=int, default=1, help="seed of the first drive")
    parser.add_argument("--rigid", action="store_true", help="without tyres")
    asked = parser.parse_args()
    done, seed, counts = 0, asked.first, {"tyres named": 0, "n near": 0, "pressure near": 0}
    while done < asked.drives:
        laws = truth(seed, rigid=asked.rigid)
        result = drive(seed, laws)
        seed += 1
        if result is None:
            continue
        done += 1
        n, found = result
        causes = [cause.id for cause in found.causes] if found is not None and found.found else []
        text = f"drive {seed - 1}, {laws}: {', '.join(causes) or 'nothing'}"
        if found is not None and causes:
            text += (
                f"; {found.best.case.structure}, n {found.n:.2f} (true {n:.2f}), misfit {found.misfit:.1f}"
            )
            counts["n near"] += abs(found.n - n) < NEAR_N
            tyre, true = (read_structure(one).tyre for one in (found.best.case.structure, laws))
            counts["tyres named"] += "flexible_tyre" in causes
            if tyre is not None and true is not None:
                ratio = tyre.inflation / true.inflation
                counts["pressure near"] += 1.0 / NEAR_PRESSURE < ratio < NEAR_PRESSURE
        print(text, flush=True)
    print(", ".join(f"{what}: {count}" for what, count in counts.items()), f"of {done}")


if __name__ == "__main__":
    main()
