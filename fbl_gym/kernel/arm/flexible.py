"""The motion of an arm whose links bend over one physics step; see `options/link.py`.

The hinges are taken out of the equations first. The joints then move as in `physics.py`, or with
their motors as in `elastic.py`, under the inertia and load that are left. The hinges follow.
`docs/explanation/links-that-bend.md` derives the matrices, by their names here. Angles are q of the
joints, b of the hinges, and x of joints and motors together. Velocities are v, u, and again v.
"""

from collections import namedtuple

from fbl_gym.kernel.arm import elastic
from fbl_gym.kernel.arm.physics import FREE, friction_of, hold, make_runge_kutta, moved, rub, solve_terms, weighted
from fbl_gym.kernel.maths.fastmath import inline_njit, kernel_njit, larger, over_lanes, sincos, smaller, sqrt
from fbl_gym.kernel.memory.layout import EXACT_FRICTION
from fbl_gym.kernel.memory.views import pair, put
from fbl_gym.model import chain

bend_terms = inline_njit(chain.bend_terms)
chain_inertia = inline_njit(chain.chain_inertia)
chain_load = inline_njit(chain.chain_load)
reduce_terms = inline_njit(chain.reduce_terms)


#: J and f of the segments, lengths of the links, gravity, stiffness and damping of the hinges.
_Links = namedtuple("_Links", "J f lengths gravity stiffness damping")


@inline_njit
def _links_of(block, settings, lane):
    """Return the `_Links` of a lane."""
    (rate1, rate2), (i1, i2), (z1, z2) = pair(block.bend_rate, lane), settings.beyond, settings.bend_damping
    J, f = block.segment_inertia, block.segment_moment
    return _Links(
        J=pair(J, lane) + pair(J[2:], lane),
        f=pair(f, lane) + pair(f[2:], lane),
        lengths=pair(block.parameters[2:], lane),
        gravity=settings.gravity,
        stiffness=(i1 * rate1 * rate1, i2 * rate2 * rate2),
        damping=(2.0 * z1 * i1 * rate1, 2.0 * z2 * i2 * rate2),
    )


@inline_njit
def _state(block, lane):
    """Return angles of joints and motors, and of hinges; their velocities."""
    x = elastic.both(block.position, block.motor_position, lane)
    v = elastic.both(block.velocity, block.motor_velocity, lane)
    return (x, pair(block.bend, lane)), (v, pair(block.bend_velocity, lane))


@inline_njit
def _inertia(links, q, b):
    """Return `chain_inertia` at angles of joints and hinges, and the cosines of the segments."""
    L1, L2 = links.lengths
    angle2 = q[0] + b[0]
    angle3 = angle2 + q[1]
    s1, c1 = sincos(q[0])
    s2, c2 = sincos(angle2)
    s3, c3 = sincos(angle3)
    s4, c4 = sincos(angle3 + b[1])
    cosines = c1, c2, c3, c4
    return chain_inertia(links.J, links.f, L1, L2, (s1, s2, s3, s4), cosines), cosines


@inline_njit
def _load_on_chain(links, q, b, v, u):
    """Return the parts of the inertia, and the loads of joints and hinges without any torque."""
    (Mqq, Mqb, Mbb, products), cosines = _inertia(links, q, b)
    second = v[0] + u[0]
    rates = v[0], second, second + v[1], second + v[1] + u[1]
    load1, bend1, load2, bend2 = chain_load(links.f, links.gravity, products, cosines, rates)
    return Mqq, Mqb, Mbb, load1, load2, bend1, bend2


@inline_njit
def _load_on_joints(links, rotor, q, b, v, u, torque):
    """Return `reduce_terms` under torques on the joints."""
    (m11, m13, m33), Mqb, Mbb, load1, load2, bend1, bend2 = _load_on_chain(links, q, b, v, u)
    (k1, k2), (d1, d2) = links.stiffness, links.damping
    load_q = load1 + torque[0], load2 + torque[1]
    load_b = bend1 - k1 * b[0] - d1 * u[0], bend2 - k2 * b[1] - d2 * u[1]
    return reduce_terms((m11 + rotor[0], m13, m33 + rotor[1]), Mqb, Mbb, load_q, load_b)


@inline_njit
def _stage(x, v, load, constants):
    """Return the accelerations of joints, motors and hinges at one stage of a physics step.

    Args:
        x: angles of joints and motors, and of hinges. With rigid joints, the motors are not used.
        v: their velocities.
        load: torques on the links, and those of the drives.
        constants: of the links, and as for `elastic.turn_motors`; True if the joints are elastic.
    """
    links, joint, friction, held, springs = constants
    (x, b), (v, u), ((load1, load2), (tau1, tau2)) = x, v, load
    dry1, dry2, free1, free2, _, _ = held
    if springs:
        (pull1, pull2), motors = elastic.turn_motors(x, v, (tau1, tau2), joint, friction, held)
        rotor, free1, free2 = (0.0, 0.0), 1.0, 1.0
    else:
        pull1, pull2 = tau1 - friction[0][0] * v[0][0] - dry1, tau2 - friction[0][1] * v[0][1] - dry2
        rotor, motors = joint[6:], (0.0, 0.0)
    torque = load1 + pull1, load2 + pull2
    (s11, s12, s22), (load1, load2), eliminated = _load_on_joints(links, rotor, x[0], b, v[0], u, torque)
    a = solve_terms(s11, s12 * (free1 * free2), s22, free1 * load1, free2 * load2)
    return (a, motors), bend_terms(eliminated, *a)


@inline_njit
def _moved(x, h, rate):
    """Return x + h rate."""
    return elastic.moved_both(x[0], h, rate[0]), moved(x[1], h, rate[1])


@inline_njit
def _weighted(a, b, c, d):
    """Return a + 2 (b + c) + d."""
    return elastic.weighted_both(a[0], b[0], c[0], d[0]), weighted(a[1], b[1], c[1], d[1])


_runge_kutta = make_runge_kutta(_stage, _moved, _weighted)


@inline_njit
def _advance(block, settings, lane, springs):
    """Advance one lane by one physics step."""
    h, links, ((x, b), (v, u)) = settings.physics_dt, _links_of(block, settings, lane), _state(block, lane)
    joint, friction = elastic.joint_of(block, settings, lane), friction_of(block, lane)
    tau1, tau2 = pair(block.tau[0], lane)
    if springs:
        held = elastic.hold_motors(x, v, (tau1, tau2), joint, friction, h)
    else:
        left = tau1 - friction[0][0] * v[0][0], tau2 - friction[0][1] * v[0][1]
        inertia, load, _ = _load_on_joints(links, joint[6:], x[0], b, v[0], u, left)
        held = hold(h, v[0], inertia, load, friction)
    ((q, th), b), (((v1, v2), (w1, w2)), u) = _runge_kutta(
        h, (x, b), (v, u), elastic.both(block.load[0], block.tau[0], lane), elastic.both(block.load[1], block.tau[1], lane),
        elastic.both(block.load[2], block.tau[2], lane), (links, joint, friction, held, springs),
    )  # fmt: skip
    moves1, moves2 = held[4] != 0.0, held[5] != 0.0
    if springs:
        put(block.motor_position, lane, th)
        put(block.motor_velocity, lane, (w1 if moves1 else 0.0, w2 if moves2 else 0.0))
    else:
        v1, v2 = v1 if moves1 else 0.0, v2 if moves2 else 0.0
    put(block.position, lane, q)
    put(block.velocity, lane, (v1, v2))
    put(block.bend, lane, b)
    put(block.bend_velocity, lane, u)


_advance_rigid, _advance_elastic = over_lanes(_advance, False), over_lanes(_advance, True)


@kernel_njit
def advance_flexible(block, settings, width):
    """Advance the first `width` lanes of a block whose links bend by one physics step."""
    if settings.elastic:
        _advance_elastic(block, settings, width)
    else:
        _advance_rigid(block, settings, width)


@inline_njit
def flexible_acceleration_and_friction(block, settings, lane):
    """Return the joints' acceleration on the side of the links now, and the friction torque."""
    links, ((x, b), (v, u)) = _links_of(block, settings, lane), _state(block, lane)
    joint, friction = elastic.joint_of(block, settings, lane), friction_of(block, lane)
    (tau1, tau2), (push1, push2) = pair(block.torque, lane), pair(block.disturbance, lane)
    if settings.elastic:
        load = (-push1, -push2), (tau1, tau2)
        (a, motors), _ = _stage((x, b), (v, u), load, (links, joint, friction, FREE, True))
        return *a, *elastic.motor_friction(v[1], motors, joint, friction)
    torque = tau1 - push1, tau2 - push2
    inertia, load, _ = _load_on_joints(links, joint[6:], x[0], b, v[0], u, torque)
    return rub(inertia, load, v[0], friction, EXACT_FRICTION)


@kernel_njit
def _pull(links, q, b1, b2, v):
    """Return the torques on hinges at rest [N m]."""
    _, _, _, _, _, bend1, bend2 = _load_on_chain(links, q, (b1, b2), v, (0.0, 0.0))
    return bend1 - links[4][0] * b1, bend2 - links[4][1] * b2


@kernel_njit
def _balance(links, q, v):
    """Return the angles of hinges at rest without a torque, and True if they were found.

    Newton's method from straight links, in steps of up to 0.3 rad. Where the balance nearby is not
    stable, the matrix is lifted to positive eigenvalues, so that the steps lead away from it.
    """
    b1, b2, h = 0.0, 0.0, 1e-6
    for _ in range(60):
        (r1, r2), (x1, x2), (y1, y2) = (
            _pull(links, q, b1, b2, v),
            _pull(links, q, b1 + h, b2, v),
            _pull(links, q, b1, b2 + h, v),
        )
        a11, a21, a12, a22 = (r1 - x1) / h, (r2 - x2) / h, (r1 - y1) / h, (r2 - y2) / h
        apart, across = 0.5 * (a11 - a22), 0.5 * (a12 + a21)
        lift = larger(2.0 * sqrt(apart * apart + across * across) - a11 - a22, 0.0)
        a11, a22 = a11 + lift, a22 + lift
        scale = 1.0 / (a11 * a22 - a12 * a21)
        step1, step2 = (a22 * r1 - a12 * r2) * scale, (a11 * r2 - a21 * r1) * scale
        length = larger(abs(step1), abs(step2))
        if lift > 0.0 and length < 1e-3:  # an upright arm would stay on its buckling links
            step1, step2, length = 1e-3, 1e-3, 1e-3
        share = smaller(1.0, 0.3 / length)
        b1, b2 = b1 + share * step1, b2 + share * step2
        if length < 1e-10:
            return (b1, b2), True
    return (b1, b2), False


@kernel_njit
def start_bends(block, settings, lane):
    """Bend the links of a lane to where weight and velocity hold them; see `link.py`."""
    links, q, v = _links_of(block, settings, lane), pair(block.position, lane), pair(block.velocity, lane)
    bend, balanced = _balance(links, q, v)
    if not balanced:
        bend, _ = _balance(links, q, (0.0, 0.0))
    put(block.bend, lane, bend)
    put(block.bend_velocity, lane, (0.0, 0.0))


@inline_njit
def chain_momentum(block, settings, lane, rotor):
    """Return the momentum of joints and hinges of a lane [N m s]."""
    (x, b), (((v1, v2), _), (u1, u2)) = _state(block, lane)
    (Mqq, Mqb, Mbb, _), _ = _inertia(_links_of(block, settings, lane), x[0], b)
    (m11, m13, m33), (m12, m14, m23, m34), (m22, m24, m44) = Mqq, Mqb, Mbb
    return (
        (m11 + rotor[0]) * v1 + m13 * v2 + m12 * u1 + m14 * u2, m13 * v1 + (m33 + rotor[1]) * v2 + m23 * u1 + m34 * u2,
        m12 * v1 + m23 * v2 + m22 * u1 + m24 * u2, m14 * v1 + m34 * v2 + m24 * u1 + m44 * u2,
    )  # fmt: skip


@inline_njit
def chain_velocity(block, settings, lane, rotor, momentum):
    """Return the velocities of joints and hinges of a lane with a momentum [rad/s]."""
    ((x, b), _), (p1, p2, p3, p4) = _state(block, lane), momentum
    ((m11, m13, m33), Mqb, Mbb, _), _ = _inertia(_links_of(block, settings, lane), x[0], b)
    Mqq = m11 + rotor[0], m13, m33 + rotor[1]
    (s11, s12, s22), (left1, left2), eliminated = reduce_terms(Mqq, Mqb, Mbb, (p1, p2), (p3, p4))
    v1, v2 = solve_terms(s11, s12, s22, left1, left2)
    return v1, v2, *bend_terms(eliminated, v1, v2)
