"""Arms that stand in laboratories, with the source of each number.

All these sources count the first angle from hanging: theta1 = q1 - pi/2 here, with the same
torques. `docs/reference/arms.md` has the tables, and all that is missing.
"""

from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.checks import Pair


def _dfki(m: Pair, l: Pair, r: Pair, I: Pair, Ir: float, gr: float) -> ArmParameters:  # noqa: E741 - names of the files
    """Return a design of DFKI's double pendulum, from its file's numbers.

    `plant.py` of the repository has M11 = I1 + I2 + m2 l1^2 + 2 m2 l1 r2 cos q2 + (gr^2 + 1) Ir,
    M12 = I2 + m2 l1 r2 cos q2 - gr Ir and M22 = I2 + gr^2 Ir. Therefore I is about the joint. The
    rotor's part of M12 goes into the second link, which leaves M unchanged.
    """
    about_centre = (I[0] - m[0] * r[0] ** 2, I[1] - m[1] * r[1] ** 2 - gr * Ir)
    rotor = ((gr * gr + gr + 1.0) * Ir, (gr * gr + gr) * Ir)
    return ArmParameters.from_links(m, l, r, about_centre, rotor)


# github.com/dfki-ric-underactuated-lab/double_pendulum, commit 1e8544e6,
# data/system_identification/identified_parameters/design_C.1/model_1.0/model_parameters.yml
DFKI_C1 = _dfki(
    m=(0.5234602302310271, 0.6255677234174437), l=(0.2, 0.3), r=(0.2, 0.25569305436052964),
    I=(0.031887199591513114, 0.05086984812807257), Ir=6.287203962819607e-05, gr=6.0,
)  # fmt: skip
"""DFKI's double pendulum, design C.1: quasi-direct drives AK80-6, vertical."""

# The same repository and commit, design_A.0/model_2.0/model_parameters.yml
DFKI_A0 = _dfki(
    m=(0.5593806151425046, 0.6043459469186889), l=(0.3, 0.2), r=(0.3, 0.18377686083653508),
    I=(0.053470810264216295, 0.02392374528789766), Ir=7.659297952841183e-05, gr=6.0,
)  # fmt: skip
"""DFKI's double pendulum, design A.0: the same drives with a longer first link."""

# Masses, lengths, centres and inertias as four unrelated public programs give them. Their lumped
# parameters are those of github.com/hvzzzz/Robotics-at-BUAP, commit 52666ba4,
# code/control_posicion/robot2gdl.m, within 0.1 %: M11 = 2.351 + 0.1676 cos q2,
# M12 = 0.102 + 0.0838 cos q2, M22 = 0.102, g = 9.81 (3.9211, 0.1862).
CICESE = ArmParameters.from_links(
    mass=(23.902, 3.880), length=(0.45, 0.45), centre=(0.091, 0.048), inertia=(1.266, 0.093)
)
"""The direct-drive arm of CICESE and BUAP (Reyes and Kelly), vertical."""

# github.com/wpiHWzhao/Spotmini-Leg-Control, commit a4de0c6b, final.m, lines 11-19. One other
# program has 0.01616 for the last number, all further ones that were read have this one.
PELICAN = ArmParameters.from_links(
    mass=(6.5225, 2.0458), length=(0.26, 0.26), centre=(0.0983, 0.0229), inertia=(0.1213, 0.0116)
)
"""The Pelican of Kelly, Santibáñez and Loría (2005): its links alone, vertical."""


def _identified(published: ArmParameters, p1: float, p2: float, p4: float, p5: float, rotor2: float) -> ArmParameters:
    """Return an arm of the published masses, lengths and first rotor, and of these numbers.

    p1 includes the first rotor, and p3 is p5 L1 / g.
    """
    (m1, m2), (L1, L2), g = (published.m1, published.m2), (published.L1, published.L2), published.gravity
    rotor = published.rotor[0], rotor2  # type: ignore[index]
    centre = (p4 / g - m2 * L1) / m1, p5 / (m2 * g)
    inertia = p1 - rotor[0] - m2 * L1**2 - m1 * centre[0] ** 2, p2 - m2 * centre[1] ** 2
    return ArmParameters.from_links((m1, m2), (L1, L2), centre, inertia, rotor, g)


# By `fbl-gym identify` from the logs of the same repository; `docs/reference/arms.md` has the
# command, and intervals of some 5 % of each number, 8 % for A.0.
DFKI_C1_IDENTIFIED = _identified(DFKI_C1, p1=0.0526, p2=0.0473, p4=2.00, p5=1.54, rotor2=0.0058)
"""Design C.1 as six of its logs identify it: the second rotor is 2.2 times the published one."""

DFKI_A0_IDENTIFIED = _identified(DFKI_A0, p1=0.117, p2=0.0254, p4=3.54, p5=1.16, rotor2=0.0058)
"""Design A.0 as four of its logs identify it."""

REAL_ARMS = {
    "dfki-c1": DFKI_C1, "dfki-c1-identified": DFKI_C1_IDENTIFIED, "dfki-a0": DFKI_A0,
    "dfki-a0-identified": DFKI_A0_IDENTIFIED, "cicese": CICESE, "pelican": PELICAN,
}  # fmt: skip
"""The arms of laboratories, by name."""
