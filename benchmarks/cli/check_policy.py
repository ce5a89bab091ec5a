"""`fbl-gym check-policy`."""

from __future__ import annotations

import argparse

from benchmarks.policies import resolve
from benchmarks.policies.contract import check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "policy", metavar="POLICY", help="a name, module:factory, file.py, file.py:factory, or model.zip"
    )
    parser.add_argument(
        "--trust", action="store_true", help="load an archive of stable-baselines3, which runs its code"
    )


def run(arguments: argparse.Namespace) -> int:
    if arguments.trust:
        resolve.trust(arguments.policy)
    resolve.check(arguments.policy)
    broken: dict[str, list[str]] = {}
    for found in check(arguments.policy):
        if found.kept:
            print(f"ok      {found.promise}: {found.detail}", flush=True)
        else:
            broken.setdefault(found.detail, []).append(found.promise)
    # One mistake often breaks many promises.
    for detail, promises in broken.items():
        if len(promises) == 1:
            print(f"BROKEN  {promises[0]}: {detail}")
        else:
            print(f"BROKEN  {len(promises)} promises: {detail}", *promises, sep="\n        ")
    count = sum(map(len, broken.values()))
    print(f"breaks {count} of its promises" if count else "keeps what policies promise")
    return 1 if count else 0
