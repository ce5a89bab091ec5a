"""Engines other than the package's own that move the real arm."""

from typing import Literal

from fbl_gym.records.record import Option, choice, whole


class MuJoCo(Option, kind="mujoco"):
    """The physics of MuJoCo, which needs the extra `mujoco`.

    Everything else stays the package's: draws, drives, disturbance, sensors, reference and reward.
    By default, the arm is the package's too, apart from friction. The fields make it another one.

    Args:
        integrator: "RK4", or "implicitfast" of first order.
        substeps: number of MuJoCo's steps in one physics step of the scenario.
        friction: level of MuJoCo's friction loss, which does not depend on the velocity. "coulomb"
            leaves out stiction, "breakaway" adds it.
    """

    integrator: Literal["RK4", "implicitfast"] = choice("RK4", ("RK4", "implicitfast"))
    substeps: int = whole(1, low=1, high=10_000)
    friction: Literal["coulomb", "breakaway"] = choice("coulomb", ("coulomb", "breakaway"))


PLANTS = (MuJoCo,)

#: Plants by name, as in `scenarios.get("everything-2@mujoco-lab")`.
#:
#: In "mujoco-lab", the arm and the rate are other ones too, see `scenarios.in_world`.
WORLDS: dict[str, MuJoCo] = {
    "mujoco": MuJoCo(),
    "mujoco-lab": MuJoCo(integrator="implicitfast", friction="breakaway"),
}
