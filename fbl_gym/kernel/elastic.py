"""The motion of an arm with elastic joints over one physics step; see `fbl_gym/joints.py`."""

from fbl_gym.fastmath import clip, inline_njit, kernel_njit
from fbl_gym.friction import dry_friction, shrink, sign
from fbl_gym.kernel.physics import load_on_joints, solve_terms
from fbl_gym.memory import EXACT_FRICTION, LITERAL_FRICTION


@inline_njit
def _spring(stiffness, damping, gap, stretch, rate):
    """Return a spring's torque on the link; `gap` is half the backlash."""
    return stiffness * shrink(stretch, gap) + (damping * rate if abs(stretch) >= gap else 0.0)


@inline_njit
def _stage(lumped, joint, friction, held, tau, load, x, law):
    """Return the accelerations of links and motors at one stage of a physics step.

    Args:
        lumped: parameters of the links.
        joint: stiffness, damping, half the backlash and rotor inertia, both joints of each.
        friction: viscous, Coulomb, stiction and v_s, both joints of each.
        held: dry friction held over the step; 0 where a motor sticks, else 1.
        tau: torques of the drives.
        load: torques on the links.
        x: positions of links and motors, then velocities.
        law: of the friction.
    """
    p1, p2, p3, p4, p5 = lumped
    k1, k2, d1, d2, gap1, gap2, b1, b2 = joint
    viscous1, viscous2, coulomb1, coulomb2, stiction1, stiction2, v_s1, v_s2 = friction
    dry1, dry2, free1, free2 = held
    q1, q2, th1, th2, v1, v2, w1, w2 = x
    spring1 = _spring(k1, d1, gap1, th1 - q1, w1 - v1)
    spring2 = _spring(k2, d2, gap2, th2 - q2, w2 - v2)
    m11, m12, m22, load1, load2 = load_on_joints(
        p1, p2, p3, p4, p5, 0.0, 0.0, q1, q2, v1, v2, spring1 + load[0], spring2 + load[1]
    )
    a1, a2 = solve_terms(m11, m12, m22, load1, load2)
    left1 = tau[0] - spring1 - viscous1 * w1 - dry1
    left2 = tau[1] - spring2 - viscous2 * w2 - dry2
    if law == LITERAL_FRICTION:
        left1 -= dry_friction(w1, coulomb1, stiction1, v_s1) * sign(w1)
        left2 -= dry_friction(w2, coulomb2, stiction2, v_s2) * sign(w2)
    return a1, a2, free1 * left1 / b1, free2 * left2 / b2


@inline_njit
def _joint(block, settings, lane):
    """Return the joints' numbers, as `_stage` takes them."""
    return (
        block.stiffness[0, lane], block.stiffness[1, lane], block.damping[0, lane], block.damping[1, lane],
        block.half_backlash[0, lane], block.half_backlash[1, lane], settings.motor_inertia[0], settings.motor_inertia[1],
    )  # fmt: skip


@inline_njit
def _friction(block, lane):
    """Return the numbers of friction, as `_stage` takes them."""
    return (
        block.viscous[0, lane], block.viscous[1, lane], block.coulomb[0, lane], block.coulomb[1, lane],
        block.stiction[0, lane], block.stiction[1, lane], block.v_s[0, lane], block.v_s[1, lane],
    )  # fmt: skip


@inline_njit
def _lumped(block, lane):
    return (
        block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane],
        block.lumped[3, lane], block.lumped[4, lane],
    )  # fmt: skip


@inline_njit
def _state(block, lane):
    """Return a lane's state, as `_stage` takes it."""
    return (
        block.position[0, lane], block.position[1, lane], block.motor_position[0, lane], block.motor_position[1, lane],
        block.velocity[0, lane], block.velocity[1, lane], block.motor_velocity[0, lane], block.motor_velocity[1, lane],
    )  # fmt: skip


@inline_njit
def _moved(x, h, rate, a):
    """Return the state x moved for h by the velocities of the state `rate` and accelerations a."""
    return (
        x[0] + h * rate[4], x[1] + h * rate[5], x[2] + h * rate[6], x[3] + h * rate[7],
        x[4] + h * a[0], x[5] + h * a[1], x[6] + h * a[2], x[7] + h * a[3],
    )  # fmt: skip


@inline_njit
def _stick(h, w, load, bound, inertia):
    """Return a motor's dry friction over a step, True if it ends at rest, and 0 if it sticks.

    Motors are not coupled: each solves B w+ = B w + h (load - f), |f| <= bound, by itself.
    """
    momentum = inertia * w + h * load
    left = shrink(momentum, h * bound)
    rest = (left == 0.0) & (bound > 0.0)
    return (momentum - left) / h, rest, 0.0 if rest & (w == 0.0) else 1.0


@inline_njit
def _runge_kutta(block, settings, lane, h, law):
    """Advance one lane by one physics step h, as `physics.py` does for rigid joints."""
    joint, friction = _joint(block, settings, lane), _friction(block, lane)
    lumped, x = _lumped(block, lane), _state(block, lane)
    tau_start = (block.tau_start[0, lane], block.tau_start[1, lane])
    tau_half = (block.tau_half[0, lane], block.tau_half[1, lane])
    tau_end = (block.tau_end[0, lane], block.tau_end[1, lane])
    load_start = (block.load_start[0, lane], block.load_start[1, lane])
    load_half = (block.load_half[0, lane], block.load_half[1, lane])
    load_end = (block.load_end[0, lane], block.load_end[1, lane])
    held, rest1, rest2 = (0.0, 0.0, 1.0, 1.0), False, False
    if law == EXACT_FRICTION:
        k1, k2, d1, d2, gap1, gap2, b1, b2 = joint
        viscous1, viscous2, coulomb1, coulomb2, stiction1, stiction2, v_s1, v_s2 = friction
        w1, w2 = x[6], x[7]
        left1 = tau_start[0] - _spring(k1, d1, gap1, x[2] - x[0], w1 - x[4]) - viscous1 * w1
        left2 = tau_start[1] - _spring(k2, d2, gap2, x[3] - x[1], w2 - x[5]) - viscous2 * w2
        dry1, rest1, free1 = _stick(h, w1, left1, dry_friction(w1, coulomb1, stiction1, v_s1), b1)
        dry2, rest2, free2 = _stick(h, w2, left2, dry_friction(w2, coulomb2, stiction2, v_s2), b2)
        held = (dry1, dry2, free1, free2)

    half, sixth = 0.5 * h, h / 6.0
    a_1 = _stage(lumped, joint, friction, held, tau_start, load_start, x, law)
    x_2 = _moved(x, half, x, a_1)
    a_2 = _stage(lumped, joint, friction, held, tau_half, load_half, x_2, law)
    x_3 = _moved(x, half, x_2, a_2)
    a_3 = _stage(lumped, joint, friction, held, tau_half, load_half, x_3, law)
    x_4 = _moved(x, h, x_3, a_3)
    a_4 = _stage(lumped, joint, friction, held, tau_end, load_end, x_4, law)
    block.position[0, lane] = x[0] + sixth * (x[4] + 2.0 * (x_2[4] + x_3[4]) + x_4[4])
    block.position[1, lane] = x[1] + sixth * (x[5] + 2.0 * (x_2[5] + x_3[5]) + x_4[5])
    block.motor_position[0, lane] = x[2] + sixth * (x[6] + 2.0 * (x_2[6] + x_3[6]) + x_4[6])
    block.motor_position[1, lane] = x[3] + sixth * (x[7] + 2.0 * (x_2[7] + x_3[7]) + x_4[7])
    block.velocity[0, lane] = x[4] + sixth * (a_1[0] + 2.0 * (a_2[0] + a_3[0]) + a_4[0])
    block.velocity[1, lane] = x[5] + sixth * (a_1[1] + 2.0 * (a_2[1] + a_3[1]) + a_4[1])
    w1 = x[6] + sixth * (a_1[2] + 2.0 * (a_2[2] + a_3[2]) + a_4[2])
    w2 = x[7] + sixth * (a_1[3] + 2.0 * (a_2[3] + a_3[3]) + a_4[3])
    block.motor_velocity[0, lane] = 0.0 if rest1 else w1
    block.motor_velocity[1, lane] = 0.0 if rest2 else w2


@kernel_njit
def advance_elastic(block, settings, width):
    """Advance the first `width` lanes of a block with elastic joints by one physics step."""
    h = settings.physics_dt
    if settings.friction_law == LITERAL_FRICTION:
        for lane in range(width):
            _runge_kutta(block, settings, lane, h, LITERAL_FRICTION)
    else:
        for lane in range(width):
            _runge_kutta(block, settings, lane, h, EXACT_FRICTION)


@kernel_njit
def feel_joints(block, settings, width):
    """Compute the links' acceleration and the motors' friction torque at this instant."""
    literal = settings.friction_law == LITERAL_FRICTION
    held = (0.0, 0.0, 1.0, 1.0)
    for lane in range(width):
        joint, friction, x = _joint(block, settings, lane), _friction(block, lane), _state(block, lane)
        tau = (block.torque[0, lane], block.torque[1, lane])
        load = (-block.disturbance[0, lane], -block.disturbance[1, lane])
        a1, a2, _, _ = _stage(_lumped(block, lane), joint, friction, held, tau, load, x, EXACT_FRICTION)
        block.acceleration[0, lane], block.acceleration[1, lane] = a1, a2
    for i in range(2):
        for lane in range(width):
            stiffness, damping, gap = block.stiffness[i, lane], block.damping[i, lane], block.half_backlash[i, lane]
            w = block.motor_velocity[i, lane]
            stretch = block.motor_position[i, lane] - block.position[i, lane]
            spring = _spring(stiffness, damping, gap, stretch, w - block.velocity[i, lane])
            bound = dry_friction(w, block.coulomb[i, lane], block.stiction[i, lane], block.v_s[i, lane])
            hold = clip(block.torque[i, lane] - spring, bound)
            hold = 0.0 if literal else hold
            block.motor_friction[i, lane] = block.viscous[i, lane] * w + (bound * sign(w) if w != 0.0 else hold)


@kernel_njit
def hang_motors(block, lane):
    """Put the motors of a lane to where the springs carry the torque of the drives."""
    for i in range(2):
        tau = block.torque[i, lane]
        stretch = tau / block.stiffness[i, lane] + block.half_backlash[i, lane] * sign(tau)
        block.motor_position[i, lane] = block.position[i, lane] + stretch
        block.motor_velocity[i, lane] = block.velocity[i, lane]
        block.motor_friction[i, lane] = 0.0
