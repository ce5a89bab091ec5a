"""Swing-up and balance of an arm that lacks a drive: an acrobot or a pendubot."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_continuous_are

from controllers.base import Gain, State, TorqueLaw, number, pair
from fbl_gym.model.arm import Array, inertia_matrix

TOP = np.array([np.pi / 2, 0.0])


@dataclass(frozen=True)
class SwingUp(TorqueLaw):
    """Energy shaping through partial feedback linearisation, and an optimal regulator near the top.

    Joint a has the drive, joint u has none, and x = (q - top, v). Far from the top,

        a_a = -stiffness x_a - damping v_a + pump v_u (E - E_top) / E_top

    with the energy E, and the torque is that of the acceleration a_a and of the a_u that a joint
    without torque has. Close to it, where the regulator's cost x'Px is below `catch`, it acts:

        torque_a = -K x,    cost: int |angle x_q|^2 + |rate v|^2 + (torque_a / (effort E_top))^2 dt

    The goal is the upright arm, whatever the reference. At rest below, a push starts the motion.
    With two drives, the first one is used alone. Angles are modulo a turn.

    Sensors: position and velocity. Source: Spong, "Energy based control of a class of underactuated
    mechanical systems", IFAC World Congress 1996; "The swing up control problem for the acrobot",
    IEEE Control Systems 15(1), 1995. Gains of the regulator's region as in DFKI's program
    (github.com/dfki-ric-underactuated-lab/double_pendulum).

    Args:
        stiffness: of joint a about the top [1/s^2].
        damping: of joint a [1/s].
        pump: gain of the energy [1/s].
        angle: weight of each joint's angle [1/rad].
        rate: weight of each joint's velocity [s/rad].
        effort: torque over E_top that is weighted with 1.
        catch: cost below which the regulator acts.
    """

    stiffness: float = number(0.05, unit="1/s^2", low=0)
    damping: float = number(3.5, unit="1/s", low=0)
    pump: float = number(20.0, unit="1/s", above=0)
    angle: Gain = pair((0.6, 0.25), unit="1/rad", above=0)
    rate: Gain = pair((1.6, 0.35), unit="s/rad", above=0)
    effort: float = number(0.15, above=0)
    catch: float = number(23.0, above=0)

    missing: ClassVar[int] = 1

    def validate(self) -> None:
        """Refuse an arm that gravity does not hold below, too."""
        super().validate()
        if min(self.interface.nominal.lumped[3:]) <= 0.0:
            raise ValueError("SwingUp needs an arm that hangs: gravity above 0, and centres of mass beyond the joints")

    @cached_property
    def driven(self) -> int:
        """Index of the joint with a drive."""
        return int(self.interface.torque_limit is not None and self.interface.torque_limit[0] == 0.0)

    @cached_property
    def regulator(self) -> tuple[Array, Array]:
        """The gain K [4] and the cost P [4 x 4] on x, for the torque over E_top."""
        p4, p5 = self.interface.nominal.lumped[3:]
        inverse = np.linalg.inv(inertia_matrix(self.interface.nominal, TOP))
        a, b = np.zeros((4, 4)), np.zeros((4, 1))
        a[:2, 2:], a[2:, :2] = np.eye(2), inverse @ [[p4 + p5, p5], [p5, p5]]
        b[2:, 0] = inverse[:, self.driven] * (p4 + p5)
        r = np.eye(1) / self.effort**2
        p = solve_continuous_are(a, b, np.diag([*self.angle, *self.rate]) ** 2, r)  # type: ignore[misc]
        return (b.T @ p / r)[0], p

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v = self.read(observation, "position", "velocity")
        nominal, one, other = self.interface.nominal, self.driven, 1 - self.driven
        p4, p5 = nominal.lumped[3:]
        top = p4 + p5
        x = np.concatenate([(q - TOP + np.pi) % (2.0 * np.pi) - np.pi, v], axis=-1)

        m = inertia_matrix(nominal, q)
        kinetic = 0.5 * np.einsum("ni,nij,nj->n", v, m, v)
        energy = kinetic + p4 * np.sin(q[:, 0]) + p5 * np.sin(q[:, 0] + q[:, 1])
        a, pump = np.zeros_like(q), self.pump * v[:, other] * (energy / top - 1.0)
        a[:, one] = -self.stiffness * x[:, one] - self.damping * v[:, one] + pump
        a[:, other] = -self.inverse(q, v, a)[:, other] / m[:, other, other]
        torque = self.inverse(q, v, a)[:, one]

        below = (np.abs(np.abs(x[:, :2]) - [np.pi, 0.0]) < 0.01).all(axis=-1) & (np.abs(v) < 0.01).all(axis=-1)
        torque = np.where(below, 2.0 * top, torque)
        gain, cost = self.regulator
        near = np.einsum("ni,ij,nj->n", x, cost, x) <= self.catch
        torque = np.where(near, -top * (x @ gain), torque)
        return torque[:, None] * np.eye(2)[one], state
