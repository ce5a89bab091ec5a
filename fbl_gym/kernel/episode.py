"""How an episode starts, what a step of it is worth, and when it is over."""

import numpy as np

from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, exp, log, sincos
from fbl_gym.kernel.motion import draw_reference, reference
from fbl_gym.kernel.physics import lump
from fbl_gym.kernel.torque import nominal_torque, pick_disturbance
from fbl_gym.settings import (
    ACTION1, ACTION2, CHATTER, D1, D2, ENDED, EPISODE, LANES, LOAD, M1, PAIR, PHASE1, PHASE2, Q1, Q2, QUEUE, R1, R2, R3, R4,
    R5, R6, REWARD, SEED, START1, START2, STEP, T1, T2, TERMINATED, TRUNCATED, U1, U2, V1, V2, Y1, Y2, Y3, Y4,
)  # fmt: skip
from fbl_gym.streams import stream_key, uniforms

_PARAMETERS = stream_key("parameter error")
_DISTURBANCE = stream_key("disturbance")
_NONE = np.uint64(0)


@compiled
def start(b, clock, l, x):
    """Draw a lane's arm and motion, and put the arm on its reference."""
    seed, episode = clock[SEED + l], clock[EPISODE + l]
    clock[STEP + l] = _NONE
    b[ENDED + l] = 0.0
    draws = uniforms(seed, _PARAMETERS, episode, _NONE, _NONE)
    for i in range(4):
        draw = draws[0] if x[at.TOGETHER] != 0.0 else draws[i]
        factor = exp((2.0 * draw - 1.0) * x[at.LOG_RADIUS + i]) if x[at.LOG_RADIUS + i] > 0.0 else 1.0
        b[M1 + LANES * i + l] = x[at.ARM_M1 + i] * x[at.RATIO + i] * factor
    b[LOAD + l] = x[at.LOAD_MASS] if x[at.LOAD_ON] == 0.0 and x[at.LOAD_OFF] > 0.0 else 0.0
    lump(b, l, x)
    draw_reference(b, l, x, seed, episode)
    r1, r2, r3, r4, r5, r6 = reference(b, l, x, np.int64(0))
    b[R1 + l], b[R2 + l], b[R3 + l] = r1, r2, r3
    b[R4 + l], b[R5 + l], b[R6 + l] = r4, r5, r6
    if x[at.REFERENCE] == at.STEPS:  # they jump at once, away from where the arm is
        row = int(x[at.REFERENCE_ROW])
        r1, r2 = b[row + l], b[row + LANES + l]
    start1, start2 = r1 + x[at.INITIAL_ERROR], r2 + x[at.INITIAL_ERROR + 1]
    b[Q1 + l], b[Q2 + l] = start1, start2
    b[START1 + l], b[START2 + l] = start1, start2
    b[V1 + l], b[V2 + l] = r3, r4
    _hold_still(b, l, x)
    d1, d2 = pick_disturbance(clock, l, x, np.int64(0))
    if x[at.DISTURBANCE] == at.SINE:
        b[PHASE1 + l], b[PHASE2 + l] = x[at.PUSH_PHASE], x[at.PUSH_PHASE + 1]
        if x[at.PUSH_DRAWN] != 0.0:
            a, c, _, _ = uniforms(seed, _DISTURBANCE, episode, _NONE, _NONE)
            b[PHASE1 + l], b[PHASE2 + l] = 6.283185307179586 * a, 6.283185307179586 * c
        d1, d2 = x[at.PUSH] * sincos(b[PHASE1 + l])[0], x[at.PUSH + 1] * sincos(b[PHASE2 + l])[0]
    b[D1 + l], b[D2 + l] = d1, d2


@compiled
def _hold_still(b, l, x):
    """Before the first action, the torque that holds the nominal arm still where it starts, within the limit."""
    b[Y1 + l], b[Y2 + l] = b[Q1 + l], b[Q2 + l]
    b[Y3 + l], b[Y4 + l] = 0.0, 0.0
    u1, u2 = nominal_torque(b, l, x, 0.0, 0.0)
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    if x[at.ACTION] == at.TORQUE:  # an unlimited arm's box of torques has bounds all the same
        limit1, limit2 = x[at.ACTION_LIMIT], x[at.ACTION_LIMIT + 1]
    u1, u2 = max(min(u1, limit1), -limit1), max(min(u2, limit2), -limit2)
    b[U1 + l], b[U2 + l] = u1, u2
    b[T1 + l], b[T2 + l] = u1, u2
    for age in range(int(x[at.QUEUE_DEPTH]) + 1):
        b[QUEUE + PAIR * age + l], b[QUEUE + PAIR * age + LANES + l] = u1, u2
    mode = int(x[at.ACTION])
    b[ACTION1 + l], b[ACTION2 + l] = 0.0, 0.0  # no acceleration
    if mode == at.FRACTION:
        b[ACTION1 + l], b[ACTION2 + l] = u1 / limit1, u2 / limit2
    elif mode == at.TORQUE:
        b[ACTION1 + l], b[ACTION2 + l] = u1, u2


@compiled
def judge(b, clock, x, width):
    """Of each lane of a block: its reward (see `reward.py`), and whether its episode is over: terminated where the arm has
    left its limits (or the numbers), truncated when time is up."""
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    logarithmic, last = x[at.REWARD_LOG] != 0.0, np.uint64(x[at.LAST_STEP])
    for l in range(width):
        q1, q2 = b[Q1 + l], b[Q2 + l]
        stays = (
            (abs(q1 - b[START1 + l]) <= x[at.MAX_POSITION])
            & (abs(q2 - b[START2 + l]) <= x[at.MAX_POSITION])
            & (abs(b[V1 + l]) <= x[at.MAX_VELOCITY])
            & (abs(b[V2 + l]) <= x[at.MAX_VELOCITY])
        )
        tracking = x[at.REWARD_SCALE] * (abs(b[R1 + l] - q1) + abs(b[R2 + l] - q2))
        logarithm = x[at.REWARD_NORM] * log(1.0 + tracking)
        tracking = logarithm if logarithmic else tracking
        effort = 0.5 * (abs(b[U1 + l]) / limit1 + abs(b[U2 + l]) / limit2)
        chatter = 0.25 * b[CHATTER + l]
        loss = x[at.W_TRACKING] * min(tracking, 1.0) + x[at.W_EFFORT] * effort + x[at.W_CHATTER] * chatter
        b[REWARD + l] = max(1.0 - loss, 0.0) if stays else 0.0
        b[TERMINATED + l] = 0.0 if stays else 1.0
        b[TRUNCATED + l] = 1.0 if stays & (clock[STEP + l] >= last) else 0.0
