"""Ten million random steps over all structures, vehicles and soils: ``make soak``. Goes on where it stopped.

Rounds of 10,000 commands, each with a seed of its own, are kept in ``benchmarks/results/soak.jsonl`` with
how their drives ended. A round fails where a number is not finite, or a run ends without a status; its seed
names it.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "simulation")]

from test_plants_soak import FEW_KINDS, KINDS, soak  # noqa: E402 - found by the line above

ROUND = 10_000
RESULTS = Path(__file__).parent / "results" / "soak.jsonl"


def done_rounds(path: Path) -> list[dict[str, object]]:
    """Rounds of earlier runs; a line that was cut off is none."""
    rounds = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            rounds.append(json.loads(line))
        except ValueError:
            continue
    return rounds


def main() -> int:
    """Drive what is missing; 1 where a round failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--few", action="store_true", help="four kinds of plants instead of twelve")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    kinds = FEW_KINDS if options.few else KINDS
    rounds = done_rounds(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("a", encoding="utf-8") as file:
        for seed in range(len(rounds), -(-options.steps // ROUND)):
            start, wrong = time.perf_counter(), ""
            try:
                endings: Counter[str] = soak(ROUND, seed=1000 + seed, kinds=kinds)
            except AssertionError as error:
                endings, wrong = Counter(), str(error)[:2000]
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            found = {
                "seed": 1000 + seed,
                "kinds": len(kinds),
                "steps": ROUND,
                "seconds": round(time.perf_counter() - start, 1),
                "memory [MB]": round(memory),
                "endings": dict(sorted(endings.items())),
                "wrong": wrong,
            }
            file.write(f"{json.dumps(found)}\n")
            file.flush()
            rounds.append(found)
    failed = [str(entry["wrong"]) for entry in rounds if entry["wrong"]]
    total: Counter[str] = Counter()
    for entry in rounds:
        total.update(entry["endings"])  # type: ignore[call-overload]
    print(f"{len(rounds) * ROUND} steps, {len(failed)} rounds failed; drives: {dict(sorted(total.items()))}")
    print("\n".join(failed))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
