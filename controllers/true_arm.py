"""The real arm as the ceiling laws predict it, from `env.truth`: delay, lag, friction, springs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.parts import runge_kutta
from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array, forward_dynamics, inertia_matrix, with_rotors


def diagonal(x: Array) -> Array:
    """Return matrices with x [... x 2] on their diagonals, [... x 2 x 2]."""
    return x[..., None] * np.eye(2)


@dataclass(frozen=True)
class TrueArm:
    """A batch of real arms with rigid or elastic joints at an instant.

    A state is position and velocity of the links, of elastic joints also of the motors, and last
    the torque of the drives, each [n x 2].

    Args:
        truth: with a batch axis.
        elastic: True if springs lie between motors and links.
        dt: control interval [s].
    """

    truth: Truth
    elastic: bool
    dt: float

    @classmethod
    def of(cls, env: object) -> TrueArm:
        """Return the arms of an environment, single or batched."""
        truth: Truth = env.truth  # type: ignore[attr-defined]
        if truth.position.ndim == 1:
            truth = Truth(**{name: np.asarray(value)[None] for name, value in vars(truth).items()})
        scenario = env.scenario  # type: ignore[attr-defined]
        return cls(truth, scenario.joint is not None, scenario.control_dt)

    @property
    def links(self) -> Array:
        """Lumped parameters of the links, with those rotors that turn with them [n x 7]."""
        return with_rotors(self.truth.lumped, (0.0, 0.0) if self.elastic else self.truth.rotor)

    @property
    def state(self) -> tuple[Array, ...]:
        """The state now."""
        truth = self.truth
        motors = (truth.motor_position, truth.motor_velocity) if self.elastic else ()
        return truth.position, truth.velocity, *motors, truth.applied_torque

    def dry(self, v: Array) -> Array:
        """Return the bound of the dry friction at a velocity [n x 2] N m."""
        truth = self.truth
        gear = truth.load_friction * np.abs(truth.applied_torque)
        return truth.coulomb + gear + truth.stiction * np.exp(-(v**2) / truth.v_s)

    def spring(self, stretch: Array, rate: Array) -> Array:
        """Return the torque of the springs on the links [n x 2] N m."""
        truth, gap = self.truth, 0.5 * self.truth.backlash
        force = truth.stiffness * (stretch - np.clip(stretch, -gap, gap))
        force = force + np.where(np.abs(stretch) >= gap, truth.damping * rate, 0.0)
        return np.where((gap > 0.0) & (force * stretch < 0.0), 0.0, force)  # teeth push and never pull

    def predicted(self) -> tuple[Array, ...]:
        """Return the state at the time at which the next command begins to act.

        The lanes take the same number of steps, in which those with less delay wait at first.
        """
        parts = 4 if self.elastic else 2
        h, delay = self.dt / parts, self.truth.delay[:, None]
        state = self.state
        for k in range(math.ceil(float(delay.max()) / h - 1e-9), 0, -1):
            command = self.truth.gain * self.truth.commands[:, (k - 1) // parts]
            state = self._step(state, np.clip(delay - (k - 1) * h, 0.0, h), command)
        return state

    def _step(self, state: tuple[Array, ...], h: Array, command: Array) -> tuple[Array, ...]:
        """Return the state after a classical Runge-Kutta step of h [n x 1] with a command.

        The dry friction is held over the step.
        """
        *x, torque = state
        lag = np.maximum(self.truth.lag[:, None], 1e-9)
        half, end = (command + np.exp(-t / lag) * (torque - command) for t in (0.5 * h, h))
        first = np.where(self.truth.lag[:, None] > 0.0, torque, command)
        dry = self._held(x, h, first)
        moved = runge_kutta(lambda x, u: self._rates(x, u, dry), x, h, (first, half, end))
        return *moved, np.where(h > 0.0, end, torque)

    def _held(self, x: list[Array], h: Array, torque: Array) -> Array:
        """Return the dry friction over a step: it stops a joint if its bound allows."""
        v, h, none = x[-1], np.maximum(h, 1e-9), np.zeros_like(torque)
        bound = self.dry(v)
        if not bound.any():
            return none
        # The velocity at the end without friction, and how much friction takes away.
        free = v + h * self._rates(x, torque, none)[-1]
        inertia = diagonal(self.truth.rotor) if self.elastic else inertia_matrix(self.links, x[0])
        per_torque = h[..., None] * np.linalg.inv(inertia)
        dry = none
        for joint in (0, 1, 0, 1, 0, 1):  # Gauss and Seidel
            left = free[:, joint] - np.einsum("nj,nj->n", per_torque[:, joint], dry)
            stop = dry[:, joint] + left / per_torque[:, joint, joint]
            dry[:, joint] = np.clip(stop, -bound[:, joint], bound[:, joint])
        return dry

    def _rates(self, x: Sequence[Array], torque: Array, dry: Array) -> tuple[Array, ...]:
        """Return the time derivative of a state without its torque."""
        left = torque - self.truth.viscous * x[-1] - dry
        if not self.elastic:
            return x[1], forward_dynamics(self.links, x[0], x[1], left - self.truth.disturbance)
        q, v, motor, w = x
        spring = self.spring(motor - q, w - v)
        a = forward_dynamics(self.links, q, v, spring - self.truth.disturbance)
        return v, a, w, (left - spring) / self.truth.rotor
