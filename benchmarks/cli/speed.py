"""`fbl-gym speed`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.cli.common import command_line, console, count
from benchmarks.report import terminal
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.run.store import provenance, write_text
from benchmarks.speed import rates as speed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rounds", type=count, default=7, metavar="N", help="how often each has its turn (7)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write speed.json and growth.png there, policies too (minutes)"
    )
    parser.add_argument(
        "--baseline", type=Path, metavar="FILE", help="compare the ratios with those of this speed.json"
    )


def run(arguments: argparse.Namespace) -> int:
    rows = speed.measure_speed(arguments.rounds)
    screen = console()
    terminal.speed(screen, rows)
    if arguments.baseline is not None:
        stored = json.loads(arguments.baseline.read_text())
        for name, change in speed.against(rows, stored["contestants"]).items():
            screen.print(f"{name:<32} {change:.2f} times its ratio in {arguments.baseline}")
    if arguments.out is not None:
        lanes, substeps = speed.measure_growth()
        policies = speed.measure_policies()
        for name, steps in policies.items():
            screen.print(f"{name:<24} a decision of 4,096 lanes takes {steps:.1f} environment steps")
        loop = speed.measure_loop()
        screen.print(f"robust-flm in closed loop, 4,096 episodes with trace and metrics: {loop:,.0f} steps/s")
        plot_growth(lanes, substeps, arguments.out / "growth.png")
        document = {
            "contestants": speed.as_plain(rows), "ns_by_lanes": lanes, "ns_by_substeps": substeps,
            "steps_per_decision": policies, "closed_loop": loop, **provenance(command_line()),
        }  # fmt: skip
        write_text(arguments.out / "speed.json", json.dumps(document, indent=1) + "\n")
        screen.print(f"written: {arguments.out / 'speed.json'} and growth.png")
    return 0


def plot_growth(lanes: dict[int, float], substeps: dict[int, float], path: Path) -> None:
    """Draw how the time of a step grows with the batch and with the physics steps in it."""

    def panel(found: dict[int, float], title: str, x: str) -> Panel:
        line = Line(np.array(list(found), dtype=float), np.array(list(found.values())), "measured")
        return Panel(title, x, "time of a lane's step [ns]", (line,), ("log", "log"))

    panels = (
        panel(lanes, "ten physics steps of 1 ms", "lanes"),
        panel(substeps, "256 lanes", "physics steps in a control step"),
    )
    plot_lines("What a step of the environment costs, one thread", panels, path)
