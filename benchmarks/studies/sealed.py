"""A fresh draw: does the board's order hold on arms and seeds that no one has tuned on?

`python -m benchmarks.studies.sealed` takes the board from the store. Arms, motions and seeds are
drawn from the board's version, a hash of its code, so whoever changes the code chooses the draw:
that is validation. A release is drawn with `--number`, from a later public random number.
"""

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.analysis.board import Board, assemble
from benchmarks.run.cell import Cell
from benchmarks.run.metrics import counted_errors
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Store
from benchmarks.run.suite import load
from benchmarks.seeds import SPLITS
from fbl_gym import ArrayReference, Scenario
from fbl_gym.model.arm import ArmParameters, Array, stretched_inertia
from fbl_gym.scenarios.class_families import conditions, families
from fbl_gym.scenarios.classes import CLASSES

#: The board has severity 2.
SEVERITY = 3


def draw(number: int, robot: str, family: str) -> tuple[Scenario, tuple[int, ...]]:
    """Return the task of a class's family, with another arm and motion, and its 32 seeds.

    The motion is a cubic spline through points of the board's box, without rest. Neither the board
    nor practice has this kind. An arm is drawn again if its springs are too fast for the physics
    step, behind a tiny rotor.
    """
    random = np.random.default_rng((number, *map(ord, family)))
    for _ in range(100):
        options = conditions(draw_arm(random, robot), robot, family, SEVERITY)
        moves = options["reference"]
        interval = random.uniform(0.9, 1.3) * moves.move_time
        points = random.uniform(moves.low, moves.high, (int(options["duration"] / interval) + 2, 2))
        options["reference"] = ArrayReference(position=points.tolist(), dt=interval)
        with contextlib.suppress(ValueError):
            task = Scenario(name=f"sealed-{family}", **options)
            return task, tuple(random.choice(SPLITS["sealed"], 32, replace=False).tolist())
    raise ValueError(f"no arm of the class {robot} can be drawn for {family}")


def draw_arm(rng: np.random.Generator, robot: str) -> ArmParameters:
    """Return an arm of links of 1 to 30 kg and 0.2 to 1 m, between rods and point masses.

    Each rotor has at most the share of the links' inertia that it has in the arm of a class.
    """
    mass, length = np.exp(rng.uniform(np.log(1.0), np.log(30.0), 2)), rng.uniform(0.2, 1.0, 2)
    point = rng.uniform(0.0, 1.0, 2)
    shape = {"centre": tuple(0.5 + 0.5 * point), "inertia": tuple((1.0 - point) / 12.0)}
    links = ArmParameters(mass[0], mass[1], length[0], length[1], **shape)  # type: ignore[arg-type]
    usual = CLASSES[robot].arm
    rotor = rng.uniform(0.0, 1.0, 2) * usual.rotor * stretched_inertia(links) / stretched_inertia(usual)
    return dataclasses.replace(links, rotor=tuple(rotor))


def tau(board: Board, rows: Sequence[int], names: Sequence[str], logs: Array) -> dict[str, float]:
    """Return Kendall's tau between the rows' errors on the board and in the sealed test.

    Args:
        board: with the families.
        rows: indices of the board's policies that are compared, the best first.
        names: of the families.
        logs: mean logarithms of their errors in the sealed test [rows x families].
    """
    errors, sealed, members = board.error().value[rows], logs.mean(axis=1), board.families
    pairs = {"all": (errors, sealed), "first ten": (errors[:10], sealed[:10])}
    pairs |= {x: (board.error(members[x]).value[rows], logs[:, k]) for k, x in enumerate(names) if x in members}
    return {name: float(stats.kendalltau(*pair).statistic) for name, pair in pairs.items()}


def whole(text: str) -> int:
    """Return a whole number, perhaps with hexadecimal digits after 0x."""
    with contextlib.suppress(ValueError):
        if (number := int(text, 0)) >= 0:
            return number
    raise argparse.ArgumentTypeError(f"must be a whole number, 0 or more, got {text!r}")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the sealed test of the board in the store, and print it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies.sealed", description=__doc__)
    parser.add_argument("--suite", default="servo", choices=tuple(CLASSES), help="class of robots (servo)")
    parser.add_argument("--policies", nargs="+", default=(), metavar="P", help="only these (the suite's)")
    parser.add_argument("--seeds", type=int, metavar="N", help="test seeds of the board (the suite's)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    parser.add_argument("--number", type=whole, metavar="N", help="whole number to draw from (the board's version)")
    arguments = parser.parse_args(argv)
    store = Store(arguments.store)
    cells = load(arguments.suite).build(arguments.policies, (), arguments.seeds).cells
    try:
        board = assemble([result for cell in cells if (result := store.find(cell))], cells)
    except ValueError as problem:
        parser.exit(1, f"{problem}; fbl-gym leaderboard computes the board\n")
    names = tuple(families(arguments.suite))
    number = int(board.version, 16) if arguments.number is None else arguments.number
    tasks = [draw(number, arguments.suite, family) for family in names]
    first = {board.policies[i]: board.specs[i] for i in board.order if i in board.ranked}
    if not first:
        parser.exit(1, "--policies must have one that is ranked and has results\n")
    sealed = {(name, task.name): Cell(spec, task, seeds) for name, spec in first.items() for task, seeds in tasks}
    results = {result.cell.id: result for _, result in run_cells([*sealed.values()], store, workers=arguments.workers)}
    table = {name: [results[sealed[name, task.name].id] for task, _ in tasks] for name in first}
    table = {name: row for name, row in table.items() if not any(result.error for result in row)}
    logs = np.array([[np.log(counted_errors(result.rows)) for result in row] for row in table.values()])
    print(f"The board {board.version} on a draw from {number}: {len(tasks)} families, 32 seeds each")
    print("| policy | sealed error % | diverged % |\n| --- | --- | --- |")
    for (name, results_of), errors in zip(table.items(), logs, strict=True):
        lost = np.mean([run["diverged"] for result in results_of for run in result.rows])
        print(f"| `{name}` | {np.exp(errors.mean()):.3g} | {100 * lost:.2g} |")
    rows = [board.policies.index(name) for name in table]
    taus = tau(board, rows, names, logs.mean(axis=-1))
    print(*(f"{value:6.2f}  tau, {family}" for family, value in taus.items()), sep="\n")


if __name__ == "__main__":
    main()
