"""The drive as its datasheet states it, by which a law pairs a motion with its torque."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from fbl_gym.interface import Interface
from fbl_gym.kernel.arm import prediction
from fbl_gym.model.arm import ArmParameters, Array

#: Largest velocity of a prediction [rad/s], which keeps the numbers of a diverging arm finite.
FASTEST = 200.0


class Acting(NamedTuple):
    """The torques of a drive at a sample, as its datasheet has them."""

    queue: Array  # commands under way, the newest first [n x depth x 2] N m
    torque: Array  # on the joints [n x 2] N m
    mean: Array  # of it over the interval before [n x 2] N m


@dataclass(frozen=True)
class Drive:
    """The drive as its datasheet states it: a command acts after a delay, through a lag.

    Delay and lag are the middle of their ranges. The age of the readings is part of the delay,
    which therefore leads from a command to its effect on the readings. Times count from the last
    reading.

    Args:
        dt: control interval [s].
        delay: [s].
        lag: time constant [s].
        sent: the command at this sample [n x 2] N m, where it is another than that of the law.
    """

    dt: float
    delay: float
    lag: float
    sent: Array | None = None

    @classmethod
    def of(cls, interface: Interface) -> Self:
        """Return the drive of an interface."""
        return cls(interface.control_dt, sum(interface.delay) / 2 + interface.latency, sum(interface.lag) / 2)

    @cached_property
    def coming(self) -> Array:
        """Times for which the commands of a queue act, each until the next; the oldest first [s].

        The first is the delay less its whole control intervals.
        """
        whole = int(self.delay / self.dt + 1e-9)
        return np.array([max(self.delay - whole * self.dt, 0.0), *[self.dt] * whole])

    def hold(self, torque: Array) -> Acting:
        """Return the torques after a long time at one [n x 2] N m."""
        return Acting(np.repeat(torque[:, None], len(self.coming), axis=1), torque, torque)

    def act(self, acting: Acting, command: Array) -> Acting:
        """Return the torques after the interval that begins with a new command [n x 2] N m."""
        command = command if self.sent is None else self.sent
        commands = np.concatenate([command[:, None], acting.queue], axis=1)
        now = np.empty((2, *command.shape))
        prediction.follow(commands, np.ascontiguousarray(acting.torque), self._spans, self.dt, now)
        return Acting(commands[:, : len(self.coming)], now[0], now[1])

    def predict(self, arm: ArmParameters, motion: ArrayLike, f: Array, steps: Array, commands: Array) -> Array:
        """Return the motion of a model after some commands, each in one step.

        A command of no duration is left out.

        Args:
            arm: the model.
            motion: position, velocity and torque on the joints at the start [3 x n x 2].
            f: acceleration that is added to that of the model [n x 2] rad/s^2.
            steps: duration of each command [m] s; at most a control interval is exact enough.
            commands: [m x n x 2] N m.

        Returns:
            Position, velocity and torque at the end [3 x n x 2].
        """
        after, moves = np.array(motion, dtype=float), steps > 0.0
        f, commands = np.ascontiguousarray(f, dtype=float), commands[moves]
        prediction.predict(arm.base, f, steps[moves], commands, self.lag, FASTEST, after)
        return after

    @cached_property
    def _spans(self) -> Array:
        """Duration t of older and newer command, exp(-t / lag), and its integral [2 x 3]."""
        times = (self.coming[0], self.dt - self.coming[0])
        keeps = [math.exp(-t / self.lag) if self.lag > 0.0 else 0.0 for t in times]
        return np.array([(t, keep, self.lag * (1.0 - keep)) for t, keep in zip(times, keeps, strict=True)])
