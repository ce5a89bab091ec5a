"""The arm's motion over one physics step: friction by its law, the rest by Runge and Kutta."""

from fbl_gym.kernel.arm.friction import dry_friction, resist, sign
from fbl_gym.kernel.maths.fastmath import inline_njit, kernel_njit, named, over_lanes, sincos, sqrt
from fbl_gym.kernel.memory.layout import EXACT_FRICTION, LITERAL_FRICTION, NO_FRICTION
from fbl_gym.kernel.memory.views import pair, put
from fbl_gym.model import arm, chain

inertia_terms = inline_njit(arm.inertia_terms)
coriolis_terms = inline_njit(arm.coriolis_terms)
gravity_terms = inline_njit(arm.gravity_terms)
lumped_terms = inline_njit(arm.lumped_terms)
solve_terms = inline_njit(arm.solve_terms)
segment_terms = inline_njit(chain.segment_terms)


@inline_njit
def load_on_joints(lumped, rotor, q, v, torque):
    """Return the inertia matrix, and the torque left to accelerate it: torque - C v - G."""
    p1, p2, p3, p4, p5 = lumped
    sin1, cos1 = sincos(q[0])
    sin2, cos2 = sincos(q[1])
    m11, m12, m22 = inertia_terms(p1, p2, p3, rotor[0], rotor[1], cos2)
    coriolis1, coriolis2 = coriolis_terms(p3, sin2, v[0], v[1])
    gravity1, gravity2 = gravity_terms(p4, p5, cos1, cos1 * cos2 - sin1 * sin2)
    return m11, m12, m22, torque[0] - coriolis1 - gravity1, torque[1] - coriolis2 - gravity2


def make_runge_kutta(stage, moved, weighted):
    """Return a function that makes a fourth-order Runge-Kutta step of positions q and velocities v.

    Args:
        stage: (q, v, load, constants) -> acceleration.
        moved: (x, h, rate) -> x + h rate.
        weighted: (a, b, c, d) -> a + 2 (b + c) + d.
    """

    def runge_kutta(h, q, v, load_start, load_half, load_end, constants):
        half, sixth = 0.5 * h, h / 6.0
        a = stage(q, v, load_start, constants)
        q_2, v_2 = moved(q, half, v), moved(v, half, a)
        a_2 = stage(q_2, v_2, load_half, constants)
        q_3, v_3 = moved(q, half, v_2), moved(v, half, a_2)
        a_3 = stage(q_3, v_3, load_half, constants)
        q_4, v_4 = moved(q, h, v_3), moved(v, h, a_3)
        a_4 = stage(q_4, v_4, load_end, constants)
        return moved(q, sixth, weighted(v, v_2, v_3, v_4)), moved(v, sixth, weighted(a, a_2, a_3, a_4))

    return inline_njit(named(runge_kutta, stage.__module__))


@inline_njit
def moved(x, h, rate):
    """Return x + h rate."""
    return x[0] + h * rate[0], x[1] + h * rate[1]


@inline_njit
def weighted(a, b, c, d):
    """Return a + 2 (b + c) + d."""
    return a[0] + 2.0 * (b[0] + c[0]) + d[0], a[1] + 2.0 * (b[1] + c[1]) + d[1]


@inline_njit
def dry_bounds(v, friction):
    """Return the bounds of both joints' dry friction at their velocities, see `friction_of`."""
    _, coulomb, stiction, v_s = friction
    return dry_friction(v[0], coulomb[0], stiction[0], v_s[0]), dry_friction(v[1], coulomb[1], stiction[1], v_s[1])


@inline_njit
def _stage(q, v, tau, constants):
    """Return the acceleration at one stage of a physics step; see `hold` for `held`."""
    lumped, rotor, friction, held, law = constants
    dry1, dry2, free1, free2, _, _ = held
    viscous = friction[0]
    tau1, tau2 = tau[0] - viscous[0] * v[0] - dry1, tau[1] - viscous[1] * v[1] - dry2
    if law == LITERAL_FRICTION:
        bound1, bound2 = dry_bounds(v, friction)
        tau1, tau2 = tau1 - bound1 * sign(v[0]), tau2 - bound2 * sign(v[1])
    m11, m12, m22, load1, load2 = load_on_joints(lumped, rotor, q, v, (tau1, tau2))
    if law == EXACT_FRICTION:
        # A stuck joint carries any reaction: the other moves as if alone.
        load1, load2, m12 = load1 * free1, load2 * free2, m12 * (free1 * free2)
    return solve_terms(m11, m12, m22, load1, load2)


_runge_kutta = make_runge_kutta(_stage, moved, weighted)


@inline_njit
def lumped_of(block, lane):
    """Return the lumped parameters p1 to p5 of a lane."""
    lumped = block.lumped
    return lumped[0, lane], lumped[1, lane], lumped[2, lane], lumped[3, lane], lumped[4, lane]


@inline_njit
def rotor_of(block, settings, lane):
    """Return the real inertia of both rotors."""
    return settings.real_rotor[0] * block.rotor_ratio[0, lane], settings.real_rotor[1] * block.rotor_ratio[1, lane]


@inline_njit
def friction_of(block, lane):
    """Return viscous friction, Coulomb friction, stiction and v_s, both joints of each."""
    coulomb1 = block.coulomb[0, lane] + block.load_friction[0, lane] * abs(block.torque[0, lane])
    coulomb2 = block.coulomb[1, lane] + block.load_friction[1, lane] * abs(block.torque[1, lane])
    return pair(block.viscous, lane), (coulomb1, coulomb2), pair(block.stiction, lane), pair(block.v_s, lane)


#: Result of `hold` without friction that is held over a step.
FREE = (0.0, 0.0, 1.0, 1.0, 1.0, 1.0)


@inline_njit
def hold(h, v, inertia, load, friction):
    """Return the exact friction over a physics step h, from the inertia and the load of the joints.

    The load has no dry friction. This solves the two joints' box-constrained problem
    v+ = v + h M^-1 (load - f), |f_i| <= F_i(v), at the step's start. A joint that it brings to rest
    ends the step at rest. Sliding under Coulomb friction keeps Runge-Kutta's fourth order; where
    stiction fades, or a joint stops, the step is of first order.

    Returns:
        Of both joints, the friction torque; 0 if the joint sticks throughout the step, else 1; 0 if
        it ends the step at rest, else 1.
    """
    (v1, v2), (m11, m12, m22), (load1, load2) = v, inertia, load
    bound1, bound2 = dry_bounds(v, friction)
    bound1, bound2 = h * bound1, h * bound2
    momentum1, momentum2 = m11 * v1 + m12 * v2 + h * load1, m12 * v1 + m22 * v2 + h * load2
    next1, next2, dry1, dry2 = resist(m11, m12, m22, momentum1, momentum2, bound1, bound2)
    # Only friction can hold a joint: one without any merely has no velocity just now.
    rest1, rest2 = (next1 == 0.0) & (bound1 > 0.0), (next2 == 0.0) & (bound2 > 0.0)
    free1 = 0.0 if rest1 & (v1 == 0.0) else 1.0
    free2 = 0.0 if rest2 & (v2 == 0.0) else 1.0
    return dry1 / h, dry2 / h, free1, free2, 0.0 if rest1 else 1.0, 0.0 if rest2 else 1.0


@inline_njit
def move(h, q, v, torques, lumped, rotor, friction, law):
    """Return position and velocity after a physics step h.

    `torques` has those of both joints at the start, the middle and the end of the step.
    """
    held = FREE
    if law == EXACT_FRICTION:
        left = torques[0][0] - friction[0][0] * v[0], torques[0][1] - friction[0][1] * v[1]
        m11, m12, m22, load1, load2 = load_on_joints(lumped, rotor, q, v, left)
        held = hold(h, v, (m11, m12, m22), (load1, load2), friction)
    q, (v1, v2) = _runge_kutta(h, q, v, torques[0], torques[1], torques[2], (lumped, rotor, friction, held, law))
    return q, (v1 if held[4] != 0.0 else 0.0, v2 if held[5] != 0.0 else 0.0)


def over_lanes_by_law(function):
    """Return loops over lanes of rigid joints: without dry friction, and by the law of friction.

    Each law has a loop without branches, in which its number is a constant.

    Args:
        function: of block, settings, lane and law.
    """
    smoothly, exactly, literally = (
        over_lanes(function, law) for law in (NO_FRICTION, EXACT_FRICTION, LITERAL_FRICTION)
    )

    def by_law(block, settings, width):
        if settings.friction_law == NO_FRICTION:
            smoothly(block, settings, width)
        elif settings.friction_law == EXACT_FRICTION:
            exactly(block, settings, width)
        else:
            literally(block, settings, width)

    return smoothly, kernel_njit(named(by_law, function.__qualname__))


@inline_njit
def _advance(block, settings, lane, law):
    """Advance one lane by one physics step."""
    rotor, h = rotor_of(block, settings, lane), settings.physics_dt
    torques = pair(block.tau[0], lane), pair(block.tau[1], lane), pair(block.tau[2], lane)
    q, v = pair(block.position, lane), pair(block.velocity, lane)
    q, v = move(h, q, v, torques, lumped_of(block, lane), rotor, friction_of(block, lane), law)
    put(block.position, lane, q)
    put(block.velocity, lane, v)


advance_smoothly, advance_by_law = over_lanes_by_law(_advance)


@inline_njit
def acceleration_and_friction(block, settings, lane, law):
    """Return a lane's acceleration at this instant and its friction torque, both joints of each."""
    q, (v1, v2) = pair(block.position, lane), pair(block.velocity, lane)
    (tau1, tau2), (push1, push2) = pair(block.torque, lane), pair(block.disturbance, lane)
    lumped, rotor, torque = lumped_of(block, lane), rotor_of(block, settings, lane), (tau1 - push1, tau2 - push2)
    m11, m12, m22, load1, load2 = load_on_joints(lumped, rotor, q, (v1, v2), torque)
    return rub((m11, m12, m22), (load1, load2), (v1, v2), friction_of(block, lane), law)


@inline_njit
def rub(inertia, load, v, friction, law):
    """Return acceleration and friction torque of both joints under a load without friction."""
    (m11, m12, m22), (load1, load2), (v1, v2), (bound1, bound2) = inertia, load, v, (0.0, 0.0)
    if law != NO_FRICTION:
        bound1, bound2 = dry_bounds((v1, v2), friction)
    # A moving joint has its friction; one at rest has the torque that holds it, up to breakaway.
    friction1 = friction[0][0] * v1 + bound1 * sign(v1)
    friction2 = friction[0][1] * v2 + bound2 * sign(v2)
    load1, load2 = load1 - friction1, load2 - friction2
    if law != EXACT_FRICTION:
        a1, a2 = solve_terms(m11, m12, m22, load1, load2)
        return a1, a2, friction1, friction2
    hold1, hold2 = bound1 if v1 == 0.0 else 0.0, bound2 if v2 == 0.0 else 0.0
    a1, a2, dry1, dry2 = resist(m11, m12, m22, load1, load2, hold1, hold2)
    return a1, a2, friction1 + (dry1 if v1 == 0.0 else 0.0), friction2 + (dry2 if v2 == 0.0 else 0.0)


@kernel_njit
def lump(block, settings, lane):
    """Compute the real lumped parameters of a lane, with the payload that it carries."""
    (m1, m2), length1, length2 = pair(block.parameters, lane), block.parameters[2, lane], block.parameters[3, lane]
    payload, gravity = block.payload[lane], settings.gravity
    (centre1, centre2), (inertia1, inertia2) = pair(block.centre_ratio, lane), pair(block.inertia_ratio, lane)
    # The terms take fractions of the real lengths and masses.
    longer1, longer2 = length1 / settings.parameters[2], length2 / settings.parameters[3]
    if not settings.in_proportion[0]:
        centre1, centre2 = centre1 / longer1, centre2 / longer2
    if not settings.in_proportion[1]:
        inertia1 /= m1 / settings.parameters[0] * longer1 * longer1
        inertia2 /= m2 / settings.parameters[1] * longer2 * longer2
    centre = settings.centre[0] * centre1, settings.centre[1] * centre2
    inertia = settings.inertia[0] * inertia1, settings.inertia[1] * inertia2
    p1, p2, p3, p4, p5 = lumped_terms(m1, m2, length1, length2, gravity, centre, inertia)
    # The part of the option `payload` has an offset and a radius; what events add is at the tip.
    own = block.held_payload[lane] / payload if payload > 0.0 else 0.0
    offset, radius = block.payload_offset[lane], block.payload_radius[lane]
    reach, radius = length2 + own * offset, sqrt(own * (radius * radius + (1.0 - own) * offset * offset))
    block.lumped[0, lane] = p1 + payload * length1 * length1
    block.lumped[1, lane] = p2 + payload * (reach * reach + radius * radius)
    block.lumped[2, lane] = p3 + payload * length1 * reach
    block.lumped[3, lane] = p4 + payload * length1 * gravity
    block.lumped[4, lane] = p5 + payload * reach * gravity
    if settings.flexible:
        inertias, moments = segment_terms(m1, m2, length1, length2, centre, inertia, payload, reach, radius)
        for i in range(4):
            block.segment_inertia[i, lane], block.segment_moment[i, lane] = inertias[i], moments[i]
