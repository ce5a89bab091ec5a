"""What `batch.py` calls, compiled once and kept on disk.

Numba notices a change in the file of a cached function, but not in the files of the functions that it calls. So each door
below closes over a fingerprint of all the sources it is compiled from; Numba makes that part of the cache's key.
"""

import hashlib
from pathlib import Path

import numpy as np

from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, kept, merged
from fbl_gym.kernel.episode import judge, start
from fbl_gym.kernel.motion import refer
from fbl_gym.kernel.physics import acceleration_and_friction, advance, carry_payload
from fbl_gym.kernel.readings import observe, sense
from fbl_gym.kernel.torque import apply_torque, command, nominal_acceleration
from fbl_gym.settings import ENDED, EPISODE, LANES, RESTART, REWARD, STEP, TERMINATED, TRUNCATED

_SOURCES = ("arm.py", "fastmath.py", "friction.py", "settings.py", "streams.py", "kernel/*.py")
_ZERO, _ONE = np.int64(0), np.uint64(1)


def _fingerprint() -> int:
    folder = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(folder.glob(pattern)):
            digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


@compiled
def _check(x):
    given, state, length, n = int(x[at.GIVEN]), int(x[at.STATE]), int(x[at.BLOCK]), int(x[at.COUNT])
    for i in range(n):
        if not (np.isfinite(x[given + 2 * i]) and np.isfinite(x[given + 2 * i + 1])):
            return 2 * i
    if x[at.AUTORESET] != at.NEXT_STEP:
        for i in range(n):
            if x[state + i // LANES * length + ENDED + i % LANES] != 0.0:
                return 2 * i + 1
    return -1


@merged
def _move(b, clock, x, first, count, width):
    """One control interval of a block, its readings, and what it is worth."""
    command(b, x, x[int(x[at.GIVEN]) + 2 * first :], count)
    varies, loaded = x[at.VARIES] != 0.0, x[at.LOAD_MASS] != 0.0
    for substep in range(int(x[at.SUBSTEPS])):
        if substep == 0 or varies:
            apply_torque(b, clock, x, width, substep)
        if loaded:
            carry_payload(b, clock, x, width, substep)
        advance(b, x, width)
    for l in range(LANES):
        clock[STEP + l] += _ONE
    sense(b, clock, x, width)
    refer(b, clock, x, width)
    judge(b, clock, x, width)


@merged
def _conclude(b, clock, x, first, count):
    """Note what the caller is told of a block's lanes, and mark those that start another episode now."""
    autoreset, rewards, n = int(x[at.AUTORESET]), int(x[at.REWARDS]), int(x[at.COUNT])
    flags = x[int(x[at.FLAGS]) :].view(np.uint8)
    for l in range(count):
        over = b[TERMINATED + l] + b[TRUNCATED + l] != 0.0
        restarts = over and autoreset == at.SAME_STEP
        if restarts:
            observe(b, clock, x, x[int(x[at.LASTS]) + first * int(x[at.SIZE]) :], l, l + 1)
        elif autoreset == at.NEXT_STEP and b[ENDED + l] != 0.0:
            b[REWARD + l], b[TERMINATED + l], b[TRUNCATED + l] = 0.0, 0.0, 0.0
            restarts = True
        b[ENDED + l] = 1.0 if over else 0.0
        if restarts:
            clock[EPISODE + l] += _ONE
            b[ENDED + l] = RESTART
        x[rewards + first + l] = b[REWARD + l]
        flags[first + l], flags[n + first + l] = b[TERMINATED + l] != 0.0, b[TRUNCATED + l] != 0.0


def _doors(fingerprint):
    @kept
    def step(x, out, part, parts):
        """One control interval of every lane, if `check` has nothing against it; or, of no parts, no time at all. Then an
        episode starts in every lane that is marked with RESTART.

        x: a batch's memory, see `settings.py`; out: takes the observations [n * size]. Of several parts of the lanes, which
        can be stepped at the same time, only one is stepped, and that without a check. Returns what `check` does; and the
        reward of the first lane, and whether its episode is terminated, and truncated.
        """
        _ = fingerprint
        if parts == 1:
            found = _check(x)
            if found >= 0:
                return found, 0.0, False, False
        moves, parts = parts > 0, max(parts, 1)
        n, length, state = int(x[at.COUNT]), int(x[at.BLOCK]), int(x[at.STATE])
        blocks = (n + LANES - 1) // LANES
        for block in range(blocks * part // parts, blocks * (part + 1) // parts):
            b = x[state + block * length : state + (block + 1) * length]
            clock = b.view(np.uint64)
            first = block * LANES
            count = min(LANES, n - first)
            # Few lanes pay for half a block, which is a vector too; one lane pays for itself.
            width = 1 if count == 1 else (LANES // 2 if count <= LANES // 2 else LANES)
            if moves:
                _move(b, clock, x, first, count, width)
                _conclude(b, clock, x, first, count)
            started = False
            for l in range(LANES):
                if b[ENDED + l] == RESTART:
                    start(b, clock, l, x)
                    started = True
            if started:
                sense(b, clock, x, width)
            observe(b, clock, x, out[first * int(x[at.SIZE]) :], _ZERO, count)
        flags = x[int(x[at.FLAGS]) :].view(np.uint8)
        return -1, x[int(x[at.REWARDS])], flags[0] != 0, flags[n] != 0

    @kept
    def check(x):
        """-1 if all lanes can be stepped. Else 2 i, if lane i is the first whose action is not finite, or 2 i + 1, if all
        are, and lane i is the first whose episode is over."""
        _ = fingerprint
        return _check(x)

    @kept
    def inspect(x, out):
        """The truth of each lane, [n x TRUE_COLUMNS] in the order of `settings.TRUE`."""
        _ = fingerprint
        length, state, friction = int(x[at.BLOCK]), int(x[at.STATE]), int(x[at.FRICTION])
        for i in range(len(out)):
            b, l = x[state + i // LANES * length : state + (i // LANES + 1) * length], i % LANES
            column = 0
            for first, count in at.TRUE_ROWS:
                for row in range(count):
                    out[i, column] = b[first + LANES * row + l]
                    column += 1
            out[i, column] = float(np.int64(b.view(np.uint64)[STEP + l])) * x[at.CONTROL_DT]
            a1, a2, f1, f2 = acceleration_and_friction(b, l, x, friction)
            out[i, column + 1], out[i, column + 2], out[i, column + 3], out[i, column + 4] = a1, a2, f1, f2
            e1, e2 = nominal_acceleration(b, l, x)
            out[i, column + 5], out[i, column + 6] = e1 - a1, e2 - a2

    return step, check, inspect


step, check, inspect = _doors(_fingerprint())
