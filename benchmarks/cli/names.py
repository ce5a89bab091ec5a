"""`fbl-gym list`."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping

import controllers
from benchmarks.paper import claims
from benchmarks.run.suite import SUITES
from fbl_gym import scenarios
from fbl_gym.scenarios import SEVERITIES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what", nargs="?", choices=tuple(LISTS),
        help="what to list (all of these); a terminal gets a line each, a file or a pipe the whole text",
    )  # fmt: skip


def _policies() -> dict[str, str]:
    return {
        name: f"{controllers.summary(name)}  [{controllers.kind(name)}, told: {controllers.access(name)}]"
        for name in controllers.names()
    }


def _scenarios() -> dict[str, str]:
    """Each scenario, and each family once for all its severities."""
    found, last = {}, SEVERITIES[-1]
    for name in scenarios.names():
        family, _, severity = name.rpartition("-")
        whole = f"{family}-{last}" in scenarios.names()
        if not whole or severity == "0":
            found[f"{name} to -{last}" if whole else name] = scenarios.get(name).description
    return found


LISTS: dict[str, Callable[[], Mapping[str, str]]] = {
    "policies": _policies,
    "scenarios": _scenarios,
    "suites": lambda: SUITES,
    "claims": claims.listed,
}


def run(arguments: argparse.Namespace) -> int:
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for what in (arguments.what,) if arguments.what else LISTS:
        found = LISTS[what]()
        wide = max(map(len, found)) + 2
        if arguments.what is None:
            print(f"{what}:")
        for name, text in found.items():
            line = f"{name:<{wide}}{text}"
            print(line if width is None or len(line) <= width else line[: width - 1] + "…")
    return 0
