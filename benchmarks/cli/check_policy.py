"""The command `fbl-gym check-policy`."""

import argparse

from benchmarks.cli.common import add_policy, add_trust, trust
from benchmarks.policies.spec import resolve
from benchmarks.run.contract import check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policy(parser)
    add_trust(parser)


def run(arguments: argparse.Namespace) -> int:
    trust(arguments)
    broken: dict[str, list[str]] = {}
    for checked in check(resolve(arguments.policy)):
        if checked.kept:
            print(f"ok      {checked.promise}: {checked.detail}", flush=True)
        else:
            broken.setdefault(checked.detail, []).append(checked.promise)
    # One mistake often breaks several promises.
    for detail, promises in broken.items():
        if len(promises) == 1:
            print(f"BROKEN  {promises[0]}: {detail}")
        else:
            print(f"BROKEN  {len(promises)} promises: {detail}", *promises, sep="\n        ")
    count = sum(map(len, broken.values()))
    print(f"breaks {count} promises" if count else "keeps every promise of a policy")
    return 1 if count else 0
