"""The command `fbl-gym check-policy`."""

import argparse
from typing import Any

from benchmarks.cli.common import add_policy, add_trust, trust
from benchmarks.policies.spec import PolicySpec, resolve_isolated
from benchmarks.run.contract import check
from benchmarks.text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policy(parser)
    add_trust(parser)


def run(arguments: argparse.Namespace) -> int:
    trust(arguments)
    broken: dict[str, list[str]] = {}
    policy = resolve_isolated(arguments.policy)
    for promise, kept, detail in policy.call(_check, policy):
        if kept:
            say(f"ok      {promise}: {detail}")
        else:
            broken.setdefault(detail, []).append(promise)
    # One mistake often breaks several promises.
    for detail, promises in broken.items():
        if len(promises) == 1:
            say(f"BROKEN  {promises[0]}: {detail}")
        else:
            say("\n        ".join([f"BROKEN  {len(promises)} promises: {detail}", *promises]))
    count = sum(map(len, broken.values()))
    print(f"breaks {count} promises" if count else "keeps every promise of a policy")
    return 1 if count else 0


def _check(policy: PolicySpec) -> list[tuple[Any, ...]]:
    return [*map(tuple, check(policy))]
