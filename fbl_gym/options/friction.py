"""Friction in the joints; `kernel/arm/friction.py` has its equation."""

from typing import Any, ClassVar, Literal

from fbl_gym.records.record import Numbers, Option, choice, pair

#: The laws of dry friction, in the order of their numbers in the kernel, from 1.
LAWS = ("exact", "literal")


class Friction(Option):
    """Joint friction, equation (43): f_i1 v + (f_i2 + f_s exp(-v^2 / v_s) + mu abs(tau)) sign(v).

    Args:
        viscous: coefficient of viscous friction, f_i1.
        coulomb: Coulomb friction, f_i2.
        stiction: friction f_s that fades as the joint moves.
        v_s: scale of the squared velocity at which stiction fades, the square of the Stribeck
            velocity.
        load: mu, the Coulomb friction of a gear for each N m of its drive's torque tau (Hamon,
            Gautier and Garrec, "Dynamic identification of robots with a dry friction model
            depending on load and velocity", IROS 2010, with the drive's torque as the load).
        law: "exact" holds a joint at rest under any load up to f_i2 + f_s. "literal" is the formula
            as printed, with sign(0) = 0: no joint ever sticks, and one at rest creeps under a load,
            the slower the shorter the physics step. It is for rigid joints and links, and not in
            MuJoCo.
    """

    viscous: Numbers = pair(0.0, unit="N m s/rad", varies=True, low=0, kernel="viscous")
    coulomb: Numbers = pair(0.0, unit="N m", varies=True, low=0, kernel="coulomb")
    stiction: Numbers = pair(0.0, unit="N m", varies=True, low=0, kernel="stiction")
    v_s: Numbers = pair(1e-3, unit="(rad/s)^2", varies=True, above=0, kernel="v_s")
    load: Numbers = pair(0.0, varies=True, low=0, high=1, kernel="load_friction")
    law: Literal["exact", "literal"] = choice("exact", LAWS)

    derived: ClassVar = {"friction_law": int}

    def check(self, scenario: Any) -> None:
        """Refuse the law of rigid joints for other ones."""
        others = (scenario.joint, scenario.link, scenario.plant)
        if self.law == "literal" and any(option is not None for option in others):
            raise ValueError(
                "friction.law must be 'exact' with elastic joints, links that bend and in MuJoCo, got 'literal'"
            )

    def pack(self, packer: Any) -> None:
        """Write the law, unless there is viscous friction alone, which is smooth."""
        dry = any(getattr(self, name) != (0.0, 0.0) for name in ("coulomb", "stiction", "load"))
        packer.settings["friction_law"] = 1 + LAWS.index(self.law) if dry else 0
