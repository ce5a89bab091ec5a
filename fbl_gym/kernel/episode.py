"""The start of an episode, the reward of a step, and the end of an episode."""

import numpy as np

from fbl_gym.fastmath import exp, kernel_njit, log, sincos
from fbl_gym.kernel.motion import draw_reference, reference, store_reference
from fbl_gym.kernel.physics import lump
from fbl_gym.kernel.torque import nominal_torque, pick_disturbance
from fbl_gym.memory import NORMALIZED, RUNNING, SINE, STEPS, TORQUE
from fbl_gym.streams import stream_key, uniforms

_PARAMETERS = stream_key("parameter error")
_DISTURBANCE = stream_key("disturbance")
_ZERO = np.uint64(0)


@kernel_njit
def start(block, queue, waypoints, settings, tables, lane):
    """Start an episode in a lane: draw its arm and reference, and put the arm on its reference."""
    seed, episode = block.seed[lane], block.episode[lane]
    block.step[lane] = _ZERO
    block.status[lane] = RUNNING
    draws = uniforms(seed, _PARAMETERS, episode, _ZERO, _ZERO)
    for i in range(4):
        draw = draws[0] if settings.drawn_together else draws[i]
        radius = settings.log_radius[i]
        factor = exp((2.0 * draw - 1.0) * radius) if radius > 0.0 else 1.0
        block.parameters[i, lane] = settings.parameters[i] * settings.ratio[i] * factor
    carried = settings.payload_pick_up == 0.0 and settings.payload_drop > 0.0
    block.payload[lane] = settings.payload_mass if carried else 0.0
    lump(block, settings, lane)

    draw_reference(waypoints, settings, tables, lane, seed, episode)
    q1, q2, v1, v2, a1, a2 = reference(waypoints, settings, tables, lane, np.int64(0))
    store_reference(block, lane, (q1, q2, v1, v2, a1, a2))
    if settings.reference_kind == STEPS:  # they jump at once, away from the arm's start
        q1, q2 = waypoints[0, 0, lane], waypoints[0, 1, lane]
    q1, q2 = q1 + settings.initial_error[0], q2 + settings.initial_error[1]
    block.position[0, lane], block.position[1, lane] = q1, q2
    block.start_position[0, lane], block.start_position[1, lane] = q1, q2
    block.velocity[0, lane], block.velocity[1, lane] = v1, v2
    _hold_still(block, queue, settings, lane)

    torque1, torque2 = pick_disturbance(block, settings, tables, lane, np.int64(0))
    if settings.disturbance_kind == SINE:
        phase1, phase2 = settings.disturbance_phase[0], settings.disturbance_phase[1]
        if settings.disturbance_phase_drawn:
            draw1, draw2, _, _ = uniforms(seed, _DISTURBANCE, episode, _ZERO, _ZERO)
            phase1, phase2 = 6.283185307179586 * draw1, 6.283185307179586 * draw2
        block.disturbance_phase[0, lane], block.disturbance_phase[1, lane] = phase1, phase2
        torque1 = settings.disturbance_amplitude[0] * sincos(phase1)[0]
        torque2 = settings.disturbance_amplitude[1] * sincos(phase2)[0]
    block.disturbance[0, lane], block.disturbance[1, lane] = torque1, torque2


@kernel_njit
def _hold_still(block, queue, settings, lane):
    """Apply the torque that holds the nominal arm still at its start, within the limit."""
    block.measured_position[0, lane] = block.position[0, lane]
    block.measured_position[1, lane] = block.position[1, lane]
    block.measured_velocity[0, lane], block.measured_velocity[1, lane] = 0.0, 0.0
    tau1, tau2 = nominal_torque(block, settings, lane, 0.0, 0.0)
    kind = settings.action_kind
    # The box of torque actions has bounds even if the torque has no limit.
    limit = settings.action_limit if kind == TORQUE else settings.torque_limit
    tau1, tau2 = max(min(tau1, limit[0]), -limit[0]), max(min(tau2, limit[1]), -limit[1])
    block.command[0, lane], block.command[1, lane] = tau1, tau2
    block.torque[0, lane], block.torque[1, lane] = tau1, tau2
    for age in range(settings.delay_steps + 1):
        queue[age, 0, lane], queue[age, 1, lane] = tau1, tau2
    action1, action2 = 0.0, 0.0  # no acceleration
    if kind == NORMALIZED:
        action1, action2 = tau1 / limit[0], tau2 / limit[1]
    elif kind == TORQUE:
        action1, action2 = tau1, tau2
    block.action[0, lane], block.action[1, lane] = action1, action2


@kernel_njit
def judge(block, settings, width):
    """Compute the rewards of a block (see `reward.py`), and the ends of its episodes.

    An episode is terminated when the arm leaves its limits or its numbers are not finite, and
    truncated when its time is up.
    """
    limit1, limit2 = settings.torque_limit[0], settings.torque_limit[1]
    logarithmic, last = settings.reward_logarithmic, np.uint64(settings.last_step)
    max_position, max_velocity = settings.max_position, settings.max_velocity
    for lane in range(width):
        q1, q2 = block.position[0, lane], block.position[1, lane]
        stays = (
            (abs(q1 - block.start_position[0, lane]) <= max_position)
            & (abs(q2 - block.start_position[1, lane]) <= max_position)
            & (abs(block.velocity[0, lane]) <= max_velocity)
            & (abs(block.velocity[1, lane]) <= max_velocity)
        )
        error = abs(block.reference_position[0, lane] - q1) + abs(block.reference_position[1, lane] - q2)
        tracking = settings.reward_scale * error
        logarithm = settings.reward_norm * log(1.0 + tracking)
        tracking = logarithm if logarithmic else tracking
        effort = 0.5 * (abs(block.command[0, lane]) / limit1 + abs(block.command[1, lane]) / limit2)
        chatter = 0.25 * block.chatter[lane]
        loss = (
            settings.weight_tracking * min(tracking, 1.0)
            + settings.weight_effort * effort
            + settings.weight_chatter * chatter
        )
        block.reward[lane] = max(1.0 - loss, 0.0) if stays else 0.0
        block.terminated[lane] = 0.0 if stays else 1.0
        block.truncated[lane] = 1.0 if stays & (block.step[lane] >= last) else 0.0
