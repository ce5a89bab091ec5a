"""Engines other than the package's own that move the real arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fbl_gym.checks import Pair
from fbl_gym.records import Record, choice, kind, pair, whole


@dataclass(frozen=True)
class MuJoCo(Record):
    """The physics of MuJoCo, which needs the extra `mujoco`.

    Everything else stays the package's: draws, drives, disturbance, sensors, reference and reward.
    The default is the same arm as the package's. The fields make it another one on purpose.

    Args:
        integrator: "RK4", or "implicitfast" of first order.
        substeps: number of MuJoCo's steps in one physics step of the scenario.
        friction: level of MuJoCo's friction loss, which does not depend on the velocity. "coulomb"
            leaves out stiction, "breakaway" adds it.
        bend: stiffness of a passive hinge in the middle of each link, on which half of the link's
            mass turns; None: rigid links.
        bend_damping: damping of that hinge.
        kind: the record's name in plain data.
    """

    integrator: Literal["RK4", "implicitfast"] = choice("RK4", ("RK4", "implicitfast"))
    substeps: int = whole(1, low=1)
    friction: Literal["coulomb", "breakaway"] = choice("coulomb", ("coulomb", "breakaway"))
    bend: Pair | float | None = pair(None, unit="N m/rad", above=0)
    bend_damping: Pair | float = pair(0.0, unit="N m s/rad", low=0)
    kind: str = kind("mujoco")

    def validate(self) -> None:
        """Refuse a damping of links that do not bend."""
        if self.bend is None and self.bend_damping != (0.0, 0.0):
            raise ValueError(f"bend_damping needs bend, the stiffness; got bend_damping={self.bend_damping}, bend=None")


PLANTS = (MuJoCo,)
