"""`fbl-gym reproduce`."""

import argparse

from rich.console import Console
from rich.progress import Progress

from benchmarks.cli.common import add_folder, console
from benchmarks.paper.claim import FULL, SHORT
from benchmarks.paper.claims import load, measure_claim, save, select
from benchmarks.report import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser, "--out", "results/paper", "the results")
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="CLAIM",
        help="measure these claims only; other claims in DIR stay. `fbl-gym list claims` lists the names; figure-4b means "
        "all of figure-4b-...",
    )  # fmt: skip
    parser.add_argument("--short", action="store_true", help="fewer cases, as in the tests (less than seven minutes)")


def run(arguments: argparse.Namespace) -> int:
    """Measure claims, save and print them; return the exit status."""
    names = select(arguments.only)
    claims = load(arguments.out)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("measuring", total=len(names))
        for name in names:
            progress.update(task, description=name)
            claims[name], draw = measure_claim(name, SHORT if arguments.short else FULL)
            for suffix in ("png", "svg"):
                draw(arguments.out / f"{name}.{suffix}")
            save(arguments.out, claims)
            progress.advance(task)
    terminal.claims(console(), [claims[name] for name in names])
    print(f"claims and plots: {arguments.out}")
    return 0
