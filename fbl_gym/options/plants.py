"""Engines other than the package's own that move the real arm."""

from dataclasses import dataclass
from typing import Literal

from fbl_gym.checks import Pair
from fbl_gym.records import Record, choice, kind, number, pair, whole


@dataclass(frozen=True)
class MuJoCo(Record):
    """The physics of MuJoCo, which needs the extra `mujoco`.

    Everything else stays the package's: draws, drives, disturbance, sensors, reference and reward.
    By default, the arm is the package's too, apart from friction. The fields make it another one.

    Args:
        integrator: "RK4", or "implicitfast" of first order.
        substeps: number of MuJoCo's steps in one physics step of the scenario.
        friction: level of MuJoCo's friction loss, which does not depend on the velocity. "coulomb"
            leaves out stiction, "breakaway" adds it.
        bend: natural frequency of the passive hinge on which half of each link's mass turns, with
            the nominal masses and a straight arm; None: rigid links. The hinge is at 15 % of the
            length, as in the pseudo-rigid-body model of a beam (Howell, "Compliant Mechanisms",
            2001, §5.1).
        bend_damping: damping ratio of that hinge.
    """

    integrator: Literal["RK4", "implicitfast"] = choice("RK4", ("RK4", "implicitfast"))
    substeps: int = whole(1, low=1, high=10_000)
    friction: Literal["coulomb", "breakaway"] = choice("coulomb", ("coulomb", "breakaway"))
    bend: Pair | float | None = pair(None, unit="Hz", low=1e-3, high=1e4)
    bend_damping: float = number(0.1, low=0)
    kind: str = kind("mujoco")


PLANTS = (MuJoCo,)

WORLDS: dict[str, MuJoCo] = {
    "mujoco": MuJoCo(),
    "mujoco-implicit": MuJoCo(integrator="implicitfast"),
    "mujoco-friction": MuJoCo(friction="breakaway"),
    "mujoco-bend": MuJoCo(friction="breakaway", bend=25.0),
    "mujoco-lab": MuJoCo(integrator="implicitfast", friction="breakaway"),
}
"""Plants by name, as in `scenarios.get("everything-2@mujoco-bend")`.

In "mujoco-lab", the arm and the rate are other ones too, see `scenarios.in_world`.
"""
