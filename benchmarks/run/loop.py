"""The sampled loop of a linearised policy and arm, and its margins.

The plant is the arm over one control interval, with springs, the drive's delay and lag, and the
encoders. A margin is the smallest gain, phase or delay at the plant's input at which an eigenvalue
of the closed loop leaves the unit circle.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import cont2discrete
from threadpoolctl import threadpool_limits

from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair

#: The phase margin [degrees] and delay margin [samples] that a policy should have.
LEAST_PHASE, LEAST_DELAY = 30.0, 0.5

#: Largest modulus of an eigenvalue that counts as stable.
#:
#: Rounding moves the eigenvalue 1 of a constant state.
UNIT_CIRCLE = 1.0 + 1e-6

#: The longest delay that is tried [s].
LONGEST_DELAY = 1.0

#: The factors of the loop's gain that are tried.
GAIN_FACTORS = np.geomspace(1.0, 1e3, 61)[1:]


class NotLinear(ValueError):
    """A loop without a linearisation or without margins; the message gives the reason."""


UNSTABLE = "the loop is unstable without dry friction"


class Unstable(NotLinear):
    """A loop that is unstable as it is."""


@dataclass(frozen=True)
class Margins:
    """Margins of a closed loop; each pair is of the torques of both joints, one opened at a time.

    Attributes:
        delay: smallest added delay of both torques at which the loop is unstable [s]; inf: none
            up to 1 s.
        gain_lower: largest factor below 1 at which the loop is unstable; 0: none down to 0.001.
        gain_upper: smallest factor above 1 at which the loop is unstable; inf: none up to 1,000.
        phase: [degrees]; inf: none.
        sensitivity: peak of |S|, S = 1 / (1 + L).
        complementary: peak of |T|, T = L / (1 + L).
    """

    delay: float
    gain_lower: Pair
    gain_upper: Pair
    phase: Pair
    sensitivity: Pair
    complementary: Pair


@dataclass(frozen=True)
class LinearLoop:
    """A linearised sampled loop of the torques u [2] and the measured signals y: y = P u, u = K y.

    Attributes:
        control_dt: sample time [s].
        delay, lag: of the drive [s].
        motion: derivative of the arm's state's rate by the state, [n x n]. The state is (q, v) of
            the joints; those of the hinges of links that bend, and of the motors of elastic joints,
            follow.
        drive: its derivative by the commanded torque, [n x 2]; the drive's gain is part of it.
        measured: index in the state of the position that the encoders read.
        encoder: latency and difference [samples], and the low-pass filter's share of a new value;
            difference 0: the velocity is measured.
        matrices: A, B, C, D of K.
        readings: number of entries of y in each slot of the observation, by name.
        action_scale: torque of an action of 1, [2] N m.
    """

    control_dt: float
    delay: float
    lag: float
    motion: Array
    drive: Array
    measured: int
    encoder: tuple[int, int, float]
    matrices: tuple[Array, Array, Array, Array]
    readings: dict[str, int]
    action_scale: Array

    def plant(self, more_delay: float = 0.0) -> tuple[Array, Array, Array]:
        """Return A, B, C of P.

        Its state is that of the arm, the drive's torque if it lags, the past commands, and the past
        readings that the encoders still use. A delay of k + f intervals splits an interval: in its
        first part f the command is one sample older (Franklin, Powell and Workman, "Digital Control
        of Dynamic Systems", 1998, §4.3.4).
        """
        a, b, size = self.motion, self.drive, len(self.motion)
        if self.lag > 0.0:
            a = np.block([[a, b], [np.zeros((2, size)), -np.eye(2) / self.lag]])
            b = np.vstack([np.zeros((size, 2)), np.eye(2) / self.lag])
        whole, part = divmod((self.delay + more_delay) / self.control_dt + 1e-9, 1.0)
        system = a, b, np.zeros((0, len(a))), np.zeros((0, 2))
        early, early_input, *_ = cont2discrete(system, part * self.control_dt)
        late, late_input, *_ = cont2discrete(system, (1.0 - part) * self.control_dt)

        # Inputs: the commands of now and of the last samples, as many as act or are observed.
        # The past ones are states.
        n, k = len(a), int(whole)
        past = max(k + 1, self.readings.get("previous_actions", 0) // 2)
        inputs = np.zeros((n, 2 * (past + 1)))
        inputs[:, 2 * k : 2 * k + 4] = np.hstack([late_input, late @ early_input])
        both = np.vstack([np.hstack([late @ early, inputs]), np.eye(2 * past, n + 2 * (past + 1), k=n)])
        b, both = both[:, n : n + 2], np.delete(both, [n, n + 1], axis=1)

        # The last readings of position and velocity, the newest first, are states, too.
        (latency, difference, share), length = self.encoder, len(both)
        a = block_diag(both, np.eye(4 * max(latency, difference), k=-4))
        readings = np.zeros((4 + len(a) - length, len(a)))
        readings[4:, length:] = np.eye(len(a) - length)
        readings[:4, self.measured : self.measured + 4] = np.eye(4)
        if difference:
            change = readings[:2] - readings[4 * difference : 4 * difference + 2]
            readings[2:4] = (1.0 - share) * readings[6:8] + share / (difference * self.control_dt) * change
        a[length : length + 4] = readings[: len(a) - length][:4]

        outputs = {"position": readings[4 * latency :][:2], "velocity": readings[4 * latency + 2 :][:2]}
        # An accelerometer reads at the end of an interval, under the torque of that interval.
        outputs["acceleration"], outputs["previous_actions"] = np.zeros((2, len(a))), np.zeros((2 * past, len(a)))
        outputs["acceleration"][:, :size] = self.motion[2:4]
        acting = size if self.lag > 0.0 else n + 2 * k
        outputs["acceleration"][:, acting : acting + 2] += self.drive[2:4]
        shares = np.divide(1.0, self.action_scale, out=np.zeros(2), where=self.action_scale > 0.0)
        outputs["previous_actions"][:, n:length] = np.diag(np.tile(shares, past))
        rows = [outputs[slot][:number] for slot, number in self.readings.items()]
        return a, np.vstack([b, np.zeros((len(a) - length, 2))]), np.vstack(rows)

    def _series(self, more_delay: float = 0.0) -> tuple[Array, Array, Array]:
        """Return A, B, C of K P, the loop that is cut open at the plant's input."""
        a, b, c = self.plant(more_delay)
        law_a, law_b, law_c, law_d = self.matrices
        step = block_diag(a, law_a)
        step[len(a) :, : len(a)] = law_b @ c
        return step, np.vstack([b, np.zeros((len(law_a), 2))]), np.hstack([law_d @ c, law_c])

    def response(self, joint: int, points: int = 2000) -> tuple[Array, Array]:
        """Return frequencies from 0.1 rad/s to Nyquist's, and the loop transfer L, both [points].

        L is that of joint 0 or 1, complex, for negative feedback; the other joint's loop is closed.
        """
        a, b, c = self._series()
        closed = a + np.outer(b[:, 1 - joint], c[1 - joint])
        frequencies = np.geomspace(0.1, np.pi / self.control_dt, points)
        z, one = np.exp(1j * frequencies * self.control_dt), np.eye(len(a))
        return frequencies, np.array([-c[joint] @ np.linalg.solve(x * one - closed, b[:, joint]) for x in z])

    def is_stable(self, factors: Sequence[complex] = (1.0, 1.0), more_delay: float = 0.0) -> bool:
        """Return True if all eigenvalues of the closed loop are within the unit circle.

        `factors` multiply the torque of each joint; `more_delay` [s] delays both.
        """
        a, b, c = self._series(more_delay)
        return bool(np.abs(np.linalg.eigvals(a + b * np.asarray(factors) @ c)).max() <= UNIT_CIRCLE)

    def margins(self) -> Margins:
        """Return the margins; raise `NotLinear` if the loop is unstable."""
        with threadpool_limits(1):  # small matrices only wait for threads
            if not self.is_stable():
                raise Unstable(UNSTABLE)
            # Fine within the first samples, where a part of a sample matters most.
            delays = self.control_dt * np.append(np.arange(0.1, 4.0, 0.1), np.geomspace(4.0, 1e4, 160))
            delay = _edge(lambda x: self.is_stable(more_delay=x), 0.0, delays[delays <= LONGEST_DELAY])
            return Margins(delay, *zip(self._joint_margins(0), self._joint_margins(1), strict=True))

    def _joint_margins(self, joint: int) -> tuple[float, ...]:
        """Return the fields of `Margins` after the first, of one joint."""

        def stable(factor: complex) -> bool:
            return self.is_stable([factor if i == joint else 1.0 for i in (0, 1)])

        sensitivity = 1.0 / (1.0 + self.response(joint)[1])
        lower = 1.0 / _edge(lambda x: stable(1.0 / x), 1.0, GAIN_FACTORS)
        upper = _edge(stable, 1.0, GAIN_FACTORS)
        phase = _edge(lambda x: stable(np.exp(-1j * np.radians(x))), 0.0, np.arange(2.0, 181.0, 2.0))
        return lower, upper, phase, np.abs(sensitivity).max(), np.abs(1.0 - sensitivity).max()


def _edge(stable: Callable[[float], bool], inside: float, grid: Array) -> float:
    """Return the first unstable value, from `inside` along the grid; inf: none."""
    outside = next((x for x in grid if not stable(x)), np.inf)
    inside = max([inside, *grid[grid < outside]])
    while np.isfinite(outside) and outside - inside > 1e-5 * outside:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if stable(middle) else (inside, middle)
    return float(outside)
