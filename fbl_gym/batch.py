"""A batch of arms: the arrays that the kernel works on, and the two things that can be done to them.

Both environments are a thin layer over this: the single one is a batch of one lane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fbl_gym import compiled, settings
from fbl_gym.arm import Array, forward_dynamics
from fbl_gym.settings import CLOCK_ROWS, LANES, Program

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
    """

    def __init__(self, program: Program, lanes: int) -> None:
        blocks = -(-lanes // LANES)
        self.lanes = lanes
        self.program = program
        self._state = np.zeros(blocks * program.rows * LANES)
        self._clock = np.zeros(blocks * CLOCK_ROWS * LANES, dtype=np.uint64)
        # The last block's spare lanes get an episode too, so that their numbers stay sane.
        self.reset(np.ones(blocks * LANES, dtype=bool), np.empty((0, program.interface.layout.size)))
        # Before its first step, a lane must be reset.
        self._clock_by_row[:, settings.ENDED] = 1

    # Views, made anew each time: kept as attributes, they would part from the arrays in a copy.

    @property
    def _by_row(self) -> Array:
        """The state as [blocks x rows x lanes of a block]."""
        return self._state.reshape(-1, self.program.rows, LANES)

    @property
    def _clock_by_row(self) -> NDArray[np.uint64]:
        """The clock as [blocks x rows x lanes of a block]."""
        return self._clock.reshape(-1, CLOCK_ROWS, LANES)

    def seed(self, lane: int, seed: int) -> None:
        """Give a lane a seed; the episode that starts next is the first of that seed."""
        block, l = divmod(lane, LANES)
        self._clock_by_row[block, settings.SEED, l] = seed
        self._clock_by_row[block, settings.EPISODE, l] = 0

    def next_episode(self, lane: int) -> None:
        """Let the episode that starts next in a lane be another one of the same seed."""
        block, l = divmod(lane, LANES)
        self._clock_by_row[block, settings.EPISODE, l] += np.uint64(1)

    def reset(self, mask: Flags, out: Array) -> None:
        """Start an episode in each lane of `mask` [n]; write every lane's observation to `out` [n x size]."""
        compiled.reset(self._state, self._clock, self.program.settings, self.program.tables, mask, out)

    def step(
        self,
        actions: Array,
        autoreset: int,
        out: Array,
        final: Array,
        rewards: Array,
        terminated: Flags,
        truncated: Flags,
    ) -> tuple[int, int]:
        """One control interval of every lane; see `kernel.step`.

        Returns the first lane whose action is not finite and the first that has ended and needs a reset, -1 for none; where
        there is one, nothing was advanced.
        """
        program = self.program
        bad, ended, _ = compiled.step(
            self._state, self._clock, program.settings, program.tables, actions, autoreset, out, final, rewards,
            terminated, truncated,
        )  # fmt: skip
        return bad, ended

    def _row(self, row: int) -> Array:
        """A copy of one row of the state, [n]."""
        return self._by_row[:, row].flatten()[: self.lanes]

    def _rows(self, first: int, count: int = 2) -> Array:
        """A copy of neighbouring rows, [n x count]."""
        return self._by_row[:, first : first + count].transpose(0, 2, 1).copy().reshape(-1, count)[: self.lanes]

    def truth(self) -> Truth:
        """What is really so, now; computed when asked for."""
        found = np.empty((self.lanes, 4))
        compiled.inspect(self._state, self.program.settings, self.lanes, found)
        acceleration, friction = found[:, :2].copy(), found[:, 2:].copy()
        position, velocity = self._rows(settings.Q1), self._rows(settings.V1)
        applied = self._rows(settings.T1)
        interface = self.program.interface
        expected = forward_dynamics(interface.nominal, position, velocity, applied)
        steps = self._clock_by_row[:, settings.STEP].flatten()[: self.lanes].astype(float)
        return Truth(
            time=steps * interface.control_dt,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            reference=self._rows(settings.R1),
            reference_velocity=self._rows(settings.R3),
            reference_acceleration=self._rows(settings.R5),
            applied_torque=applied,
            friction_torque=friction,
            disturbance=self._rows(settings.D1),
            leakage=expected - acceleration,
            masses=self._rows(settings.M1),
            lengths=self._rows(settings.L1),
            lumped=self._rows(settings.P1, 5),
            payload=self._row(settings.LOAD),
        )


def single(truth: Truth) -> Truth:
    """The truth of the one lane of a batch, without the batch axis."""
    return Truth(**{name: value[0] for name, value in vars(truth).items()})
