"""`fbl-gym margins`."""

import argparse
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cli.common import write
from benchmarks.policies.isolation import Failed
from benchmarks.policies.spec import resolve
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.report.terminal import show
from benchmarks.run.linearize import margins_as_data
from benchmarks.text import say
from fbl_gym import scenarios


def run(arguments: argparse.Namespace) -> int:
    """Print the margins of each policy."""
    scenario = scenarios.get(arguments.scenario)
    q1, q2 = arguments.at
    title = f"{scenario.name}, at rest at ({q1:g}, {q2:g}) rad"
    rows, remarks, loops = [], [], {}
    for policy in arguments.policies:
        spec = resolve(policy)
        try:
            margins = spec.call(partial(margins_as_data, response=True), spec, scenario, (q1, q2), arguments.seed)
            loops[str(policy)], delay = margins["response"], margins["delay"]
            rows.append((
                str(policy), f"{max(margins['gain_lower']):.2f} - {min(margins['gain_upper']):.2f}",
                f"{min(margins['phase']):.0f} deg", f"{1e3 * delay:.1f} ms", f"{delay / scenario.control_dt:.2f}",
                f"{max(margins['sensitivity']):.2f}", f"{max(margins['complementary']):.2f}",
            ))  # fmt: skip
        except (ValueError, Failed) as problem:
            remarks.append(f"no margins of {policy}: {problem}")
    if rows:
        header = ("policy", "gain margin", "phase margin", "delay margin", "in samples", "peak of S", "peak of T")
        show(title, header, rows)
        remarks.append("Gain, phase and peaks: the worse joint, cut at its torque. Delay: of both torques.")
    say("\n".join(remarks))
    draw = partial(plot_lines, f"Loops on {title}", _bode(loops), across=2)
    write(arguments.plot if rows else None, "plot", lambda path: draw(path, arguments.width))
    return int(not rows)


def _bode(loops: dict[str, Any]) -> list[Panel]:
    """Return magnitude and phase of both joints' loop transfers."""
    panels = []
    for label, part in (("|L|", np.abs), ("phase of L [deg]", lambda z: np.degrees(np.unwrap(np.angle(z))))):
        scales = ("log", "log" if part is np.abs else "linear")
        for joint in (0, 1):
            lines = [Line(both[joint][0], part(both[joint][1]), name) for name, both in loops.items()]
            panels.append(Panel(f"joint {joint + 1}", "frequency [rad/s]", label, tuple(lines), scales))
    return panels
