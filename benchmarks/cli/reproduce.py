"""`fbl-gym reproduce`."""

import argparse

from rich.progress import Progress

from benchmarks.paper.claims import SHORT, load, measure_claim, save, select
from benchmarks.report.terminal import Screen, show
from benchmarks.text import say


def run(arguments: argparse.Namespace) -> int:
    """Measure claims, save and print them; return the exit status."""
    names = select(arguments.only)
    claims = load(arguments.out)
    with Progress(console=Screen(stderr=True)) as progress:
        task = progress.add_task("measuring", total=len(names))
        for name in names:
            progress.update(task, description=name)
            claims[name], draw = measure_claim(name, SHORT if arguments.short else None)
            if draw is not None:
                for suffix in ("png", "svg"):
                    draw(arguments.out / f"{name}.{suffix}")
            save(arguments.out, claims)
            progress.advance(task)
    header = ("figure", "claim", "paper", "measured in the first case", "at stated values", "at favourable open values")
    measured = [claims[name] for name in names]
    rows = [(c["figure"], c["claim"], c["paper"], c["cases"][0][2], c["at_stated"], c["at_best"]) for c in measured]
    show("The paper's claims, measured", header, rows, "left")
    say(f"claims and plots: {arguments.out}")
    return 0
