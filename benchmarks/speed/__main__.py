"""`python -m benchmarks.speed`: steps per second of environments, and times of decisions."""

import argparse
import json
import sys
from pathlib import Path

from benchmarks.files import write_text
from benchmarks.policies.spec import resolve
from benchmarks.run.store import provenance
from benchmarks.run.suite import load
from benchmarks.speed.decisions import measure_decisions
from benchmarks.speed.environments import compare, measure_environments, measure_gpu
from fbl_gym.kernel.step.pool import cores
from fbl_gym.reading import read_text

LEGEND = """
x peer: to Acrobot-v1 through gym.make for a single environment, to SyncVectorEnv of 256 for a batch.
busy: stick-slip friction, noise on every sensor and a disturbance. One step is ten Runge-Kutta steps of 1 ms."""


def main() -> None:
    """Measure, print and write the speed of the environments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="number of rounds (7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the measurements as JSON")
    parser.add_argument("--baseline", type=Path, metavar="FILE", help="compare the ratios with those of such a file")
    parser.add_argument(
        "--decisions", nargs="*", metavar="POLICY",
        help="instead, measure a decision by these policies, or by all that the board ranks: of one arm, and of 32 at 1 kHz",
    )  # fmt: skip
    parser.add_argument("--device", choices=["cuda"], help="instead, measure batches on an NVIDIA GPU, with torch")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"argument --rounds: must be at least 1, got {arguments.rounds}")
    if arguments.device is not None:
        try:
            for name, lanes, rate in measure_gpu(arguments.rounds):
                print(f"{name:<20} {lanes:>9,} lanes {rate / 1e6:>8,.0f} million steps/s", flush=True)
        except (ImportError, RuntimeError) as problem:
            parser.exit(1, f"{problem}\n")
        return
    if arguments.decisions is not None:
        ranked = [name for name in map(str, load("servo").policy_names) if resolve(name).ranked]
        print(f"{'decision, median microseconds':<42} {'one arm':>8} {'32 arms':>8}")
        for name, one, batch in measure_decisions(arguments.decisions or ranked):
            print(f"{name:<42} {one:>8.0f} {batch:>8.0f}")
        return
    rows = measure_environments(arguments.rounds)
    print(f"{'environment steps per second':<42} {'median':>12} {'x peer':>8}")
    for row in rows:
        ratio = f"{row['ratio']:.3g}" if row["peer"] else ""
        print(f"{row['name']:<42} {row['median']:>12,.0f} {ratio:>8}")
    print(f"{LEGEND}\nThis process may use {cores()} cores; rows without a number of threads have one.")
    if arguments.baseline is not None:
        stored = json.loads(read_text(arguments.baseline))["contestants"]
        for name, change in compare(rows, stored).items():
            print(f"{name:<42} {change:.2f} times its ratio in {arguments.baseline}")
    if arguments.json is not None:
        document = {"contestants": rows, **provenance(f"python -m benchmarks.speed {' '.join(sys.argv[1:])}")}
        write_text(arguments.json, json.dumps(document, indent=1) + "\n")
        print(f"written: {arguments.json}")


if __name__ == "__main__":
    main()
