"""The arm's motion over one physics step: friction by its law, the rest by Runge and Kutta."""

from fbl_gym import arm
from fbl_gym.fastmath import inline_njit, kernel_njit, sincos
from fbl_gym.friction import dry_friction, resist, sign
from fbl_gym.memory import EXACT_FRICTION, LITERAL_FRICTION, NO_FRICTION

inertia_terms = inline_njit(arm.inertia_terms)
coriolis_terms = inline_njit(arm.coriolis_terms)
gravity_terms = inline_njit(arm.gravity_terms)
lumped_terms = inline_njit(arm.lumped_terms)
solve_terms = inline_njit(arm.solve_terms)


@inline_njit
def load_on_joints(p1, p2, p3, p4, p5, r1, r2, q1, q2, v1, v2, tau1, tau2):
    """Return the inertia matrix, and the torque left to accelerate it: tau - C v - G."""
    sin1, cos1 = sincos(q1)
    sin2, cos2 = sincos(q2)
    m11, m12, m22 = inertia_terms(p1, p2, p3, r1, r2, cos2)
    coriolis1, coriolis2 = coriolis_terms(p3, sin2, v1, v2)
    gravity1, gravity2 = gravity_terms(p4, p5, cos1, cos1 * cos2 - sin1 * sin2)
    return m11, m12, m22, tau1 - coriolis1 - gravity1, tau2 - coriolis2 - gravity2


@inline_njit
def _stage(tau1, tau2, lumped, friction, held, q1, q2, v1, v2, law):
    """Return the acceleration at one stage of a physics step; see `_hold` for `held`."""
    p1, p2, p3, p4, p5, r1, r2 = lumped
    viscous1, viscous2, coulomb1, coulomb2, stiction1, stiction2, v_s1, v_s2 = friction
    dry1, dry2, free1, free2, _, _ = held
    tau1, tau2 = tau1 - viscous1 * v1 - dry1, tau2 - viscous2 * v2 - dry2
    if law == LITERAL_FRICTION:
        tau1 -= dry_friction(v1, coulomb1, stiction1, v_s1) * sign(v1)
        tau2 -= dry_friction(v2, coulomb2, stiction2, v_s2) * sign(v2)
    m11, m12, m22, load1, load2 = load_on_joints(p1, p2, p3, p4, p5, r1, r2, q1, q2, v1, v2, tau1, tau2)
    if law == EXACT_FRICTION:
        # A stuck joint carries any reaction: the other moves as if alone.
        load1, load2, m12 = load1 * free1, load2 * free2, m12 * (free1 * free2)
    return solve_terms(m11, m12, m22, load1, load2)


_FREE = (0.0, 0.0, 1.0, 1.0, False, False)
"""Result of `_hold` without friction that is held over a step."""


@inline_njit
def _hold(block, lane, h, rotor):
    """Return the exact friction over a physics step h.

    It solves the two joints' box-constrained problem v+ = v + h M^-1 (load - f), |f_i| <= F_i(v),
    at the step's start. A joint at rest under a load below breakaway has no acceleration at all, at
    any step size. A joint that the problem brings to rest ends the step at rest. Sliding under
    Coulomb friction keeps Runge-Kutta's fourth order; where stiction fades, or a joint stops, the
    step is of first order.

    Returns:
        Of both joints, the friction torque; 0 if the joint sticks throughout the step, else 1; True
        if it ends the step at rest.
    """
    v1, v2 = block.velocity[0, lane], block.velocity[1, lane]
    m11, m12, m22, load1, load2 = load_on_joints(
        block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane], block.lumped[3, lane],
        block.lumped[4, lane], rotor[0], rotor[1], block.position[0, lane], block.position[1, lane], v1, v2,
        block.tau_start[0, lane] - block.viscous[0, lane] * v1, block.tau_start[1, lane] - block.viscous[1, lane] * v2,
    )  # fmt: skip
    bound1 = h * dry_friction(v1, block.coulomb[0, lane], block.stiction[0, lane], block.v_s[0, lane])
    bound2 = h * dry_friction(v2, block.coulomb[1, lane], block.stiction[1, lane], block.v_s[1, lane])
    momentum1, momentum2 = m11 * v1 + m12 * v2 + h * load1, m12 * v1 + m22 * v2 + h * load2
    next1, next2, dry1, dry2 = resist(m11, m12, m22, momentum1, momentum2, bound1, bound2)
    # Only friction can hold a joint: one without any merely has no velocity just now.
    rest1, rest2 = (next1 == 0.0) & (bound1 > 0.0), (next2 == 0.0) & (bound2 > 0.0)
    free1 = 0.0 if rest1 & (v1 == 0.0) else 1.0
    free2 = 0.0 if rest2 & (v2 == 0.0) else 1.0
    return dry1 / h, dry2 / h, free1, free2, rest1, rest2


@inline_njit
def _runge_kutta(block, lane, h, rotor, law, held):
    """Advance one lane by one physics step h: fourth-order Runge-Kutta, under friction from `_hold`.

    A name's first number is the joint, its second the stage: a1_3 is joint 1's acceleration at
    stage 3.
    """
    q1, q2 = block.position[0, lane], block.position[1, lane]
    v1, v2 = block.velocity[0, lane], block.velocity[1, lane]
    p1, p2, p3 = block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane]
    p4, p5 = block.lumped[3, lane], block.lumped[4, lane]
    r1, r2 = rotor
    friction = (
        block.viscous[0, lane], block.viscous[1, lane], block.coulomb[0, lane], block.coulomb[1, lane],
        block.stiction[0, lane], block.stiction[1, lane], block.v_s[0, lane], block.v_s[1, lane],
    )  # fmt: skip
    tau_start1, tau_start2 = block.tau_start[0, lane], block.tau_start[1, lane]
    half, sixth = 0.5 * h, h / 6.0
    lumped = (p1, p2, p3, p4, p5, r1, r2)
    tau_half1, tau_half2 = block.tau_half[0, lane], block.tau_half[1, lane]
    a1_1, a2_1 = _stage(tau_start1, tau_start2, lumped, friction, held, q1, q2, v1, v2, law)
    v1_2, v2_2 = v1 + half * a1_1, v2 + half * a2_1
    q1_2, q2_2 = q1 + half * v1, q2 + half * v2
    a1_2, a2_2 = _stage(tau_half1, tau_half2, lumped, friction, held, q1_2, q2_2, v1_2, v2_2, law)
    v1_3, v2_3 = v1 + half * a1_2, v2 + half * a2_2
    q1_3, q2_3 = q1 + half * v1_2, q2 + half * v2_2
    a1_3, a2_3 = _stage(tau_half1, tau_half2, lumped, friction, held, q1_3, q2_3, v1_3, v2_3, law)
    v1_4, v2_4 = v1 + h * a1_3, v2 + h * a2_3
    q1_4, q2_4 = q1 + h * v1_3, q2 + h * v2_3
    tau_end1, tau_end2 = block.tau_end[0, lane], block.tau_end[1, lane]
    a1_4, a2_4 = _stage(tau_end1, tau_end2, lumped, friction, held, q1_4, q2_4, v1_4, v2_4, law)
    block.position[0, lane] = q1 + sixth * (v1 + 2.0 * (v1_2 + v1_3) + v1_4)
    block.position[1, lane] = q2 + sixth * (v2 + 2.0 * (v2_2 + v2_3) + v2_4)
    v1 += sixth * (a1_1 + 2.0 * (a1_2 + a1_3) + a1_4)
    v2 += sixth * (a2_1 + 2.0 * (a2_2 + a2_3) + a2_4)
    block.velocity[0, lane] = 0.0 if held[4] else v1
    block.velocity[1, lane] = 0.0 if held[5] else v2


@kernel_njit
def advance_implicitly(block, settings, width):
    """Advance lanes by one physics step where viscous friction B makes Runge-Kutta unstable.

    Each of the step's parts h solves (M + h B) v+ = M v + h (load - f), |f_i| <= F_i(v), then
    q+ = q + h v+. It is stable for any B, and of first order.
    """
    law = settings.friction_law
    h = settings.physics_dt / settings.euler_steps
    for lane in range(width):
        # The mean torque has the impulse of the whole step.
        tau1 = (block.tau_start[0, lane] + 4.0 * block.tau_half[0, lane] + block.tau_end[0, lane]) / 6.0
        tau2 = (block.tau_start[1, lane] + 4.0 * block.tau_half[1, lane] + block.tau_end[1, lane]) / 6.0
        q1, q2 = block.position[0, lane], block.position[1, lane]
        v1, v2 = block.velocity[0, lane], block.velocity[1, lane]
        for _ in range(settings.euler_steps):
            m11, m12, m22, load1, load2 = load_on_joints(
                block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane], block.lumped[3, lane],
                block.lumped[4, lane], settings.rotor[0], settings.rotor[1], q1, q2, v1, v2, tau1, tau2,
            )  # fmt: skip
            bound1 = dry_friction(v1, block.coulomb[0, lane], block.stiction[0, lane], block.v_s[0, lane])
            bound2 = dry_friction(v2, block.coulomb[1, lane], block.stiction[1, lane], block.v_s[1, lane])
            if law == LITERAL_FRICTION:
                load1, load2 = load1 - bound1 * sign(v1), load2 - bound2 * sign(v2)
            if law != EXACT_FRICTION:
                bound1, bound2 = 0.0, 0.0
            momentum1, momentum2 = m11 * v1 + m12 * v2 + h * load1, m12 * v1 + m22 * v2 + h * load2
            m11, m22 = m11 + h * block.viscous[0, lane], m22 + h * block.viscous[1, lane]
            v1, v2, _, _ = resist(m11, m12, m22, momentum1, momentum2, h * bound1, h * bound2)
            q1, q2 = q1 + h * v1, q2 + h * v2
        block.position[0, lane], block.position[1, lane] = q1, q2
        block.velocity[0, lane], block.velocity[1, lane] = v1, v2


@kernel_njit
def advance_smoothly(block, settings, width):
    """Advance the first `width` lanes of a block by one physics step without dry friction."""
    h, rotor = settings.physics_dt, (settings.rotor[0], settings.rotor[1])
    for lane in range(width):
        _runge_kutta(block, lane, h, rotor, NO_FRICTION, _FREE)


@kernel_njit
def advance(block, settings, width):
    """Advance the first `width` lanes of a block by one physics step."""
    h, law = settings.physics_dt, settings.friction_law
    rotor = (settings.rotor[0], settings.rotor[1])
    # One loop for each law, each without branches.
    if law == NO_FRICTION:
        advance_smoothly(block, settings, width)
    elif law == EXACT_FRICTION:
        for lane in range(width):
            _runge_kutta(block, lane, h, rotor, EXACT_FRICTION, _hold(block, lane, h, rotor))
    else:
        for lane in range(width):
            _runge_kutta(block, lane, h, rotor, LITERAL_FRICTION, _FREE)


@inline_njit
def _load_now(block, settings, lane):
    """Return the inertia matrix of a lane at this instant, and the load on its joints."""
    return load_on_joints(
        block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane], block.lumped[3, lane],
        block.lumped[4, lane], settings.rotor[0], settings.rotor[1],
        block.position[0, lane], block.position[1, lane], block.velocity[0, lane], block.velocity[1, lane],
        block.torque[0, lane] - block.disturbance[0, lane], block.torque[1, lane] - block.disturbance[1, lane],
    )  # fmt: skip


@inline_njit
def smooth_acceleration(block, settings, lane):
    """Return a lane's acceleration at this instant without dry friction, [2]."""
    m11, m12, m22, load1, load2 = _load_now(block, settings, lane)
    load1 -= block.viscous[0, lane] * block.velocity[0, lane]
    load2 -= block.viscous[1, lane] * block.velocity[1, lane]
    return solve_terms(m11, m12, m22, load1, load2)


@inline_njit
def acceleration_and_friction(block, settings, lane, law):
    """Return a lane's acceleration at this instant and its friction torque, both joints of each."""
    v1, v2 = block.velocity[0, lane], block.velocity[1, lane]
    m11, m12, m22, load1, load2 = _load_now(block, settings, lane)
    bound1, bound2 = 0.0, 0.0
    if law != NO_FRICTION:
        bound1 = dry_friction(v1, block.coulomb[0, lane], block.stiction[0, lane], block.v_s[0, lane])
        bound2 = dry_friction(v2, block.coulomb[1, lane], block.stiction[1, lane], block.v_s[1, lane])
    # A moving joint has its friction; one at rest has the torque that holds it, up to breakaway.
    friction1 = block.viscous[0, lane] * v1 + bound1 * sign(v1)
    friction2 = block.viscous[1, lane] * v2 + bound2 * sign(v2)
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
    m1, m2 = block.parameters[0, lane], block.parameters[1, lane]
    length1, length2 = block.parameters[2, lane], block.parameters[3, lane]
    payload, gravity = block.payload[lane], settings.gravity
    p1, p2, p3, p4, p5 = lumped_terms(m1, m2, length1, length2, gravity, settings.centre, settings.inertia)
    block.lumped[0, lane] = p1 + payload * length1 * length1
    block.lumped[1, lane] = p2 + payload * length2 * length2
    block.lumped[2, lane] = p3 + payload * length1 * length2
    block.lumped[3, lane] = p4 + payload * length1 * gravity
    block.lumped[4, lane] = p5 + payload * length2 * gravity
