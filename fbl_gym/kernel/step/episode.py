"""The start of an episode, the reward of a step, and the end of an episode."""

import numpy as np

from fbl_gym.kernel.arm.physics import lump
from fbl_gym.kernel.maths.fastmath import clip, exp, inline_njit, kernel_njit, larger, log, rint, smaller
from fbl_gym.kernel.maths.streams import stream_key, uniforms
from fbl_gym.kernel.memory import layout
from fbl_gym.kernel.memory.views import pair, put
from fbl_gym.kernel.step.motion import draw_reference, reference, store_reference
from fbl_gym.kernel.step.torque import nominal_torque, ripple_of

_PARAMETERS = stream_key("parameter error")
_ZERO = np.uint64(0)


@kernel_njit
def start(block, rows, queue, waypoints, settings, tables, lane):
    """Start an episode in a lane: draw its arm and reference, and put the arm on its reference."""
    seed, episode = block.seed[lane], _ZERO if settings.drawn_per_seed else block.episode[lane]
    block.step[lane] = _ZERO
    block.status[lane] = layout.RUNNING
    draws = uniforms(seed, _PARAMETERS, episode, _ZERO, _ZERO)
    for i in range(4):
        draw = draws[0] if settings.drawn_together else draws[i]
        radius = settings.log_radius[i]
        factor = exp((2.0 * draw - 1.0) * radius) if radius > 0.0 else 1.0
        block.parameters[i, lane] = settings.parameters[i] * settings.ratio[i] * factor
    _draw(block, rows, settings, tables, lane, episode)
    carried = block.payload_pick_up[lane] == 0.0 and block.payload_drop[lane] > 0.0
    block.held_payload[lane] = block.payload_mass[lane] if carried else 0.0
    block.payload[lane] = block.held_payload[lane]
    lump(block, settings, lane)

    draw_reference(block, waypoints, settings, tables, lane, seed, episode, block.given_reference[lane] == 1.0)
    q1, q2, v1, v2, a1, a2 = reference(block, waypoints, settings, tables, lane, np.int64(0))
    store_reference(block, lane, (q1, q2, v1, v2, a1, a2))
    if settings.reference_kind == layout.STEPS:  # they jump at once, away from the arm's start
        q1, q2 = pair(waypoints[0], lane)
    (error1, error2), (more1, more2) = pair(block.initial_error, lane), pair(block.initial_velocity, lane)
    if more1 != 0.0 or more2 != 0.0:  # else keep the sign of -0.0
        v1, v2 = v1 + more1, v2 + more2
    q1, q2 = _given(block.given_position, lane, (q1 + error1, q2 + error2))
    put(block.position, lane, (q1, q2))
    put(block.start_position, lane, (q1, q2))
    put(block.velocity, lane, _given(block.given_velocity, lane, (v1, v2)))
    block.given_reference[lane] = 0.0
    _hold_still(block, rows, queue, settings, lane)
    block.far[lane] = 0.0


@inline_njit
def _given(rows, lane, values):
    """Return what is given for the start of this episode alone, else other values."""
    given1, given2 = pair(rows, lane)
    put(rows, lane, (np.nan, np.nan))
    return values[0] if given1 != given1 else given1, values[1] if given2 != given2 else given2


@kernel_njit
def _draw(block, rows, settings, tables, lane, episode):
    """Set the numbers that may vary to their fixed values, or to draws from their streams."""
    for i in range(len(settings.varied)):
        rows[layout.FIRST_VARIED + i, lane] = settings.varied[i]
    for i in range(settings.draws):
        index = settings.draw_table + layout.DRAW_SIZE * i
        key = np.uint64(tables[index + 5]) << np.uint64(32) | np.uint64(tables[index + 6])
        joint, kind = np.uint64(tables[index + 1]), tables[index + 2]
        draw, _, _, _ = uniforms(block.seed[lane], key, episode, _ZERO, joint)
        first, second = tables[index + 3], tables[index + 4]
        value = first + draw * (second - first)
        if kind == layout.LOG_UNIFORM:
            value = first * exp(draw * second)
        elif kind == layout.CHOICE:
            value = tables[int(first) + int(draw * second)]
        rows[int(tables[index]), lane] = value
    for i in range(settings.events):
        row = settings.event_row + layout.EVENT_ROWS * i
        rows[row, lane] = rint(rows[row, lane])
    block.payload_pick_up[lane] = rint(block.payload_pick_up[lane])
    block.payload_drop[lane] = rint(block.payload_drop[lane])
    block.delay[lane] = rint(block.delay[lane]) + settings.substeps * rint(block.delay_samples[lane])
    lag = block.lag[lane]
    begin = 1.0 if lag > 0.0 else 0.0
    end = exp(-1.0 / lag) if lag > 0.0 else 0.0
    # Runge-Kutta's weights 1/6, 4/6, 1/6 give the exact impulse of an exponential, however short.
    half = 0.25 * (6.0 * lag * (1.0 - end) - begin - end)
    block.fade[0, lane], block.fade[1, lane], block.fade[2, lane] = begin, half, end


@kernel_njit
def _hold_still(block, rows, queue, settings, lane):
    """Apply the torque that holds the nominal arm still at its start, within the limit."""
    put(block.measured[0], lane, pair(block.position, lane))
    put(block.measured[1], lane, (0.0, 0.0))
    tau1, tau2 = nominal_torque(block, settings, lane, 0.0, 0.0)
    kind = settings.action_kind
    # The box of torque actions has bounds even if the torque has no limit.
    limit = settings.action_limit if kind == layout.TORQUE else settings.torque_limit
    tau1, tau2 = clip(tau1, limit[0]), clip(tau2, limit[1])
    put(block.command, lane, (tau1, tau2))
    put(block.target, lane, (tau1, tau2))
    put(block.lagged, lane, (tau1, tau2))
    block.late[lane] = 0.0
    gain1, gain2 = pair(block.gain, lane)
    put(block.torque, lane, (gain1 * tau1, gain2 * tau2))
    if settings.rippled:
        put(block.motor_position, lane, pair(block.position, lane))  # until `start_motors` winds the springs
        put(block.motor_velocity, lane, pair(block.velocity, lane))
        for joint in range(2):
            block.torque[joint, lane] += ripple_of(block, settings, lane, joint)
    for age in range(settings.delay_steps + 1):
        put(queue[age], lane, (tau1, tau2))
        queue[age, 2, lane] = 0.0
    action1, action2 = 0.0, 0.0  # no acceleration
    if kind == layout.NORMALIZED:
        action1, action2 = tau1 / settings.torque_scale[0], tau2 / settings.torque_scale[1]
    elif kind == layout.TORQUE:
        action1, action2 = tau1, tau2
    put(block.action, lane, (action1, action2))
    for row in range(settings.past_row, settings.past_row + 2 * settings.past_actions, 2):
        rows[row, lane], rows[row + 1, lane] = action1, action2


@kernel_njit
def judge(block, settings, width):
    """Compute rewards (see `reward.py`) and costs of a block, and the ends of its episodes.

    An episode is terminated when the arm leaves its limits, violates a constraint that ends it, or
    has numbers that are not finite. It is truncated when its time is up. It can be both.
    """
    # Stores to the block keep the compiler from moving these out of the loop.
    (low1, low2), (high1, high2) = settings.constraint_low, settings.constraint_high
    (bound1, bound2), ends = settings.constraint_velocity, settings.violation_ends
    farthest, fastest = settings.max_position, settings.max_velocity
    logarithmic, scale, norm = settings.reward_logarithmic, settings.reward_scale, settings.reward_norm
    (scale1, scale2), (weight1, weight2, weight3) = settings.torque_scale, settings.reward_weights
    last = np.uint64(settings.last_step)
    for lane in range(width):
        (q1, q2), (v1, v2) = pair(block.position, lane), pair(block.velocity, lane)
        (r1, r2), (start1, start2) = pair(block.reference_position, lane), pair(block.start_position, lane)
        block.judged[0, lane], block.judged[1, lane] = r1 - q1, r2 - q2
        error1, error2 = abs(r1 - q1), abs(r2 - q2)
        block.far[lane] = block.far[lane] + 1.0 if larger(error1, error2) > settings.max_error else 0.0
        keeps = (low1 <= q1) & (q1 <= high1) & (abs(v1) <= bound1) & (low2 <= q2) & (q2 <= high2) & (abs(v2) <= bound2)
        near = (abs(q1 - start1) <= farthest) & (abs(q2 - start2) <= farthest)  # False for NaN
        near = near & (abs(v1) <= fastest) & (abs(v2) <= fastest)
        stays = near & (block.far[lane] < settings.error_steps) & (keeps | (not ends))
        tau1, tau2 = pair(block.command, lane)
        block.judged[2, lane], block.judged[3, lane] = tau1, tau2
        effort = 0.5 * (abs(tau1) / scale1 + abs(tau2) / scale2)
        chatter = 0.25 * block.chatter[lane]
        linear = scale * (error1 + error2)
        logarithm = norm * log(1.0 + linear)
        tracking = smaller(logarithm if logarithmic else linear, 1.0)
        loss = weight1 * tracking + weight2 * effort + weight3 * chatter
        block.cost[lane] = 0.0 if keeps else 1.0
        block.reward[lane] = larger(1.0 - loss, 0.0) if stays else 0.0
        block.terminated[lane] = 0.0 if stays else 1.0
        block.truncated[lane] = 1.0 if block.step[lane] >= last else 0.0
