"""`fbl-gym tune`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.commands.common import command_line, count
from benchmarks.tuning import SCENARIOS, Task, ship, summary, tune
from controllers.policy import TUNED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="a name from `fbl-gym list policies`")
    parser.add_argument("--trials", type=count, default=40, metavar="N", help="in all, earlier runs counted (40)")
    parser.add_argument("--seeds", type=count, default=16, metavar="N", help="tuning seeds of each scenario (16)")
    parser.add_argument(
        "--scenarios", nargs="+", default=SCENARIOS, metavar="S", help="what to tune on (nine of the board's)"
    )
    parser.add_argument(
        "--storage", type=Path, default=Path("results/tuning"), metavar="DIR",
        help="of the studies; several processes may share it, and a stopped one goes on (results/tuning)",
    )  # fmt: skip
    parser.add_argument("--ship", action="store_true", help=f"write the gains to {TUNED.parent.name}/{TUNED.name}")


def run(arguments: argparse.Namespace) -> int:
    task = Task(arguments.policy, tuple(arguments.scenarios), arguments.seeds)
    study = tune(task, arguments.trials, arguments.storage / f"{arguments.policy}.db")
    found = summary(task, study, command_line())
    print(
        json.dumps(
            {key: found[key] for key in ("gains", "objective", "objective_of_defaults", "trials", "cpu_s")}, indent=1
        )
    )
    if arguments.ship:
        print(f"shipped: {ship(found)}")
    return 0
