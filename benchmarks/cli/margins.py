"""`fbl-gym margins`."""

import argparse
from collections.abc import Sequence
from typing import Any

from benchmarks.cli.common import add, add_option
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.report.terminal import Screen, table
from benchmarks.studies.linear import POINT, Margins, linearize
from fbl_gym import Scenario, scenarios
from fbl_gym.records.checks import Pair


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "policies", "--scenario")
    add_option(parser, "--seed", int, 0, "N", "of the real arm, where it is drawn")
    rest = "where the arm rests, in rad (-1 0.5)"
    parser.add_argument("--at", nargs=2, type=float, default=POINT, metavar=("Q1", "Q2"), help=rest)


def run(arguments: argparse.Namespace) -> int:
    """Print the margins of each policy."""
    scenario = scenarios.get(arguments.scenario)
    q1, q2 = arguments.at
    title = f"{scenario.name}, at rest at ({q1:g}, {q2:g}) rad"
    rows: list[Sequence[str]] = []
    remarks: list[str] = []
    for policy in arguments.policies:
        spec = resolve(policy)
        try:
            margins = Margins(**spec.call(_margins, spec, scenario, (q1, q2), arguments.seed))
            rows.append((
                policy, f"{max(margins.gain_lower):.2f} - {min(margins.gain_upper):.2f}", f"{min(margins.phase):.0f} deg",
                f"{1e3 * margins.delay:.1f} ms", f"{max(margins.sensitivity):.2f}", f"{max(margins.complementary):.2f}",
            ))  # fmt: skip
        except ValueError as problem:
            remarks.append(f"no margins of {policy}: {problem}")
    screen = Screen()
    if rows:
        header = ("policy", "gain margin", "phase margin", "delay margin", "peak of S", "peak of T")
        screen.print(table(title, header, rows))
        remarks.append("Gain, phase and peaks: the worse joint, cut at its torque. Delay: of both torques.")
    for remark in remarks:
        screen.say(remark)
    return 0 if rows else 1


def _margins(policy: PolicySpec, scenario: Scenario, at: Pair, seed: int) -> dict[str, Any]:
    """Return the fields of a policy's margins."""
    return vars(linearize(policy, scenario, at, seed=seed).margins())
