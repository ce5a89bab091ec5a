"""`fbl-gym speed`."""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.cli.common import command_line, console, count
from benchmarks.files import write_text
from benchmarks.report import terminal
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.run.store import provenance
from benchmarks.speed.costs import measure_evaluation, measure_growth, measure_policies
from benchmarks.speed.environments import compare, measure_environments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rounds", type=count, default=7, metavar="N", help="number of rounds (7)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="measure policies and batch sizes too; write speed.json and growth.png"
    )
    parser.add_argument("--baseline", type=Path, metavar="FILE", help="compare the ratios with those of a speed.json")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print the speed of the environments; return the exit status."""
    rows = measure_environments(arguments.rounds)
    screen = console()
    terminal.speed(screen, rows)
    if arguments.baseline is not None:
        stored = json.loads(arguments.baseline.read_text())
        for name, change in compare(rows, stored["contestants"]).items():
            screen.print(f"{name:<32} {change:.2f} times its ratio in {arguments.baseline}")
    if arguments.out is not None:
        by_lanes, by_physics_steps = measure_growth()
        policies = measure_policies()
        for name, steps in policies.items():
            screen.print(f"{name:<24} a decision of 4,096 lanes takes {steps:.1f} environment steps")
        evaluation = measure_evaluation()
        screen.print(f"robust-flm, evaluation of 4,096 episodes with trace and metrics: {evaluation:,.0f} steps/s")
        plot_growth(by_lanes, by_physics_steps, arguments.out / "growth.png")
        document = {
            "contestants": list(map(asdict, rows)), "ns_by_lanes": by_lanes, "ns_by_substeps": by_physics_steps,
            "steps_per_decision": policies, "closed_loop": evaluation, **provenance(command_line()),
        }  # fmt: skip
        write_text(arguments.out / "speed.json", json.dumps(document, indent=1) + "\n")
        screen.print(f"written: {arguments.out / 'speed.json'} and growth.png")
    return 0


def plot_growth(by_lanes: dict[int, float], by_physics_steps: dict[int, float], path: Path) -> None:
    """Draw the time of a lane's step [ns] by batch size, and by physics steps per step."""

    def panel(times: dict[int, float], title: str, x: str) -> Panel:
        line = Line(np.array(list(times), dtype=float), np.array(list(times.values())), "measured")
        return Panel(title, x, "time of a lane's step [ns]", (line,), ("log", "log"))

    panels = (
        panel(by_lanes, "ten physics steps of 1 ms", "lanes"),
        panel(by_physics_steps, "256 lanes", "physics steps per step"),
    )
    plot_lines("Time of an environment step, one thread", panels, path)
