"""A batch of arms: the memory that the kernel works on, and what can be done to it.

Both environments are a thin layer over this: the single one is a batch of one lane.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fbl_gym import settings
from fbl_gym.arm import Array
from fbl_gym.kernel import api
from fbl_gym.settings import LANES, Program

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """What no policy may know: the real arm at this instant. For plots, checks and the oracle.

    Every field is [2] for a single environment and [n x 2] for a batch, unless said otherwise. Where a disturbance's level or
    the payload changes at this very instant, what is told after a step is still what was in force until now.

    Args:
        time: since the episode's start [s]; a number, or [n].
        position, velocity, acceleration: [rad], [rad/s], [rad/s^2].
        reference, reference_velocity, reference_acceleration: the motion asked for now.
        applied_torque: what the drives deliver [N m], after limit, delay and lag.
        friction_torque: F of equation (1) [N m]; of a joint that sticks, the torque that holds it.
        disturbance: tau_d of equation (1) [N m].
        leakage: LS of equation (5) [rad/s^2]: the acceleration that the nominal model expects of the applied torque, less
            the real one.
        masses: of the links [kg], without the payload.
        lengths: of the links [m].
        lumped: the five lumped parameters with the payload carried now, [5] or [n x 5]; see `arm.py`.
        payload: mass carried at the tip [kg]; a number, or [n].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    reference: Array
    reference_velocity: Array
    reference_acceleration: Array
    applied_torque: Array
    friction_torque: Array
    disturbance: Array
    leakage: Array
    masses: Array
    lengths: Array
    lumped: Array
    payload: Array


class ArmBatch:
    """`lanes` arms of one scenario, each with its own seed and episode.

    Args:
        program: the scenario in numbers.
        lanes: how many, one or more.
        threads: between how many threads the lanes are divided.
    """

    def __init__(self, program: Program, lanes: int, threads: int = 1) -> None:
        blocks, block = -(-lanes // LANES), int(program.settings[settings.BLOCK])
        size = program.interface.layout.size
        lasts = lanes * size if program.settings[settings.AUTORESET] == settings.SAME_STEP else 0
        sizes = len(program.settings), 2 * lanes, lanes, -(-lanes // 4), lasts, blocks * block
        places = np.cumsum([0, *sizes])
        self.lanes = lanes
        self.threads = min(threads, blocks)
        self._block = block
        self._given, self._rewards, self._flags, self._lasts, self._state = (
            slice(int(place), int(place) + size) for place, size in zip(places[1:-1], sizes[1:], strict=True)
        )
        self._memory = np.zeros(places[-1])
        self._memory[: sizes[0]] = program.settings
        self._memory[settings.COUNT : settings.STATE + 1] = lanes, *places[1:-1]
        # The last block's spare lanes get an episode too, so that their numbers stay sane.
        self._blocks[:, settings.ENDED : settings.ENDED + LANES] = settings.RESTART
        api.step(self._memory, np.empty(lanes * size), 0, 0)
        # Before its first step, a lane must be reset.
        self._blocks[:, settings.ENDED : settings.ENDED + LANES] = 1.0

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if not self._memory.flags.writeable:  # as out of a memory map
            self._memory = self._memory.copy()

    @property
    def _blocks(self) -> Array:
        """The state as [blocks x numbers of a block], a new view each time: one that is kept would not follow a copy."""
        return self._memory[self._state].reshape(-1, self._block)

    @property
    def _counters(self) -> NDArray[np.uint64]:
        """The same, for the rows that hold whole numbers."""
        return self._blocks.view(np.uint64)

    def seed(self, lanes: NDArray[np.int64], seeds: NDArray[np.uint64] | np.uint64) -> None:
        """Give lanes their seeds; the episode that starts next in each is the first of its seed."""
        self._counters[lanes // LANES, settings.SEED + lanes % LANES] = seeds
        self._counters[lanes // LANES, settings.EPISODE + lanes % LANES] = 0

    def next_episode(self, lanes: NDArray[np.int64]) -> None:
        """Let the episode that starts next in these lanes be another one of the same seed."""
        self._counters[lanes // LANES, settings.EPISODE + lanes % LANES] += np.uint64(1)

    def reset(self, lanes: NDArray[np.int64], out: Array) -> None:
        """Start an episode in some lanes; write every lane's observation to `out` [n * size]."""
        self._blocks[lanes // LANES, settings.ENDED + lanes % LANES] = settings.RESTART
        api.step(self._memory, out, 0, 0)

    def step(self, actions: Array, out: Array) -> tuple[int, float, bool, bool]:
        """One control interval of every lane, unless something is against it; see `kernel.api.step` and `check`.

        Args:
            actions: [2 n].
            out: takes the observations [n * size].

        Returns:
            What `check` found, and of the first lane the reward, and whether it is terminated, and truncated.
        """
        memory = self._memory
        memory[self._given] = actions
        if self.threads == 1:
            return api.step(memory, out, 0, 1)
        found: int = api.check(memory)
        if found >= 0:
            return found, 0.0, False, False
        pool = _pool(self.threads)
        work = [pool.submit(api.step, memory, out, part, self.threads) for part in range(self.threads)]
        first, *_ = [each.result() for each in work]
        return first

    @property
    def outcomes(self) -> tuple[Array, Flags, Flags]:
        """Of the last step: rewards, and whether it ended an episode by divergence, or because time was up; [n] each."""
        n = self.lanes
        flags = self._memory[self._flags].view(np.bool_)
        return self._memory[self._rewards].copy(), flags[:n].copy(), flags[n : 2 * n].copy()

    @property
    def lasts(self) -> Array:
        """With SAME_STEP, the last observations of the episodes that the last step ended [n x size]; of no use elsewhere."""
        return self._memory[self._lasts].reshape(self.lanes, -1)

    def truth(self) -> Truth:
        """What is really so, now; computed when asked for."""
        found = np.empty((self.lanes, settings.TRUE_COLUMNS))
        api.inspect(self._memory, found)
        return Truth(**{name: found[:, columns].copy() for name, columns in settings.TRUE.items()})


@lru_cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """The threads that batches share. They work on different lanes, and the kernel runs without the interpreter's lock."""
    return ThreadPoolExecutor(threads, thread_name_prefix="fbl-gym")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has none of its parent's threads


def single(truth: Truth) -> Truth:
    """The truth of the one lane of a batch, without the batch axis."""
    return Truth(**{name: value[0] for name, value in vars(truth).items()})
