"""The two-link arm: parameters, dynamics, regressor, energy and kinematics.

Equations (1)-(4) of Wang, Wang and Brdys, "Designing robust feedback linearisation controllers using imperfect
dynamic models and sensor feedback", Cogent Engineering 3:1173529 (2016):

    M(q) a + C(q, v) v + G(q) + F(v) + tau_d = tau

with q = (theta1, theta2) in radians, theta1 from the horizontal and theta2 relative to the first link. Both the
plant (compiled, in `kernel/`) and the controllers (on batches, through the functions below) use the terms of this file;
there is no second copy of the dynamics.

Everything is linear in five lumped parameters, with gravity folded into the last two:

    p1 = (m1 + m2) L1^2   p2 = m2 L2^2   p3 = m2 L1 L2   [kg m^2]
    p4 = (m1 + m2) L1 g   p5 = m2 L2 g                   [N m]

These are the point masses of the paper; rods and other links differ in these five numbers only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]

STANDARD_GRAVITY = 9.81


@dataclass(frozen=True)
class ArmParameters:
    """Two links in a vertical plane.

    Args:
        m1: mass of the first link [kg], positive.
        m2: mass of the second link [kg], positive.
        L1: length of the first link [m], positive.
        L2: length of the second link [m], positive.
        gravity: acceleration of gravity [m/s^2], zero or more.
        centre: where each link's centre of mass lies, as a fraction of its length: 1 for a point mass at the
            end (the paper's equations), 1/2 for a uniform rod.
        inertia: each link's moment of inertia about its centre of mass, as a fraction of m L^2: 0 for a
            point mass, 1/12 for a uniform rod.

    The default is the nominal model of the paper's Table 1. `SECTION_2_2` is the arm of §2.2 as printed.
    """

    m1: float = 20.0
    m2: float = 15.0
    L1: float = 0.7
    L2: float = 0.5
    gravity: float = STANDARD_GRAVITY
    centre: float = 1.0
    inertia: float = 0.0

    def __post_init__(self) -> None:
        for name in ("m1", "m2", "L1", "L2"):
            _check(name, getattr(self, name), "a positive, finite number", lambda x: x > 0)
        _check("gravity", self.gravity, "a finite number, zero or more", lambda x: x >= 0)
        _check("centre", self.centre, "a fraction in (0, 1]", lambda x: 0 < x <= 1)
        _check("inertia", self.inertia, "a fraction in [0, 1]", lambda x: 0 <= x <= 1)

    @property
    def lumped(self) -> Array:
        """The five lumped parameters (p1 ... p5), shape (5,), in kg m^2 and N m."""
        return np.array(lumped_terms(self.m1, self.m2, self.L1, self.L2, self.gravity, self.centre, self.inertia))

    def as_rods(self) -> ArmParameters:
        """The same masses and lengths, uniformly distributed along the links, as §2.1 of the paper says in words."""
        return ArmParameters(self.m1, self.m2, self.L1, self.L2, self.gravity, centre=1 / 2, inertia=1 / 12)


def _check(name: str, value: Any, right: str, is_right: Any) -> None:
    ok = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (ok and math.isfinite(value) and is_right(value)):
        raise ValueError(f"{name} must be {right}, got {value!r}")


TABLE_1 = ArmParameters()
"""The nominal model of Table 1: m = 20, 15 kg and L = 0.7, 0.5 m."""

SECTION_2_2 = ArmParameters(m1=0.7, m2=0.5, L1=20.0, L2=15.0)
"""The arm of §2.2 as printed, masses and lengths swapped against Table 1: m = 0.7, 0.5 kg and L = 20, 15 m."""


# The terms of the model. Plain arithmetic, so that the kernel compiles them for its lanes and the functions further
# down apply them to whole arrays.


def lumped_terms(m1, m2, L1, L2, gravity, centre, inertia):
    """The five lumped parameters p1 ... p5, in kg m^2 and N m.

    m1, m2, L1, L2, gravity, centre, inertia: as in `ArmParameters`.
    """
    own = centre * centre + inertia
    p1 = own * m1 * L1 * L1 + m2 * L1 * L1
    p2 = own * m2 * L2 * L2
    p3 = centre * m2 * L1 * L2
    p4 = (centre * m1 + m2) * L1 * gravity
    p5 = centre * m2 * L2 * gravity
    return p1, p2, p3, p4, p5


def inertia_terms(p1, p2, p3, c2):
    """M11, M12 = M21 and M22 of equation (2) [kg m^2].  p1, p2, p3: lumped parameters [kg m^2]; c2: cos q2."""
    m12 = p2 + p3 * c2
    return p1 + p3 * c2 + m12, m12, p2


def coriolis_terms(p3, s2, v1, v2):
    """The vector C(q, v) v of equation (3) [N m].  p3: [kg m^2]; s2: sin q2; v1, v2: [rad/s]."""
    h = p3 * s2
    return -h * v2 * (2.0 * v1 + v2), h * v1 * v1


def gravity_terms(p4, p5, c1, c12):
    """The vector G(q) of equation (4) [N m].  p4, p5: [N m]; c1, c12: cos q1 and cos(q1 + q2)."""
    g2 = p5 * c12
    return p4 * c1 + g2, g2


def solve_terms(m11, m12, m22, r1, r2):
    """The solution a of M a = r.  m11, m12, m22: of the symmetric matrix M; r1, r2: of r."""
    scale = 1.0 / (m11 * m22 - m12 * m12)
    return (m22 * r1 - m12 * r2) * scale, (m11 * r2 - m12 * r1) * scale


# The same on arrays, for controllers, checks and plots. q, v, a, tau: [... x 2]; the arm: an ArmParameters, or lumped
# parameters [... x 5]; all broadcast against each other.


def _lumped(arm: ArmParameters | ArrayLike) -> tuple[Array, ...]:
    p = arm.lumped if isinstance(arm, ArmParameters) else np.asarray(arm, dtype=float)
    return p[..., 0], p[..., 1], p[..., 2], p[..., 3], p[..., 4]


def _joints(x: ArrayLike) -> tuple[Array, Array]:
    x = np.asarray(x, dtype=float)
    return x[..., 0], x[..., 1]


def _stack(*parts: ArrayLike) -> Array:
    """The parts, broadcast against each other, along a new last axis; for one arm several times faster than np.stack."""
    stacked = np.empty((*np.broadcast(*parts).shape, len(parts)))
    for i, part in enumerate(parts):
        stacked[..., i] = part
    return stacked


def _matrix(m11: ArrayLike, m12: ArrayLike, m21: ArrayLike, m22: ArrayLike) -> Array:
    entries = _stack(m11, m12, m21, m22)
    return entries.reshape(*entries.shape[:-1], 2, 2)


def inertia_matrix(arm: ArmParameters | ArrayLike, q: ArrayLike) -> Array:
    """M(q) of equation (2) [kg m^2].  arm: an ArmParameters or [... x 5]; q: [... x 2] rad; returns [... x 2 x 2]."""
    p1, p2, p3, _, _ = _lumped(arm)
    _, q2 = _joints(q)
    m11, m12, m22 = inertia_terms(p1, p2, p3, np.cos(q2))
    return _matrix(m11, m12, m12, m22)


def coriolis_matrix(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, *, skew: bool = False) -> Array:
    """C(q, v) of equation (3) [N m s], [... x 2 x 2].

    The paper's C gives the right C v, but dM/dt - 2 C is not skew-symmetric.

    Args:
        arm: an ArmParameters or [... x 5].
        q, v: [... x 2] rad and rad/s.
        skew: True gives the matrix of the Christoffel symbols instead, for which it is, as passivity-based laws need (Spong,
            Hutchinson and Vidyasagar, "Robot Modeling and Control", 2006, §7.3): [[-h v2, -h (v1 + v2)], [h v1, 0]],
            h = p3 sin q2.
    """
    _, _, p3, _, _ = _lumped(arm)
    _, q2 = _joints(q)
    v1, v2 = _joints(v)
    h = p3 * np.sin(q2)
    c11, c12 = (-h * v2, -h * (v1 + v2)) if skew else (-2.0 * h * v2, -h * v2)
    return _matrix(c11, c12, h * v1, 0.0)


def coriolis_torque(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike) -> Array:
    """The torque C(q, v) v of equation (3) [N m].  arm: an ArmParameters or [... x 5]; q, v: [... x 2]; returns [... x 2]."""
    _, _, p3, _, _ = _lumped(arm)
    _, q2 = _joints(q)
    return _stack(*coriolis_terms(p3, np.sin(q2), *_joints(v)))


def gravity_torque(arm: ArmParameters | ArrayLike, q: ArrayLike) -> Array:
    """G(q) of equation (4) [N m].  arm: an ArmParameters or [... x 5]; q: [... x 2] rad; returns [... x 2]."""
    _, _, _, p4, p5 = _lumped(arm)
    q1, q2 = _joints(q)
    return _stack(*gravity_terms(p4, p5, np.cos(q1), np.cos(q1 + q2)))


def inverse_dynamics(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
    """The torque M a + C v + G [N m] that gives the acceleration a, without friction; [... x 2].

    With a nominal arm and a commanded acceleration, this is the paper's feedback linearisation mapping (figure 2).

    Args:
        arm: an ArmParameters or [... x 5].
        q, v, a: [... x 2] rad, rad/s and rad/s^2.
    """
    p1, p2, p3, p4, p5 = _lumped(arm)
    q1, q2 = _joints(q)
    a1, a2 = _joints(a)
    m11, m12, m22 = inertia_terms(p1, p2, p3, np.cos(q2))
    b1, b2 = coriolis_terms(p3, np.sin(q2), *_joints(v))
    g1, g2 = gravity_terms(p4, p5, np.cos(q1), np.cos(q1 + q2))
    return _stack(m11 * a1 + m12 * a2 + b1 + g1, m12 * a1 + m22 * a2 + b2 + g2)


def forward_dynamics(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike, torque: ArrayLike) -> Array:
    """The acceleration M^-1 (torque - C v - G) [rad/s^2], [... x 2].

    Args:
        arm: an ArmParameters or [... x 5].
        q, v: [... x 2] rad and rad/s.
        torque: [... x 2] N m, what acts on the joints: the applied torque less friction and disturbance.
    """
    p1, p2, p3, p4, p5 = _lumped(arm)
    q1, q2 = _joints(q)
    t1, t2 = _joints(torque)
    b1, b2 = coriolis_terms(p3, np.sin(q2), *_joints(v))
    g1, g2 = gravity_terms(p4, p5, np.cos(q1), np.cos(q1 + q2))
    m11, m12, m22 = inertia_terms(p1, p2, p3, np.cos(q2))
    return _stack(*solve_terms(m11, m12, m22, t1 - b1 - g1, t2 - b2 - g2))


def regressor(q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
    """Y(q, v, a) with Y p = M a + C v + G for the five lumped parameters p.  q, v, a: [... x 2]; returns [... x 2 x 5].

    The columns of the paper's K (33), each once: its seven unknowns are five, and g is folded into p4 and p5.
    """
    q1, q2 = _joints(q)
    v1, v2 = _joints(v)
    a1, a2 = _joints(a)
    c2, s2, c12 = np.cos(q2), np.sin(q2), np.cos(q1 + q2)
    first = (a1, a1 + a2, (2.0 * a1 + a2) * c2 - v2 * (2.0 * v1 + v2) * s2, np.cos(q1), c12)
    second = (0.0, a1 + a2, a1 * c2 + v1 * v1 * s2, 0.0, c12)
    both = _stack(*first, *second)
    return both.reshape(*both.shape[:-1], 2, 5)


def energy(arm: ArmParameters | ArrayLike, q: ArrayLike, v: ArrayLike) -> Array:
    """Kinetic and potential energy [J], zero for an arm at rest and horizontal, [...].

    arm: an ArmParameters or [... x 5]; q, v: [... x 2] rad and rad/s.
    """
    p1, p2, p3, p4, p5 = _lumped(arm)
    q1, q2 = _joints(q)
    v1, v2 = _joints(v)
    m11, m12, m22 = inertia_terms(p1, p2, p3, np.cos(q2))
    kinetic = 0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + m22 * v2 * v2)
    return kinetic + p4 * np.sin(q1) + p5 * np.sin(q1 + q2)


def joint_positions(arm: ArmParameters, q: ArrayLike) -> Array:
    """Where base, second joint and tip are [m], [... x 3 x 2] as (x, y).  arm: its lengths count; q: [... x 2] rad."""
    q1, q2 = _joints(q)
    elbow = arm.L1 * np.stack([np.cos(q1), np.sin(q1)], axis=-1)
    tip = elbow + arm.L2 * np.stack([np.cos(q1 + q2), np.sin(q1 + q2)], axis=-1)
    return np.stack([np.zeros_like(elbow), elbow, tip], axis=-2)
