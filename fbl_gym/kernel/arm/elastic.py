"""The motion of an arm with elastic joints over one physics step; see `options/joints.py`."""

from fbl_gym.kernel.arm import physics
from fbl_gym.kernel.arm.friction import shrink, sign
from fbl_gym.kernel.maths.fastmath import clip, inline_njit, kernel_njit, over_lanes
from fbl_gym.kernel.memory.views import pair, put


@inline_njit
def _spring(stiffness, damping, gap, stretch, rate):
    """Return a spring's torque on the link; `gap` is half the backlash, beyond which teeth push."""
    torque = stiffness * shrink(stretch, gap) + (damping * rate if abs(stretch) >= gap else 0.0)
    pulls = (gap > 0.0) & (torque * stretch < 0.0)
    return 0.0 if pulls else torque


@inline_njit
def _load_on_motors(x, v, tau, joint, friction):
    """Return the springs' torque on the links, and the torque left to the motors' dry friction."""
    k1, k2, d1, d2, gap1, gap2, _, _ = joint
    viscous1, viscous2 = friction[0]
    ((q1, q2), (th1, th2)), ((v1, v2), (w1, w2)), (tau1, tau2) = x, v, tau
    spring1 = _spring(k1, d1, gap1, th1 - q1, w1 - v1)
    spring2 = _spring(k2, d2, gap2, th2 - q2, w2 - v2)
    return spring1, spring2, tau1 - spring1 - viscous1 * w1, tau2 - spring2 - viscous2 * w2


@inline_njit
def turn_motors(x, v, tau, joint, friction, held):
    """Return the springs' torque on the links, and the acceleration of the motors, two of each.

    Args:
        x: positions of links and motors, two of each.
        v: their velocities.
        tau: torques of the drives.
        joint: stiffness, damping, half the backlash and rotor inertia, both joints of each.
        friction: as of `physics.friction_of`.
        held: dry friction as of `hold_motors`.
    """
    dry1, dry2, free1, free2, _, _ = held
    spring1, spring2, left1, left2 = _load_on_motors(x, v, tau, joint, friction)
    return (spring1, spring2), (free1 * (left1 - dry1) / joint[6], free2 * (left2 - dry2) / joint[7])


@inline_njit
def _stage(x, v, load, constants):
    """Return the accelerations of links and motors at one stage of a physics step.

    Args:
        x: positions of links and motors, two of each.
        v: their velocities.
        load: torques on the links, and those of the drives.
        constants: lumped parameters of the links, then as for `turn_motors`.
    """
    lumped, joint, friction, held = constants
    (load1, load2), tau = load
    (spring1, spring2), b = turn_motors(x, v, tau, joint, friction, held)
    torque = spring1 + load1, spring2 + load2
    return physics.solve_terms(*physics.load_on_joints(lumped, (0.0, 0.0), x[0], v[0], torque)), b


@inline_njit
def moved_both(x, h, rate):
    """Return x + h rate of links and motors."""
    return physics.moved(x[0], h, rate[0]), physics.moved(x[1], h, rate[1])


@inline_njit
def weighted_both(a, b, c, d):
    """Return a + 2 (b + c) + d of links and motors."""
    return physics.weighted(a[0], b[0], c[0], d[0]), physics.weighted(a[1], b[1], c[1], d[1])


_runge_kutta = physics.make_runge_kutta(_stage, moved_both, weighted_both)


@inline_njit
def joint_of(block, settings, lane):
    """Return the joints' constants, as `turn_motors` takes them."""
    inertia = physics.rotor_of(block, settings, lane)
    (k1, k2), (d1, d2), (b1, b2) = pair(block.stiffness, lane), pair(block.damping, lane), pair(block.backlash, lane)
    return k1, k2, d1, d2, 0.5 * b1, 0.5 * b2, inertia[0], inertia[1]


@inline_njit
def both(links, motors, lane):
    """Return a lane's numbers of the links and of the motors, two of each."""
    return pair(links, lane), pair(motors, lane)


@inline_njit
def _stick(h, w, load, bound, inertia):
    """Return a motor's dry friction over a step, 0 if it sticks, and 0 if it ends at rest.

    Motors are not coupled: each solves B w+ = B w + h (load - f), |f| <= bound, by itself.
    """
    momentum = inertia * w + h * load
    left = shrink(momentum, h * bound)
    rest = (left == 0.0) & (bound > 0.0)
    return (momentum - left) / h, 0.0 if rest & (w == 0.0) else 1.0, 0.0 if rest else 1.0


@inline_njit
def hold_motors(x, v, tau, joint, friction, h):
    """Return the motors' exact friction over a physics step h, as `physics.py` does for links."""
    (_, _, left1, left2), (w1, w2) = _load_on_motors(x, v, tau, joint, friction), v[1]
    bound1, bound2 = physics.dry_bounds(v[1], friction)
    dry1, free1, moves1 = _stick(h, w1, left1, bound1, joint[6])
    dry2, free2, moves2 = _stick(h, w2, left2, bound2, joint[7])
    return dry1, dry2, free1, free2, moves1, moves2


@inline_njit
def _advance(block, settings, lane):
    """Advance one lane by one physics step."""
    joint, friction, h = joint_of(block, settings, lane), physics.friction_of(block, lane), settings.physics_dt
    x = both(block.position, block.motor_position, lane)
    v = both(block.velocity, block.motor_velocity, lane)
    held = hold_motors(x, v, pair(block.tau[0], lane), joint, friction, h)
    (q, th), (v, (w1, w2)) = _runge_kutta(
        h, x, v, both(block.load[0], block.tau[0], lane), both(block.load[1], block.tau[1], lane),
        both(block.load[2], block.tau[2], lane), (physics.lumped_of(block, lane), joint, friction, held),
    )  # fmt: skip
    put(block.position, lane, q)
    put(block.velocity, lane, v)
    put(block.motor_position, lane, th)
    put(block.motor_velocity, lane, (w1 if held[4] != 0.0 else 0.0, w2 if held[5] != 0.0 else 0.0))


advance_elastic = over_lanes(_advance)


@inline_njit
def elastic_acceleration_and_friction(block, settings, lane):
    """Return the links' acceleration now, and the friction torque of the motors, two of each."""
    x = both(block.position, block.motor_position, lane)
    v = both(block.velocity, block.motor_velocity, lane)
    tau, (push1, push2) = pair(block.torque, lane), pair(block.disturbance, lane)
    joint, friction = joint_of(block, settings, lane), physics.friction_of(block, lane)
    constants = physics.lumped_of(block, lane), joint, friction, physics.FREE
    a, b = _stage(x, v, ((-push1, -push2), tau), constants)
    return *a, *motor_friction(v[1], b, joint, friction)


@inline_njit
def motor_friction(w, b, joint, friction):
    """Return the motors' friction torque from their velocities, and accelerations without it."""
    (w1, w2), (b1, b2), (bound1, bound2) = w, b, physics.dry_bounds(w, friction)
    # A turning motor has its friction; one at rest has the torque that holds it, up to breakaway.
    dry1 = bound1 * sign(w1) if w1 != 0.0 else clip(joint[6] * b1, bound1)
    dry2 = bound2 * sign(w2) if w2 != 0.0 else clip(joint[7] * b2, bound2)
    return friction[0][0] * w1 + dry1, friction[0][1] * w2 + dry2


@kernel_njit
def start_motors(block, settings, lane):
    """Put the motors of a lane to where the springs carry the torque of the drives."""
    for i in range(2):
        inertia, rate = settings.stretched_inertia[i], block.stiffness[i, lane]
        if inertia > 0.0:  # until now the row has a natural frequency [rad/s]
            block.stiffness[i, lane] = inertia * (rate * rate)
        tau = block.torque[i, lane]
        stretch = tau / block.stiffness[i, lane] + 0.5 * block.backlash[i, lane] * sign(tau)
        block.motor_position[i, lane] = block.position[i, lane] + stretch
        block.motor_velocity[i, lane] = block.velocity[i, lane]
