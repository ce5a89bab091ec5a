"""`fbl-gym check-policy`."""

from __future__ import annotations

import argparse

from benchmarks import joining
from benchmarks.contract import check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "policy", metavar="POLICY", help="a name, module:factory, file.py, file.py:factory, or model.zip"
    )
    parser.add_argument(
        "--trust", action="store_true", help="load an archive of stable-baselines3, which runs its code"
    )


def run(arguments: argparse.Namespace) -> int:
    if arguments.trust:
        joining.trust(arguments.policy)
    joining.check(arguments.policy)
    broken = 0
    for found in check(arguments.policy):
        broken += not found.kept
        print(f"{'ok    ' if found.kept else 'BROKEN'}  {found.promise}: {found.detail}", flush=True)
    print("keeps what policies promise" if not broken else f"breaks {broken} of its promises")
    return 1 if broken else 0
