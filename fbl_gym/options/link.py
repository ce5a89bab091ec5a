"""Links that bend: half of each link's mass turns on a passive hinge near its root.

With the angles q of the joints and b of the hinges, and the natural frequency omega of a hinge:

    M(q, b) (q'', b'') + h(q, b, q', b') = (tau - F(q') - tau_d, -k b - d b')
    k = omega^2 I        d = 2 zeta omega I

I is the moment of inertia that turns on the hinge of a straight nominal arm without payload, with
the other hinge and the joints held. The encoders are at the joints, before the hinges: they do not
see the bend, and policies are not told of it. Joints may be elastic, too (`options/joints.py`).
`model/chain.py` has M and h.

An episode starts with the hinges at rest and balanced, k b = -h(q, b, q', 0) to 1e-9 rad. Under a
payload or heavier links than the nominal ones, soft hinges may buckle; the balance is then a stable
one, far from straight. If the joints turn too fast for a balance, it is that at rest, q' = 0.
"""

from typing import Any, ClassVar

import numpy as np

from fbl_gym.model.arm import ArmParameters, Array, inertia_matrix
from fbl_gym.model.chain import chain_dynamics, segment_terms
from fbl_gym.records.record import Numbers, Option, Pair, ends, pair

#: Largest bend of the links of a horizontal arm under its weight, without payload [rad].
MOST_SAG = 0.5


class FlexibleLink(Option):
    """Links that bend, with the encoders at their joints.

    Args:
        frequency: natural frequency of each link's hinge alone, with the nominal masses, a straight
            arm, and both joints and the other hinge held. Both hinges together have a slower mode,
            which `fbl-gym show` prints.
        damping: damping ratio of each hinge.
    """

    frequency: Numbers = pair(unit="Hz", varies=True, above=0, high=1e4, kernel="bend_rate", scale=2 * np.pi)
    damping: Pair | float = pair(0.1, low=0, kernel="bend_damping")

    derived: ClassVar = {"flexible": bool, "beyond": (float, 2)}

    def check(self, scenario: Any) -> None:
        """Refuse links too soft for their weight."""
        inertia, load = straight_chain(scenario.arm, 0.0)
        least = np.sqrt(np.abs(load[2:]) / (MOST_SAG * np.diag(inertia)[2:])) / (2 * np.pi)
        low = [ends(x)[0] for x in self.frequency]  # type: ignore[union-attr]
        if np.any(low < least):
            first, second = 1.005 * least  # rounded up
            needed = f"at least {first:.3g} and {second:.3g} Hz, where weight bends the links by {MOST_SAG} rad"
            raise ValueError(f"link.frequency must be {needed}, got {low[0]:g} and {low[1]:g} Hz")

    def pack(self, packer: Any) -> None:
        """Write the inertia that turns on the hinges of a straight nominal arm [kg m^2]."""
        packer.settings["flexible"] = True
        packer.settings["beyond"] = np.diag(straight_chain(packer.scenario.arm, 0.0)[0])[2:]

    def springs(self, arm: ArmParameters, rate: Array) -> tuple[Array, Array]:
        """Return k [N m/rad] and d [N m s/rad] of the hinges of a nominal arm.

        Both are [... x 2], as the natural frequencies `rate` [rad/s].
        """
        beyond = np.diag(straight_chain(arm, 0.0)[0])[2:]
        return beyond * rate**2, 2 * np.array(self.damping) * beyond * rate


def straight_chain(arm: ArmParameters, q2: float) -> tuple[Array, Array]:
    """Return inertia [4 x 4] and load [4] of joints and hinges of straight links, without rotors.

    The first link is horizontal.
    """
    segments = segment_terms(arm.m1, arm.m2, arm.L1, arm.L2, arm.centre, arm.inertia, 0.0, arm.L2, 0.0)
    zero = np.zeros(2)
    return chain_dynamics(segments, (arm.L1, arm.L2), arm.gravity, np.array([0.0, q2]), zero, zero, zero)


def fastest_rate(
    arm: ArmParameters, nominal: ArmParameters, rotor: Pair, viscous: Pair, joint: Any, link: Any
) -> float:
    """Return the largest eigenvalue of an arm's linear motion about any posture at rest [1/s].

    Of numbers that vary, the largest value counts. Frequencies refer to the nominal arm. `viscous`
    is the friction of the motors.
    """

    def top(x: Any) -> float:
        return ends(x)[1]

    rates = []
    for q2 in (0.0, np.pi / 2, np.pi):  # the inertia is linear in cos q2
        inertia = inertia_matrix(arm.lumped, (0.0, q2)) if link is None else straight_chain(arm, q2)[0]
        n, m = len(inertia) + (0 if joint is None else 2), len(inertia)
        motors, axes, mass = slice(0, 2) if joint is None else slice(m, n), np.eye(n), np.zeros((n, n))
        mass[:m, :m] = inertia
        mass[motors, motors] += np.diag(rotor)
        springs = [(axes[motors], np.zeros(2), np.array(viscous))]  # what they stretch, stiffness, damping
        if link is not None:
            springs.append((axes[2:4], *link.springs(nominal, 2 * np.pi * np.array([*map(top, link.frequency)]))))
        if joint is not None:
            springs.append(
                (axes[motors] - axes[:2], joint.springs(nominal, top)[0], np.array([*map(top, joint.damping)]))
            )
        stiffness, damping = (sum(x[0].T * x[i] @ x[0] for x in springs) for i in (1, 2))
        slope = np.linalg.solve(mass, -np.hstack([stiffness, damping]))
        rates.append(np.abs(np.linalg.eigvals(np.vstack([np.eye(n, 2 * n, k=n), slope]))).max())
    return float(max(rates))
