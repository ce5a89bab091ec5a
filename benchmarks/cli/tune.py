"""The command `fbl-gym tune`."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from benchmarks.cli.common import add_policy, command_line, count
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.tuning.search import JUDGED, SCENARIOS, Task, judge, seeds, ship, summary, tune
from controllers.registry import TUNED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_policy(parser)
    parser.add_argument(
        "--trials", type=count, default=40, metavar="N", help="number of trials, those of earlier runs counted (40)"
    )
    parser.add_argument("--seeds", type=count, default=16, metavar="N", help="tuning seeds of each scenario (16)")
    parser.add_argument(
        "--also", nargs="+", type=_gain, default=(), metavar="GAIN=VALUE", help="gains to try as one of the trials"
    )
    parser.add_argument(
        "--candidates", type=count, default=10, metavar="N", help="number of best trials to judge once more (10)"
    )
    parser.add_argument(
        "--fresh-seeds", type=count, default=128, metavar="N", help="tuning seeds to judge on, of each scenario (128)"
    )
    parser.add_argument(
        "--scenarios", nargs="+", metavar="S",
        help=f"scenarios of trials and judging ({len(SCENARIOS)} of the board's, then {len(JUDGED)})",
    )  # fmt: skip
    parser.add_argument(
        "--storage", type=Path, default=Path("results/tuning"), metavar="DIR",
        help="folder of the studies; several processes may share it, and a stopped study goes on (results/tuning)",
    )  # fmt: skip
    parser.add_argument(
        "--ship",
        action="store_true",
        help=f"write the gains of a built-in policy to {TUNED.parent.name}/{TUNED.name}",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    policy = resolve(arguments.policy)
    if arguments.ship and policy.external:
        raise ValueError(
            f"--ship is for the policies that fbl-gym comes with, got {policy.name!r}: "
            "leave it out, and make the best gains the law's defaults"
        )
    tried, fresh = seeds(arguments.seeds, arguments.fresh_seeds)
    task = Task(policy, tuple(arguments.scenarios or SCENARIOS), tried)
    judging = Task(policy, tuple(arguments.scenarios or JUDGED), fresh)
    study = tune(task, arguments.trials, arguments.storage / f"{_study(policy)}.db", dict(arguments.also))
    best = summary(task, study, judging, judge(judging, study, arguments.candidates), command_line())
    print(json.dumps({key: best[key] for key in ("gains", "judged")}, indent=1))
    if arguments.ship:
        print(f"shipped: {ship(best)}")
    elif best["gains"]:
        gains = " ".join(f"{name}={value:g}" for name, value in best["gains"].items())
        print(
            f"best: {gains}; try them: fbl-gym evaluate {policy.name} --gains {gains}; then make them the law's defaults"
        )
    else:
        print("best: the default gains")
    return 0


def _study(policy: PolicySpec) -> str:
    """Return the name of a study's file. An external law that has changed begins a new study."""
    return re.sub(r"[^\w@.-]+", "_", policy.name) + (f"-{policy.digest[:12]}" if policy.external else "")


def _gain(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be such as kp=25, got {text!r}") from None
