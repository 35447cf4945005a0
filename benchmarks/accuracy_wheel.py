"""How accurate `wheel_forces` is: its answers against adaptive quadrature and Brent's method.

Random valid inputs, the same drawing and the same independent evaluation as in the tests
(``tests/physics/reference.py``). Prints the distribution of the errors; exit status 1 if one
exceeds the limit of 1e-6.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from physics.reference import CHANNELS, Case, ask_kernel, ask_reference, draw_case, errors

#: Promise of `wheel_forces`: of the load (torque: of load times radius), and relative in sinkage.
LIMIT = 1e-6
QUANTILES = (0.5, 0.9, 0.99, 0.999, 1.0)


def measure(count: int, seed: int) -> tuple[list[Case], np.ndarray]:
    """Inputs and their errors (count, 5), in the order of ``CHANNELS``."""
    rng = np.random.default_rng(seed)
    cases, found = [], np.empty((count, len(CHANNELS)))
    for i in range(count):
        case = draw_case(rng)
        found[i] = errors(case, ask_kernel(case), ask_reference(case))
        cases.append(case)
        if sys.stderr.isatty():
            print(f"\r{i + 1}/{count}", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return cases, found


def summary(cases: list[Case], found: np.ndarray, seed: int) -> dict[str, object]:
    """Everything that the table shows, for a JSON file."""
    worst = cases[int(found.max(axis=1).argmax())]
    return {
        "inputs": len(cases),
        "seed": seed,
        "limit": LIMIT,
        "above_limit": int((found.max(axis=1) > LIMIT).sum()),
        "quantiles": {
            channel: {f"{q:g}": float(np.quantile(found[:, i], q)) for q in QUANTILES}
            for i, channel in enumerate(CHANNELS)
        },
        "worst_input": {
            name: value._asdict() if hasattr(value, "_asdict") else value
            for name, value in worst._asdict().items()
        },
    }


def table(result: dict[str, object]) -> str:
    """The distribution as text."""
    head = "  ".join(f"{'max' if q == 1.0 else f'{100 * q:g} %':>8}" for q in QUANTILES)
    count = result["inputs"]
    lines = [
        f"{count} random inputs, seed {result['seed']}: {count - result['above_limit']} within {LIMIT:g}",
        f"{'error of':10}{head}",
    ]
    for channel, row in result["quantiles"].items():
        lines.append(f"{channel:10}" + "  ".join(f"{value:8.1e}" for value in row.values()))
    return "\n".join(lines)


def main() -> int:
    """Run the study and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="number of random inputs (default 2000)")
    parser.add_argument("--seed", type=int, default=2202, help="seed of the drawing (default 2202)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here")
    options = parser.parse_args()
    cases, found = measure(options.count, options.seed)
    result = summary(cases, found, options.seed)
    print(table(result))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + "\n")
    return 1 if result["above_limit"] else 0


if __name__ == "__main__":
    sys.exit(main())
