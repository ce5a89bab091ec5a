"""The two-link arm: parameters, dynamics, regressor and kinematics.

Equations (1)-(4) of Wang, Wang and Brdys, "Designing robust feedback linearisation controllers
using imperfect dynamic models and sensor feedback", Cogent Engineering 3:1173529 (2016)::

    M(q) a + C(q, v) v + G(q) + F(v) + tau_d = tau

with q = (theta1, theta2) in radians, theta1 from the horizontal and theta2 relative to the first
link. The dynamics is linear in five lumped parameters; the last two include gravity::

    p1 = (m1 + m2) L1^2   p2 = m2 L2^2   p3 = m2 L1 L2   [kg m^2]
    p4 = (m1 + m2) L1 g   p5 = m2 L2 g                   [N m]

These are for the point masses of the paper. Other links differ in these five numbers only. Rotors
with the inertias r1 and r2, reflected to the joints, add r1 to M11 and r2 to M22 (each turns about
its joint alone, as usual for a geared drive; Spong 1987). The lumped parameters leave them out.

The functions on arrays share these arguments, which broadcast: `arm`, an `ArmParameters`, lumped
parameters [... x 5], or these and the inertias of two rotors [... x 7]; joint angles `q` [rad],
velocities `v` [rad/s] and accelerations `a` [rad/s^2]; `torque`, the applied torque less friction
and disturbance [N m]; all but the arm [... x 2].
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fbl_gym.records.record import Option, Pair, number, pair

Array: TypeAlias = NDArray[np.float64]

STANDARD_GRAVITY = 9.81

#: Least determinant of M, as a share of M11 M22. Below it, rounding decides how the arm moves.
LEAST_INERTIA = 1e-12


class Links(Option):
    """Two links as data sheets describe them, each number in its unit.

    Args:
        mass: of each link.
        length: of each link.
        centre: distance of each centre of mass from the link's joint; negative for a link with a
            counterweight.
        inertia: of each link about its centre of mass.
        rotor: inertia of each joint's rotor, reflected to the joint.
        gravity: acceleration of gravity.
    """

    mass: Pair | float = pair(unit="kg", above=0)
    length: Pair | float = pair(unit="m", above=0)
    centre: Pair | float = pair(unit="m")
    inertia: Pair | float = pair(unit="kg m^2", low=0)
    rotor: Pair | float = pair(0.0, unit="kg m^2", low=0)
    gravity: float = number(STANDARD_GRAVITY, unit="m/s^2", low=0)

    @property
    def arm(self) -> ArmParameters:
        """Return the arm of these links."""
        (m1, m2), (L1, L2) = self.mass, self.length  # type: ignore[misc]
        centre = [c / x for c, x in zip(self.centre, (L1, L2), strict=True)]  # type: ignore[arg-type]
        inertia = [i / (m * x * x) for i, m, x in zip(self.inertia, (m1, m2), (L1, L2), strict=True)]  # type: ignore[arg-type]
        return ArmParameters(m1, m2, L1, L2, self.gravity, centre, inertia, self.rotor)  # type: ignore[arg-type]


class ArmParameters(Option):
    """Two links in a vertical plane, or in a horizontal one with gravity=0.

    The default is the nominal model of the paper's Table 1. `from_links` and `from_lumped` make an
    arm of other numbers.

    Args:
        m1: mass of the first link.
        m2: mass of the second link.
        L1: length of the first link.
        L2: length of the second link.
        gravity: acceleration of gravity.
        centre: distance from each link's joint to its centre of mass, as a fraction of its length:
            1 for a point mass at the end (the paper's equations), 1/2 for a uniform rod. It is
            negative for a link with a counterweight.
        inertia: each link's moment of inertia about its centre of mass, as a fraction of m L^2: 0
            for a point mass, 1/12 for a uniform rod.
        rotor: inertia of each joint's rotor as the joint feels it: n^2 J for a rotor of inertia J
            behind a gear of ratio n.
    """

    m1: float = number(20.0, unit="kg", above=0)
    m2: float = number(15.0, unit="kg", above=0)
    L1: float = number(0.7, unit="m", above=0)
    L2: float = number(0.5, unit="m", above=0)
    gravity: float = number(STANDARD_GRAVITY, unit="m/s^2", low=0, kernel="gravity")
    centre: Pair | float = pair(1.0, unit="L", kernel="centre")
    inertia: Pair | float = pair(0.0, unit="m L^2", low=0, kernel="inertia")
    rotor: Pair | float = pair(0.0, unit="kg m^2", low=0, kernel="rotor")

    derived: ClassVar = {"parameters": (float, 4)}

    def validate(self) -> None:
        """Refuse an arm without inertia about a joint, or with numbers that overflow."""
        *inertias, p4, p5 = self.lumped.tolist()
        matrices = [inertia_terms(*inertias, *self.rotor, c2) for c2 in (-1.0, 1.0)]  # type: ignore[call-arg, misc]
        regular = all(m12 * m12 < (1.0 - LEAST_INERTIA) * m11 * m22 < math.inf for m11, m12, m22 in matrices)
        if not (regular and abs(p4) + abs(p5) < math.inf):
            raise ValueError(
                f"the arm must have inertia about both joints, within the range of a float, got {self}; a link whose mass "
                "is on its joint needs an inertia or a rotor"
            )

    def pack(self, packer: Any) -> None:
        """Write masses and lengths."""
        packer.settings["parameters"] = self.m1, self.m2, self.L1, self.L2

    @staticmethod
    def from_links(
        mass: Pair, length: Pair, centre: Pair, inertia: Pair, rotor: Pair | float = 0.0, gravity: float = STANDARD_GRAVITY
    ) -> ArmParameters:  # fmt: skip
        """Return the arm of links as data sheets describe them; see `Links`."""
        return Links(mass, length, centre, inertia, rotor, gravity).arm

    @staticmethod
    def from_lumped(
        lumped: ArrayLike, length: Pair, rotor: Pair | float = 0.0, gravity: float = STANDARD_GRAVITY
    ) -> ArmParameters:
        """Return the arm of two point masses that has these lumped parameters.

        Its motion is that of every arm with these parameters. Masses and centres are equivalent
        ones, upon which parameter errors act. Link 1 has an inertia if the point would lie beyond
        its end.

        Args:
            lumped: p1 to p5 [5]: p1 to p3 [kg m^2], p4 and p5 [N m].
            length: of the links [2] m; p3 g = p5 L1, so gravity tells the first one.
            rotor: rotor inertias, reflected to the joints [kg m^2]; `lumped` leaves them out.
            gravity: acceleration of gravity [m/s^2]; 0 for a horizontal arm, with p4 = p5 = 0.

        Raises:
            ValueError: if no two point masses have these parameters, as where a link is balanced.
        """
        p1, p2, p3, p4, p5 = (float(p) for p in np.asarray(lumped, dtype=float))
        L1, L2 = length
        if abs(p3 * gravity - p5 * L1) > 1e-3 * max(abs(p5 * L1), abs(p3 * gravity)):
            raise ValueError(f"lumped must have p3 g = p5 L1, got {p3 * gravity:g} and {p5 * L1:g} with L1={L1}")
        moment2 = p3 / L1
        m2 = moment2 * moment2 / p2 if p2 > 0.0 else 0.0
        about1 = p1 - m2 * L1 * L1
        moment1 = p4 / gravity - m2 * L1 if gravity > 0.0 else about1 / L1
        if not (about1 > 0.0 and m2 > 0.0 and moment1 != 0.0):
            raise ValueError(
                "lumped must be those of point masses, p1 p2 > p3^2, p2 > 0 and neither link balanced (p3 and "
                f"p4 - m2 L1 g not 0), got {lumped!r}; describe a balanced link by from_links"
            )
        m1, inertia1 = moment1 * moment1 / about1, 0.0
        centre1 = moment1 / m1 / L1
        if abs(centre1) > 1.0:  # of a link that is nearly balanced
            centre1, m1, inertia1 = 1.0 / centre1, about1 / (L1 * L1), 1.0 - 1.0 / centre1**2
        return ArmParameters(m1, m2, L1, L2, gravity, (centre1, moment2 / m2 / L2), (inertia1, 0.0), rotor)

    @property
    def lumped(self) -> Array:
        """Return the lumped parameters p1 to p5, [5], in kg m^2 and N m."""
        return np.array(lumped_terms(self.m1, self.m2, self.L1, self.L2, self.gravity, self.centre, self.inertia))

    @cached_property
    def base(self) -> Array:
        """p1 to p5 and both rotors' inertias [7], in kg m^2, p4 and p5 in N m."""
        return with_rotors(self.lumped, self.rotor)

    def as_rods(self) -> ArmParameters:
        """Return an arm of uniform rods of the same masses and lengths, as in §2.1's text."""
        return dataclasses.replace(self, centre=1 / 2, inertia=1 / 12)


# The terms of the model, the only copy: the kernel compiles them for its lanes, and the functions
# further down apply them to arrays. c1 is cos q1, s2 sin q2, c12 cos(q1 + q2).


def lumped_terms(m1, m2, L1, L2, gravity, centre, inertia):
    """Return the lumped parameters p1 to p5 of the fields of `ArmParameters`, in their units."""
    centre1, centre2 = centre[0], centre[1]
    p1 = (centre1 * centre1 + inertia[0]) * m1 * L1 * L1 + m2 * L1 * L1
    p2 = (centre2 * centre2 + inertia[1]) * m2 * L2 * L2
    p3 = centre2 * m2 * L1 * L2
    p4 = (centre1 * m1 + m2) * L1 * gravity
    p5 = centre2 * m2 * L2 * gravity
    return p1, p2, p3, p4, p5


def stretched_inertia(arm: ArmParameters) -> Array:
    """Return the inertia of the stretched links about each joint [2] kg m^2, without rotors."""
    p1, p2, p3, _, _ = arm.lumped
    return np.array([p1 + p2 + 2 * p3, p2])


def inertia_terms(p1, p2, p3, r1, r2, c2):
    """Return M11, M12 = M21 and M22 of equation (2), with the rotors [kg m^2]."""
    m12 = p2 + p3 * c2
    return p1 + r1 + p3 * c2 + m12, m12, p2 + r2


def coriolis_terms(p3, s2, v1, v2):
    """Return the vector C(q, v) v of equation (3) [N m]."""
    h = p3 * s2
    return -h * v2 * (2.0 * v1 + v2), h * v1 * v1


def gravity_terms(p4, p5, c1, c12):
    """Return the vector G(q) of equation (4) [N m]."""
    g2 = p5 * c12
    return p4 * c1 + g2, g2


def solve_terms(m11, m12, m22, r1, r2):
    """Return the solution a of M a = r."""
    scale = 1.0 / (m11 * m22 - m12 * m12)
    return (m22 * r1 - m12 * r2) * scale, (m11 * r2 - m12 * r1) * scale


#: The nominal model of Table 1: m = 20, 15 kg and L = 0.7, 0.5 m.
TABLE_1 = ArmParameters()

#: The arm of §2.2 as printed: m = 0.7, 0.5 kg and L = 20, 15 m, Table 1's numbers swapped.
SECTION_2_2 = ArmParameters(m1=0.7, m2=0.5, L1=20.0, L2=15.0)

#: The arms of the paper, by name.
ARMS = {"table-1": TABLE_1, "section-2-2": SECTION_2_2}


def with_rotors(lumped: Array, rotor: ArrayLike) -> Array:
    """Return lumped parameters [... x 5] and rotors' inertias [... x 2] together, [... x 7]."""
    return np.concatenate([lumped, np.broadcast_to(rotor, (*lumped.shape[:-1], 2))], axis=-1)


def _lumped(arm: ArmParameters | ArrayLike) -> tuple[Any, ...]:
    """Return the lumped parameters p1 to p5, and the rotor inertias."""
    numbers = arm.base if isinstance(arm, ArmParameters) else np.asarray(arm, dtype=float)
    p = tuple(numbers[..., i] for i in range(numbers.shape[-1]))
    return p if len(p) == 7 else (*p, np.zeros(()), np.zeros(()))


def _joints(x: ArrayLike) -> tuple[Array, Array]:
    x = np.asarray(x, dtype=float)
    return x[..., 0], x[..., 1]


def _stack(*parts: Any) -> Array:
    """Stack the parts of a result along a new last axis."""
    stacked = np.empty((*np.broadcast(*parts).shape, len(parts)))
    for i, part in enumerate(parts):
        stacked[..., i] = part
    return stacked


def matrix_of(first: tuple[Any, ...], second: tuple[Any, ...]) -> Array:
    """Return the matrices [... x 2 x n] of the entries of their two rows."""
    stacked = _stack(*first, *second)
    return stacked.reshape(*stacked.shape[:-1], 2, len(first))


def inertia_matrix(arm: ArmParameters | ArrayLike, q: ArrayLike) -> Array:
    """Return the inertia matrix M(q) of equation (2) [kg m^2], [... x 2 x 2]."""
    p1, p2, p3, _, _, r1, r2 = _lumped(arm)
    _, q2 = _joints(q)
    m11, m12, m22 = inertia_terms(p1, p2, p3, r1, r2, np.cos(q2))
    return matrix_of((m11, m12), (m12, m22))


def coriolis_matrix(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, *, skew: bool = False) -> Array:
    """Return the matrix C(q, v) of equation (3) [N m s], [... x 2 x 2].

    The paper's C gives the right C v, but dM/dt - 2 C is not skew-symmetric. Passivity-based laws
    need the matrix of the Christoffel symbols (skew=True), for which it is (Spong, Hutchinson and
    Vidyasagar, "Robot Modeling and Control", 2006, §7.3): [[-h v2, -h (v1 + v2)], [h v1, 0]], with
    h = p3 sin q2.
    """
    _, _, p3, _, _, _, _ = _lumped(arm)
    (_, q2), (v1, v2) = _joints(q), _joints(v)
    h = p3 * np.sin(q2)
    c11, c12 = (-h * v2, -h * (v1 + v2)) if skew else (-2.0 * h * v2, -h * v2)
    return matrix_of((c11, c12), (h * v1, 0.0))


def gravity_torque(arm: ArmParameters | ArrayLike, q: ArrayLike) -> Array:
    """Return the gravity torque G(q) of equation (4) [N m], [... x 2]."""
    _, _, _, p4, p5, _, _ = _lumped(arm)
    q1, q2 = _joints(q)
    return _stack(*gravity_terms(p4, p5, np.cos(q1), np.cos(q1 + q2)))


def inverse_dynamics(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
    """Return the torque M a + C v + G [N m] for an acceleration a without friction, [... x 2].

    With a nominal arm and a commanded acceleration, this is the feedback linearisation mapping of
    the paper (figure 2).
    """
    m11, m12, m22, b1, b2, g1, g2 = _terms(arm, q, v)
    a1, a2 = _joints(a)
    return _stack(m11 * a1 + m12 * a2 + b1 + g1, m12 * a1 + m22 * a2 + b2 + g2)


def forward_dynamics(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, torque: ArrayLike) -> Array:
    """Return the acceleration M^-1 (torque - C v - G) [rad/s^2], [... x 2]."""
    m11, m12, m22, b1, b2, g1, g2 = _terms(arm, q, v)
    t1, t2 = _joints(torque)
    return _stack(*solve_terms(m11, m12, m22, t1 - b1 - g1, t2 - b2 - g2))


def _terms(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike) -> tuple[Any, ...]:
    """Return the entries M11, M12 and M22, then those of C v and of G."""
    p1, p2, p3, p4, p5, r1, r2 = _lumped(arm)
    (q1, q2), (v1, v2) = _joints(q), _joints(v)
    inertia = inertia_terms(p1, p2, p3, r1, r2, np.cos(q2))
    coriolis = coriolis_terms(p3, np.sin(q2), v1, v2)
    return *inertia, *coriolis, *gravity_terms(p4, p5, np.cos(q1), np.cos(q1 + q2))


def regressor(q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
    """Return the regressor Y with Y p = M a + C v + G for lumped parameters p, [... x 2 x 5].

    Rotors add their inertia times a. These are the columns of the paper's K (33) without
    repetition: its seven unknowns are five, and p4 and p5 include gravity.
    """
    (q1, q2), (v1, v2), (a1, a2) = map(_joints, (q, v, a))
    c2, s2, c12 = np.cos(q2), np.sin(q2), np.cos(q1 + q2)
    first = (a1, a1 + a2, (2.0 * a1 + a2) * c2 - v2 * (2.0 * v1 + v2) * s2, np.cos(q1), c12)
    second = (0.0, a1 + a2, a1 * c2 + v1 * v1 * s2, 0.0, c12)
    return matrix_of(first, second)


def joint_positions(arm: ArmParameters, q: ArrayLike) -> Array:
    """Return the positions (x, y) of base, second joint and tip [m], [... x 3 x 2]."""
    q1, q2 = _joints(q)
    elbow = arm.L1 * np.stack([np.cos(q1), np.sin(q1)], axis=-1)
    tip = elbow + arm.L2 * np.stack([np.cos(q1 + q2), np.sin(q1 + q2)], axis=-1)
    return np.stack([np.zeros_like(elbow), elbow, tip], axis=-2)
