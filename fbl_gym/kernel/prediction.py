"""The motion of a model under torques that are on their way, for laws that predict through a delay.

It is the kernel's own physics without friction, so a model that is the real arm predicts its motion
to the last digits.
"""

from fbl_gym.kernel.fastmath import cached_njit, clip, exp, inline_njit
from fbl_gym.kernel.physics import load_on_joints, make_runge_kutta, moved, solve_terms, weighted


@inline_njit
def _stage(q, v, load, constants):
    """Return the acceleration at one stage of a step."""
    lumped, rotor, (push1, push2) = constants
    m11, m12, m22, load1, load2 = load_on_joints(lumped, rotor, q, v, load)
    a1, a2 = solve_terms(m11, m12, m22, load1, load2)
    return a1 + push1, a2 + push2


_runge_kutta = make_runge_kutta(_stage, moved, weighted)


@inline_njit
def _toward(command, torque, keep):
    """Return the torque of which a share `keep` of the gap to the command is left."""
    return command[0] + keep * (torque[0] - command[0]), command[1] + keep * (torque[1] - command[1])


@cached_njit
def predict(arm, push, durations, commands, lag, fastest, motion):
    """Move each lane through some commands, one Runge-Kutta step each.

    Args:
        arm: lumped parameters and rotors [7].
        push: acceleration that is added to the model's [n x 2] rad/s^2.
        durations: of the steps [m] s.
        commands: [m x n x 2] N m.
        lag: time constant with which the torque follows a command [s]; 0: at once.
        fastest: limit of the velocity [rad/s].
        motion: position, velocity and torque [3 x n x 2], which this replaces.
    """
    lumped, rotor = (arm[0], arm[1], arm[2], arm[3], arm[4]), (arm[5], arm[6])
    for k in range(len(durations)):
        h = durations[k]
        start, half, end = (1.0, exp(-0.5 * h / lag), exp(-h / lag)) if lag > 0.0 else (0.0, 0.0, 0.0)
        for lane in range(motion.shape[1]):
            q, v = (motion[0, lane, 0], motion[0, lane, 1]), (motion[1, lane, 0], motion[1, lane, 1])
            torque = motion[2, lane, 0], motion[2, lane, 1]
            command = commands[k, lane, 0], commands[k, lane, 1]
            last = _toward(command, torque, end)
            q, v = _runge_kutta(
                h, q, v, _toward(command, torque, start), _toward(command, torque, half), last,
                (lumped, rotor, (push[lane, 0], push[lane, 1])),
            )  # fmt: skip
            motion[0, lane, 0], motion[0, lane, 1] = q
            motion[1, lane, 0], motion[1, lane, 1] = clip(v[0], fastest), clip(v[1], fastest)
            motion[2, lane, 0], motion[2, lane, 1] = last
