"""What `batch.py` calls, compiled once and kept on disk.

Numba notices a change in the file of a cached function, but not in the files of the functions that it calls. So each door
below closes over a fingerprint of all the sources it is compiled from; Numba makes that part of the cache's key.
"""

import hashlib
from pathlib import Path

import numpy as np
from numba import njit

from fbl_gym import settings as at
from fbl_gym.elementary import COMPILED, compiled
from fbl_gym.kernel.episode import judge, start
from fbl_gym.kernel.motion import refer
from fbl_gym.kernel.physics import acceleration_and_friction, advance, carry_payload
from fbl_gym.kernel.readings import observe, sense
from fbl_gym.kernel.torque import apply_torque, command
from fbl_gym.settings import ENDED, EPISODE, LANES, REWARD, STEP, TERMINATED, TRUNCATED

_SOURCES = ("arm.py", "elementary.py", "friction.py", "settings.py", "streams.py", "kernel/*.py")
_ZERO, _ONE = np.int64(0), np.uint64(1)


def _fingerprint() -> int:
    folder = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(folder.glob(pattern)):
            digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


@compiled
def _check(state, x, actions):
    size, n = int(x[at.ROWS]) * LANES, len(actions) // 2
    for i in range(n):
        if not (np.isfinite(actions[2 * i]) and np.isfinite(actions[2 * i + 1])):
            return 2 * i
    if x[at.AUTORESET] != at.NEXT_STEP:
        for i in range(n):
            if state[i // LANES * size + ENDED * LANES + i % LANES] != 0.0:
                return 2 * i + 1
    return -1


def _doors(fingerprint):
    @njit(nogil=True, cache=True, **COMPILED)
    def reset(state, x, mask, out):
        """Start an episode in each lane of `mask`; write the observations of the first lanes to `out`, as far as it goes.

        `mask` may reach beyond the batch, to the lanes of the last block that no environment uses.
        """
        _ = fingerprint
        size, width = int(x[at.ROWS]) * LANES, int(x[at.SIZE])
        lanes = len(out) // width
        for block in range((len(mask) + LANES - 1) // LANES):
            b = state[block * size : (block + 1) * size]
            clock = b.view(np.uint64)
            first = block * LANES
            for l in range(min(LANES, len(mask) - first)):
                if mask[first + l]:
                    start(b, clock, l, x)
            sense(b, clock, x)
            observe(b, clock, x, out[first * width :], _ZERO, min(LANES, lanes - first))

    @njit(nogil=True, cache=True, **COMPILED)
    def check(state, x, actions):
        """-1 if all lanes can be stepped. Else 2 i, if lane i is the first whose action is not finite, or 2 i + 1, if all
        are, and lane i is the first whose episode is over."""
        _ = fingerprint
        return _check(state, x, actions)

    @njit(nogil=True, cache=True, **COMPILED)
    def step(state, x, actions, out, final, part, parts):
        """One control interval of every lane, if `check` has nothing against it; returns what `check` does.

        actions: two numbers a lane; out, final: the observations returned, and those of episodes that ended where SAME_STEP
        has already started the next. Of several parts of the lanes, which can be stepped at the same time, only one is
        stepped, and that without a check.
        """
        _ = fingerprint
        if parts == 1:
            found = _check(state, x, actions)
            if found >= 0:
                return found
        size, width, autoreset = int(x[at.ROWS]) * LANES, int(x[at.SIZE]), int(x[at.AUTORESET])
        n = len(actions) // 2
        blocks = (n + LANES - 1) // LANES
        for block in range(blocks * part // parts, blocks * (part + 1) // parts):
            b = state[block * size : (block + 1) * size]
            clock = b.view(np.uint64)
            first = block * LANES
            count = min(LANES, n - first)

            # What all lanes do.
            command(b, x, actions, first, count)
            varies, loaded = x[at.VARIES] != 0.0, x[at.LOAD_MASS] != 0.0
            for substep in range(int(x[at.SUBSTEPS])):
                if substep == 0 or varies:
                    apply_torque(b, clock, x, substep)
                if loaded:
                    carry_payload(b, clock, x, substep)
                # A single environment pays for half a block.
                advance(b, x, LANES if count > LANES // 2 else LANES // 2)
            for l in range(LANES):
                clock[STEP * LANES + l] += _ONE
            sense(b, clock, x)
            refer(b, clock, x)

            # What each lane's episode makes of it.
            judge(b, clock, x)
            started = False
            for l in range(count):
                over = b[TERMINATED * LANES + l] + b[TRUNCATED * LANES + l] != 0.0
                next_now = over and autoreset == at.SAME_STEP
                if next_now:
                    observe(b, clock, x, final[first * width :], l, l + 1)
                elif autoreset == at.NEXT_STEP and b[ENDED * LANES + l] != 0.0:
                    b[REWARD * LANES + l], b[TERMINATED * LANES + l], b[TRUNCATED * LANES + l] = 0.0, 0.0, 0.0
                    next_now = True
                b[ENDED * LANES + l] = 1.0 if over else 0.0
                if next_now:
                    clock[EPISODE * LANES + l] += _ONE
                    start(b, clock, l, x)
                    started = True
            if started:
                sense(b, clock, x)
            observe(b, clock, x, out[first * width :], _ZERO, count)
        return -1

    @njit(nogil=True, cache=True, **COMPILED)
    def inspect(state, x, lanes, out):
        """The true acceleration and friction torque of each lane, [n x 4], for plots and checks."""
        _ = fingerprint
        size = int(x[at.ROWS]) * LANES
        friction = int(x[at.FRICTION])
        for i in range(lanes):
            block, l = i // LANES, i % LANES
            b = state[block * size : (block + 1) * size]
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = acceleration_and_friction(b, l, x, friction)

    return reset, check, step, inspect


reset, check, step, inspect = _doors(_fingerprint())
