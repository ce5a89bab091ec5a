"""`fbl-gym list`."""

from __future__ import annotations

import argparse

import controllers
from benchmarks.suite import SUITES
from fbl_gym import scenarios


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("policies", "scenarios", "suites"))


def run(arguments: argparse.Namespace) -> int:
    if arguments.what == "policies":
        for name in controllers.names():
            print(f"{name:<20} {controllers.summary(name)}  [{controllers.kind(name)}, told: {controllers.tier(name)}]")
    elif arguments.what == "scenarios":
        for name in scenarios.names():
            print(f"{name:<30} {scenarios.get(name).description}")
    else:
        for name, text in SUITES.items():
            print(f"{name:<12} {text}")
    return 0
