"""`fbl-gym reproduce`."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from benchmarks.cli.common import console
from benchmarks.paper.claim import FULL, SHORT
from benchmarks.paper.claims import load, measure_claim, save, select
from benchmarks.report import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=Path, default=Path("results/paper"), metavar="DIR", help="where to write (results/paper)"
    )
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="CLAIM",
        help="only these, by the names of `fbl-gym list claims`; figure-4b means all figure-4b-...; others in DIR stay",
    )  # fmt: skip
    parser.add_argument("--short", action="store_true", help="few seeds and ratios, as the tests run it (two minutes)")


def run(arguments: argparse.Namespace) -> int:
    names = select(arguments.only)
    found = load(arguments.out)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("measuring", total=len(names))
        for name in names:
            progress.update(task, description=name)
            found[name], draw = measure_claim(name, SHORT if arguments.short else FULL)
            for ending in ("png", "svg"):
                draw(arguments.out / f"{name}.{ending}")
            save(arguments.out, found)
            progress.advance(task)
    terminal.claims(console(), [found[name] for name in names])
    print(f"claims and plots: {arguments.out}")
    return 0
