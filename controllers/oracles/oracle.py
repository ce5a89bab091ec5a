"""Oracles, which read the real arm from `env.truth`. They are not ranked."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from controllers.base import Gain, Law, State, number, pair
from controllers.numerics.elastic import rate
from controllers.numerics.regulator import ANGLES, COSINES, at_angle, design
from controllers.oracles.true_arm import TrueArm
from controllers.preview import known_reference, past_reference, sampled_at
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array, inertia_matrix, inverse_dynamics, with_rotors

#: How far ahead the oracles that predict use the reference [s].
PREVIEW = 0.15


@dataclass(frozen=True)
class _Oracle(Law):
    """Base of the oracles. Each acts only in the environment that it was built for."""

    env: Any = field(repr=False)

    access: ClassVar[str] = "oracle"

    @property
    def interface(self) -> Interface:  # type: ignore[override]
        """The environment's interface."""
        return self.env.interface

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque command [n x 2] N m, and the next state."""
        arm = TrueArm.of(self.env)
        torque, state = self.drive(observation, arm, state)
        gain = arm.truth.gain  # 0 of a drive that has failed
        return np.divide(torque, gain, out=np.zeros_like(torque), where=gain != 0.0), state

    def drive(self, observation: Array, arm: TrueArm, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m that the drives are asked for, and the next state."""
        raise NotImplementedError


@dataclass(frozen=True)
class OracleFlm(_Oracle):
    """The oracle: feedback linearisation that knows everything but delay, lag and springs.

        torque = M a + C v + G + friction + d,    a = r'' + kp (r - q) + kd (r' - v)

    All terms are true ones, and e'' + kd e' + kp e = 0 up to sampling and torque limits. The dry
    friction is that along the reference, whose sign is steady.

    Args:
        env: the environment, single or batched.
        kp: proportional gain [1/s^2], per joint.
        kd: derivative gain [1/s], per joint.
    """

    kp: Gain = pair(400.0, unit="1/s^2")
    kd: Gain = pair(40.0, unit="1/s")

    def drive(self, observation: Array, arm: TrueArm, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m that the drives are asked for, and `state` unchanged."""
        truth, v = arm.truth, arm.truth.velocity
        error, rate = truth.reference - truth.position, truth.reference_velocity - v
        a = truth.reference_acceleration + np.array(self.kp) * error + np.array(self.kd) * rate
        load = inverse_dynamics(with_rotors(truth.lumped, truth.rotor), truth.position, v, a)
        dry = arm.dry(v) * np.sign(truth.reference_velocity)
        return load + (truth.viscous * v + dry) + truth.disturbance, state


class ElasticState(NamedTuple):
    """State of `OracleElastic`."""

    design: Array  # parameters of each arm that gains were computed for [n x 14]; NaN: none yet
    gains: Array  # [n x 5 x 2 x size]
    past: Array  # reference of the last two samples [n x 2 x 6]


@dataclass(frozen=True)
class OracleElastic(_Oracle):
    """The oracle of springs in joints and links: an optimal regulator on the full true state.

        command = feed-forward + K (x_r - x)

    x is the state of links, hinges, motors and drives, predicted with the true arm to the time at
    which the command begins to act. x_r is its course along the reference, by inverse dynamics of
    straight links, springs, motors and lag. K is the gain of the discrete optimal regulator for
    each lane's true arm, linearised at rest without gravity, with the lag of its drives, and
    interpolated over the cosine of the second joint's angle. Where joints or links are rigid, their
    motors or hinges are left out.

    Source: Anderson and Moore, "Optimal Control", 1990, §2.4; De Luca and Book, "Robots with
    flexible elements", Springer Handbook of Robotics, chapter 11.

    Args:
        env: the environment, single or batched.
        bandwidth: of the regulator without delay and lag [rad/s]; bandwidth^2 is the weight of the
            links' error against 1 for the command over the inertia.
        damping: weight of the error's rate over 2 bandwidth.
    """

    bandwidth: float = number(40.0, unit="rad/s", above=0)
    damping: float = number(0.5, low=0)

    preview: ClassVar[float] = PREVIEW

    def initial(self, observation: Array) -> State:
        """Return the state before any gains are computed."""
        n, size = TrueArm.of(self.env).state.shape
        past = past_reference(self.interface, observation)
        return ElasticState(np.full((n, 14), np.nan), np.zeros((n, len(COSINES), 2, size)), past)

    def drive(self, observation: Array, arm: TrueArm, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m that the drives are asked for, and the gains."""
        truth, gains = arm.truth, state.gains
        columns = truth.lumped, truth.stiffness, truth.damping, truth.viscous, truth.lag[:, None], truth.bend_rate
        design = np.concatenate(columns, axis=-1)
        changed = np.any(design != state.design, axis=-1)
        if changed.any():
            gains = gains.copy()
            gains[changed] = self.gains(arm.of_lanes(changed))
        x = arm.predicted()
        gain = at_angle(gains, x[:, 1])
        known = np.concatenate([state.past, known_reference(self.interface, observation)], axis=1)
        wanted, command = self.course(known, arm, x[:, :2])
        return command + np.einsum("nij,nj->ni", gain, wanted - x), ElasticState(design, gains, known[:, 1:3])

    def course(self, known: Array, arm: TrueArm, position: Array) -> tuple[Array, Array]:
        """Return the state along the reference, and the feed-forward command [n x 2] N m.

        The known reference begins two samples before now. The position is that of the links.
        """
        truth, h = arm.truth, arm.scenario.control_dt
        # Differences over five times. At the middle one the command begins to act.
        r, r_dot, r_ddot = np.split(sampled_at(known, h, truth.delay[:, None] + h * np.arange(5.0)), 3, axis=-1)
        load = inverse_dynamics(arm.links[:, None], r, r_dot, r_ddot) + truth.disturbance[:, None]
        motion = [r, r_dot]
        if arm.scenario.link is not None:  # bent by weight and acceleration
            bend = self.bend(arm, r, r_dot, r_ddot)
            motion += [bend, rate(bend, h)]
        if arm.elastic:
            stiffness = truth.stiffness[:, None]
            stretch = load / stiffness
            stretch = stretch - truth.damping[:, None] * rate(stretch, h) / stiffness
            stretch = stretch + 0.5 * truth.backlash[:, None] * np.clip(load / (0.01 * stiffness), -1.0, 1.0)
            motion += [r + stretch, r_dot + rate(load, h) / stiffness]
            load = load + truth.rotor[:, None] * (r_ddot + rate(rate(load, h), h) / stiffness)
        x = np.concatenate(motion, axis=-1)
        toward = r_dot[:, 2] + 10.0 * (r[:, 2] - position)
        load = load + truth.viscous[:, None] * x[..., arm.side]
        torque = load[:, 2] + arm.dry(x[:, 2, arm.side]) * np.clip(toward / 0.02, -1.0, 1.0)
        command = torque + (0.5 * h + truth.lag[:, None]) * rate(load, h)[:, 2]
        return np.concatenate([x[:, 2], torque], axis=-1), command

    def bend(self, arm: TrueArm, r: Array, r_dot: Array, r_ddot: Array) -> Array:
        """Return the bend of the hinges under a motion of the joints, [n x 5 x 2] each."""
        x = np.concatenate([r, r_dot, np.zeros((*r.shape[:2], 4))], axis=-1)
        chains = [arm.chain(x[:, i]) for i in range(5)]
        carried = [load - np.einsum("nij,nj->ni", m[..., :2], r_ddot[:, i]) for i, (m, load) in enumerate(chains)]
        stiffness, _ = arm.scenario.link.springs(arm.scenario.arm, arm.truth.bend_rate)  # type: ignore[union-attr]
        return np.stack(carried, axis=1)[..., 2:] / stiffness[:, None]

    def gains(self, arm: TrueArm) -> Array:
        """Return K of each lane at each of `COSINES` [n x 5 x 2 x size]."""
        truth, dt = arm.truth, arm.scenario.control_dt
        m = inertia_matrix(with_rotors(truth.lumped, truth.rotor)[:, None], ANGLES[None])
        slope, lag = arm.linear(ANGLES[:, 1]), truth.lag[:, None]
        return design(slope, lag, dt, self.bandwidth, self.damping, m[..., [0, 1], [0, 1]])
