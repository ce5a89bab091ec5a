"""The real arm as the oracles predict it, from `env.truth`: delay, lag, friction, springs."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array, forward_dynamics, inertia_matrix, with_rotors
from fbl_gym.model.chain import chain_dynamics
from fbl_gym.scenarios import Scenario


@dataclass(frozen=True)
class TrueArm:
    """A batch of real arms, whose joints may be elastic and whose links may bend, at an instant.

    A state [n x s] is position and velocity of the joints, of links that bend also of their hinges,
    of elastic joints also of the motors; and last the torque of the drives.

    Args:
        truth: with a batch axis.
        scenario: the task.
        gravity: [m/s^2], as in `truth.lumped`.
    """

    truth: Truth
    scenario: Scenario
    gravity: float

    @classmethod
    def of(cls, env: Any) -> Self:
        """Return the arms of an environment, single or batched."""
        arm = cls(env.truth, env.scenario, env.scenario.arm.gravity)
        return arm.of_lanes(None) if arm.truth.position.ndim == 1 else arm

    def of_lanes(self, lanes: Array | None) -> Self:
        """Return the arms of some lanes, in an order and as often as they are given.

        None turns the one arm of a single environment into a batch.
        """
        return replace(self, truth=self.truth.of_lanes(lanes))

    @property
    def elastic(self) -> bool:
        """True if springs lie between motors and links."""
        return self.scenario.joint is not None

    @property
    def side(self) -> slice:
        """Columns of a state, without its torque, of the velocity that friction acts on."""
        return slice(-2, None) if self.elastic else slice(2, 4)

    @cached_property
    def links(self) -> Array:
        """Lumped parameters of the links, with those rotors that turn with them [n x 7]."""
        return with_rotors(self.truth.lumped, (0.0, 0.0) if self.elastic else self.truth.rotor)

    @property
    def state(self) -> Array:
        """The state now."""
        truth = self.truth
        bends = (truth.bend, truth.bend_velocity) if self.scenario.link is not None else ()
        motors = (truth.motor_position, truth.motor_velocity) if self.elastic else ()
        return np.concatenate([truth.position, truth.velocity, *bends, *motors, truth.applied_torque], axis=1)

    def dry(self, v: Array) -> Array:
        """Return the bound of the dry friction at a velocity [n x 2] N m."""
        truth = self.truth
        gear = truth.load_friction * np.abs(truth.applied_torque)
        return truth.coulomb + gear + truth.stiction * np.exp(-(v**2) / truth.v_s)

    def spring(self, stretch: Array, rate: Array) -> Array:
        """Return the torque of the springs on the links [n x 2] N m."""
        truth, gap = self.truth, 0.5 * self.truth.backlash
        if not gap.any():
            return truth.stiffness * stretch + truth.damping * rate
        force = truth.stiffness * (stretch - np.clip(stretch, -gap, gap))
        force = force + np.where(np.abs(stretch) >= gap, truth.damping * rate, 0.0)
        return np.where((gap > 0.0) & (force * stretch < 0.0), 0.0, force)  # teeth push and never pull

    def predicted(self) -> Array:
        """Return the state at the time at which the next command begins to act.

        The lanes take the same number of steps, in which those with less delay wait at first.
        """
        state = self.state
        parts = 2 if state.shape[1] == 6 else 4  # springs are faster
        h, delay = self.scenario.control_dt / parts, self.truth.delay[:, None]
        for k in range(math.ceil(float(delay.max()) / h - 1e-9), 0, -1):
            command = self.truth.gain * self.truth.commands[:, (k - 1) // parts]
            state = self._step(state, np.clip(delay - (k - 1) * h, 0.0, h), command)
        return state

    def _step(self, state: Array, h: Array, command: Array) -> Array:
        """Return the state after a classical Runge-Kutta step of h [n x 1] with a command.

        The dry friction is held over the step.
        """
        x, torque = state[:, :-2], state[:, -2:]
        lag = np.maximum(self.truth.lag[:, None], 1e-9)
        half, end = (command + np.exp(-t / lag) * (torque - command) for t in (0.5 * h, h))
        first = np.where(self.truth.lag[:, None] > 0.0, torque, command)
        dry = self._held(x, h, first)
        k1 = self.rates(x, first, dry)
        k2 = self.rates(x + 0.5 * h * k1, half, dry)
        k3 = self.rates(x + 0.5 * h * k2, half, dry)
        k4 = self.rates(x + h * k3, end, dry)
        return np.concatenate([x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), np.where(h > 0.0, end, torque)], axis=1)

    def _held(self, x: Array, h: Array, torque: Array) -> Array:
        """Return the dry friction over a step: it stops a joint if its bound allows."""
        v, h, none = x[:, self.side], np.maximum(h, 1e-9), np.zeros_like(torque)
        if not (bound := self.dry(v)).any():
            return none
        # The velocity at the end without friction, and how much friction takes away.
        free = v + h * self.rates(x, torque, none)[:, self.side]
        p11, p12, p21, p22 = (h * self._mobility(x)).T
        (b1, b2), (free1, free2), d1, d2 = bound.T, free.T, none[:, 0], none[:, 1]
        for _ in range(3):  # Gauss and Seidel
            d1 = np.clip(d1 + (free1 - (p11 * d1 + p12 * d2)) / p11, -b1, b1)
            d2 = np.clip(d2 + (free2 - (p21 * d1 + p22 * d2)) / p22, -b2, b2)
        return np.stack([d1, d2], axis=1)

    def _mobility(self, x: Array) -> Array:
        """Return the inverse inertia at the drives, row by row [n x 4] 1 / (kg m^2)."""
        if self.elastic:
            return (np.eye(2) / self.truth.rotor[..., None]).reshape(-1, 4)
        inertia = inertia_matrix(self.links, x[:, :2]) if self.scenario.link is None else self.chain(x)[0]
        return np.linalg.inv(inertia)[..., :2, :2].reshape(-1, 4)  # type: ignore[return-value]

    def chain(self, x: Array) -> tuple[Array, Array]:
        """Return inertia [n x 4 x 4] and load [n x 4] of joints and hinges of links that bend."""
        truth, link, (q, v, b, u) = self.truth, self.scenario.link, np.split(x[:, :8], 4, axis=1)
        segments = truth.segment_inertia.T, truth.segment_moment.T
        inertia, load = chain_dynamics(segments, truth.lengths.T, self.gravity, q, b, v, u)
        stiffness, damping = link.springs(self.scenario.arm, truth.bend_rate)  # type: ignore[union-attr]
        load[..., 2:] -= stiffness * b + damping * u
        if not self.elastic:
            inertia[..., [0, 1], [0, 1]] += truth.rotor
        return inertia, load

    def rates(self, x: Array, torque: Array, dry: Array | float = 0.0) -> Array:
        """Return the time derivative of a state without its torque."""
        truth, q, v = self.truth, x[:, :2], x[:, 2:4]
        motors: tuple[Array, ...] = ()
        load = torque - truth.viscous * x[:, self.side] - dry
        if self.elastic:
            motor, w = x[:, -4:-2], x[:, -2:]
            spring = self.spring(motor - q, w - v)
            motors, load = (w, (load - spring) / truth.rotor), spring
        load = load - truth.disturbance
        if self.scenario.link is None:
            return np.concatenate([v, forward_dynamics(self.links, q, v, load), *motors], axis=1)
        inertia, left = self.chain(x)
        left[..., :2] += load
        a: Any = np.linalg.solve(inertia, left[..., None])[..., 0]
        return np.concatenate([v, a[..., :2], x[:, 6:8], a[..., 2:], *motors], axis=1)

    def linear(self, angles: Array) -> Array:
        """Return the derivative of the rates at rest without load, for angles of the second joint.

        For angles [k] it is [n x k x s x (s + 2)], as `slope` returns it.
        """
        n, k = len(self.truth.lumped), len(angles)
        truth, none = self.of_lanes(np.repeat(np.arange(n), k)).truth, np.zeros((n * k, 2))
        truth = replace(truth, lumped=truth.lumped * [1, 1, 1, 0, 0], disturbance=none, backlash=none)
        still = np.zeros((n * k, self.state.shape[1]))
        still[:, 1] = still[:, -5 if self.elastic else 1] = np.tile(angles, n)
        slope = TrueArm(truth, self.scenario, 0.0).slope(still)
        return slope.reshape(n, k, *slope.shape[1:])

    def slope(self, state: Array) -> Array:
        """Return the derivative of the rates by a state [n x s x (s + 2)].

        The last two columns are by the torque of the drives.
        """
        columns = []
        for step in 1e-5 * np.eye(state.shape[1]):
            up, down = state + step, state - step
            columns.append((self.rates(up[:, :-2], up[:, -2:]) - self.rates(down[:, :-2], down[:, -2:])) / 2e-5)
        return np.stack(columns, axis=-1)
