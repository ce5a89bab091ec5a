"""The command `fbl-gym check-policy`."""

import argparse
from typing import Any

from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.contract import check
from benchmarks.text import say


def run(arguments: argparse.Namespace) -> int:
    policy, broken = resolve(arguments.policy), 0
    for promise, kept, detail, _ in policy.call(_check, policy, arguments.scenario):
        say(f"{'ok    ' if kept else 'BROKEN'}  {promise}: {detail}")
        broken += not kept
    print(f"breaks {broken} promises" if broken else "keeps every promise of a policy")
    return int(broken > 0)


def _check(policy: PolicySpec, scenario: str) -> list[tuple[Any, ...]]:
    return [*map(tuple, check(policy, scenario))]
