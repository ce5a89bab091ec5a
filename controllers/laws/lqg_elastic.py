"""LQG on the full nominal arm, springs and drives included, and a schedule of its filter."""

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.linalg import expm

from controllers.base import Acting, State, TorqueLaw, number
from controllers.numerics.elastic import brake, follow, move
from controllers.numerics.regulator import ANGLES, COSINES, at_angle, design, regulator
from controllers.preview import Places, between, known_reference, past_reference, places
from fbl_gym.interface import clip
from fbl_gym.model.arm import ArmParameters, Array, inertia_matrix

#: Largest bandwidth of the filter, times a sample's length: a faster one rings.
FASTEST = 0.8

#: Speed of the reference at which dry friction has 0.76 of its size [rad/s].
REVERSAL = 0.03


class LqgState(NamedTuple):
    """State of `LqgElastic`."""

    estimate: Array  # of the arm's state and the disturbance [n x 6], with springs [n x 10]
    acting: Acting
    past: Array  # reference of the last two samples [n x 2 x 6]
    mean: Array  # of d without dry friction [n x 2] N m
    dry: Array  # size of the dry friction [n x 2] N m


@dataclass(frozen=True)
class LqgElastic(TorqueLaw):
    """LQG: an optimal regulator on a Kalman filter of links, springs, motors and a disturbance.

        command = feed-forward - d^ + K (x_r - x^)

    x is the state of links, of motors behind springs, and of the drives. The Kalman filter has the
    nominal arm, the middle of the datasheet's stiffness and damping, and the torque that acts; the
    encoder's reading corrects it, be the encoder on motors or links. It also estimates d, a torque
    on the motors that walks at random: friction, load, wrong parameters. So a motor at rest tells
    how its link swings. x^ is predicted to the time at which the command begins to act. x_r is the
    state along the reference, by inverse dynamics of links, springs, motors and lag.

    The dry friction c is learned from d^, by least mean squares with the regressors 1 and the sign
    s of the reference's velocity. Where the reference turns round, d^ turns at once, by -2 s c.

    Both gains are optimal at rest without gravity, and are interpolated over the cosine of the
    second joint's angle. With rigid joints, x has no motors.

    An error of position asks for a velocity. Where torque is short, the arm cannot brake from it in
    time, and swings. So an error e beyond `near` counts as sqrt(near (2 e - near)): the velocity
    that it asks for falls at the rate which `braking` of the torque limits gives.

    Sensors: position; the velocity only starts the filter. Source: Anderson and Moore, "Optimal
    Control", 1990, §2.4 and §8; De Luca and Book, "Robots with flexible elements", Springer
    Handbook of Robotics, chapter 11; for large errors, Workman, Kosut and Franklin, "Adaptive
    proximate time-optimal servomechanisms", American Control Conference, 1987.

    Args:
        bandwidth: of the regulator without delay and lag [rad/s]; bandwidth^2 is the weight of the
            links' error against 1 for the command over the inertia.
        damping: weight of the error's rate over 2 bandwidth.
        observer: bandwidth w of the filter, where readings have the noise `reading` [rad/s]. In a
            sample of dt, d walks by w^3 reading dt times the inertia of the stretched arm.
        reading: noise of a reading beside that of the data sheet, such as that of its time [rad].
        links: noise of the links' acceleration; 1 counts as much as d's at w.
        friction: time constant with which the dry friction is learned [s].
        braking: share of the torque limits for the braking from a large error.
    """

    bandwidth: float = number(40.0, unit="rad/s", above=0, tune=(10.0, 150.0))
    damping: float = number(0.7, low=0, tune=(0.05, 4.0))
    observer: float = number(60.0, unit="rad/s", above=0, tune=(10.0, 1000.0))
    reading: float = number(1e-4, unit="rad", above=0, tune=(1e-6, 1e-3))
    links: float = number(1.0, above=0, tune=(0.03, 100.0))
    friction: float = number(2.0, unit="s", above=0)
    braking: float = number(0.4, above=0)

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @cached_property
    def springs(self) -> Array:
        """Stiffness [N m/rad], damping [N m s/rad], rotor's inertia [kg m^2] of joints [3 x 2].

        It is [0 x 2] for rigid joints.
        """
        if self.interface.stiffness is None:
            return np.empty((0, 2))
        middle = np.sqrt(np.prod(np.array([self.interface.stiffness, self.interface.damping]), axis=1))
        return np.stack([*middle, self.interface.rotor_inertia])

    @cached_property
    def measured(self) -> slice:
        """Slice of the state that has the position which the encoder reads."""
        return slice(4, 6) if len(self.springs) and self.interface.encoder == "motor" else slice(0, 2)

    @cached_property
    def arm(self) -> ArmParameters:
        """The links, with those rotors that turn with them."""
        nominal = self.interface.nominal
        return replace(nominal, rotor=(0.0, 0.0)) if len(self.springs) else nominal

    @cached_property
    def slope(self) -> Array:
        """Derivative of the state's rate by state and torque, at `ANGLES` [5 x s x (s + 2)]."""
        zero, one, rows = np.zeros((2, 2)), np.eye(2), []
        for m in inertia_matrix(self.arm, ANGLES):
            w = np.linalg.inv(m)
            if not len(self.springs):
                rows.append(np.block([[zero, one, zero], [zero, zero, w]]))
                continue
            k, c, b = (np.diag(x) for x in (*self.springs[:2], 1.0 / self.springs[2]))
            links, motors = [-w @ k, -w @ c, w @ k, w @ c, zero], [b @ k, b @ c, -b @ k, -b @ c, b]
            rows.append(np.block([[zero, one, zero, zero, zero], links, [zero, zero, zero, one, zero], motors]))
        return np.array(rows)

    @cached_property
    def feedback(self) -> Array:
        """K [5 x 2 x (s + 2)]."""
        inertia = np.diagonal(inertia_matrix(self.interface.nominal, ANGLES), axis1=1, axis2=2)
        lag = np.full(len(COSINES), self.drive.lag)
        return design(self.slope, lag, self.interface.control_dt, self.bandwidth, self.damping, inertia)

    @cached_property
    def near(self) -> Array:
        """Error of position up to which its velocity can be braked in time [5 x 1 x 2] rad."""
        gains = self.feedback[..., :-2].reshape(5, 2, -1, 2, 2)  # of position and rate of links and motors
        position, velocity = np.diagonal(gains, axis1=1, axis2=4).sum(axis=1).swapaxes(0, 1)
        inertia = np.diagonal(inertia_matrix(self.interface.nominal, ANGLES), axis1=1, axis2=2)
        limit = np.array(self.interface.torque_limit or (np.inf, np.inf))
        return np.minimum(self.braking * limit / inertia * (velocity / position) ** 2, 1e6)[:, None]

    @cached_property
    def filtering(self) -> Array:
        """Gain of the filter [5 x (s + 2) x 2], for state and disturbance."""
        n, dt, interface = self.slope.shape[-1], self.interface.control_dt, self.interface
        a = np.zeros((len(COSINES), n, n))
        a[:, :-2] = self.slope
        parts = np.array(interface.resolution) / math.sqrt(12.0), np.array(interface.noise_std[0]), self.reading
        f, reading = expm(a * dt), np.sqrt(sum(part**2 for part in parts))
        w = np.minimum(self.observer, FASTEST / dt * np.cbrt(reading / self.reading))
        noise = np.concatenate([np.zeros(2), self.links * w**2, np.zeros(n - 6), w**3 * self.stretched])
        # The filter is the regulator of the transposed system.
        h, q = np.eye(n)[:, self.measured], np.diag((dt * self.reading * noise) ** 2)
        gain = regulator(f.transpose(0, 2, 1), h, q, 1.0 / reading)
        return np.linalg.solve(f, gain.transpose(0, 2, 1))

    def initial(self, observation: Array) -> State:
        """Return the state: the springs carry the nominal arm."""
        q, v = self.read(observation, "position", self.velocity_slot)
        hold, zero, x = self.holding(q), np.zeros_like(q), [q, v]
        if len(self.springs):
            bend = hold / self.springs[0]
            x = [q, v, q + bend, v] if self.interface.encoder == "link" else [q - bend, v, q, v]
        estimate = np.concatenate([*x, zero], axis=1)
        return LqgState(estimate, self.drive.hold(hold), past_reference(self.interface, observation), zero, zero)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        torque, draft = self.decide(observation, state)
        return torque, self.settle(draft, torque)

    def decide(self, observation: Array, state: State) -> tuple[Array, tuple[LqgState, Array]]:
        """Return the torque [n x 2] N m, and a draft for `settle`."""
        known = np.concatenate([state.past, known_reference(self.interface, observation)], axis=1)
        h, motion = self.interface.control_dt, between(known, self._places, self.interface.control_dt)
        now, following, then = np.tanh(motion[:, :3, 2:4] / REVERSAL).transpose(1, 0, 2)
        x = state.estimate
        x = x + _product(at_angle(self.filtering, x[:, 1]), self.read(observation, "position")[0] - x[:, self.measured])
        # Least mean squares of d without dry friction, and of the size of that friction.
        share, innovation = -math.expm1(-h / self.friction), x[:, -2:] + now * state.dry - state.mean
        mean, dry = state.mean + share * innovation, np.maximum(state.dry - share * now * innovation, 0.0)
        ahead, due = self.moved(x, state.acting.torque, state.acting.queue, self.drive.coming)
        # The command leads this state and torque of the drives along the reference.
        d = x[:, -2:] + (now - then) * dry
        error, command = np.empty_like(x), np.empty_like(d)
        follow(self.arm.base[None], self.springs, motion, h, 0.5 * h + self.drive.lag, error, command)
        error[:, :-2] -= ahead[:, :-2]
        error[:, -2:] -= due + d
        brake(error, at_angle(self.near, ahead[:, 1]))
        torque = command - d + _product(at_angle(self.feedback, ahead[:, 1]), error)
        torque = self.sendable(torque, observation)
        return torque, (LqgState(x, state.acting, known[:, 1:3], mean, dry), (now - following) * dry)

    def settle(self, draft: tuple[LqgState, Array], torque: Array) -> LqgState:
        """Return the next state where a torque [n x 2] N m is sent."""
        state, turned = draft
        acting = self.drive.act(state.acting, torque)
        x, _ = self.moved(state.estimate, acting.mean, acting.mean[:, None], np.array([self.drive.dt]))
        x[:, -2:] += turned
        # An arm that diverges may carry the estimate away; its numbers stay finite.
        return state._replace(estimate=clip(x, -1e6, 1e6), acting=acting)

    def moved(self, x: Array, due: Array, commands: Array, durations: Array) -> tuple[Array, Array]:
        """Return states [n x (s + 2)] and the drives' torque [n x 2] N m after some commands.

        The commands [n x m x 2] N m have the newest first, their durations [m] s the oldest.
        """
        x, due = x.copy(), due.copy()
        commands = np.ascontiguousarray(commands)
        move(self.arm.base[None], self.springs, durations, self.drive.lag, self._fastest, commands, x, due)
        return x, due

    @cached_property
    def _fastest(self) -> float:
        """The fastest natural frequency [rad/s]."""
        return float(np.abs(np.linalg.eigvals(self.slope[..., :-2])).max())

    @cached_property
    def _places(self) -> Places:
        """Places of eight times in the reference, which is known from two samples before now.

        Three are for the signs: now, at the next sample, and when the command begins to act. Five
        lie about this last one, for differences.
        """
        dt, latency, delay = self.interface.control_dt, self.interface.latency, self.drive.delay
        signs = 2.0 * dt - latency + np.array([0.0, dt, delay])
        times = np.concatenate([signs, delay - latency + dt * np.arange(5.0)])
        return places(dt, 2 + len(self.interface.layout.reference) // 6, times)


class ScheduledState(NamedTuple):
    """State of `LqgElasticScheduled`."""

    careful: State
    fast: State
    apart: Array  # difference of the two torques at the last sample, over the inertia [n x 2] rad/s^2
    change: Array  # running mean square of its change over a sample [n x 2] rad^2/s^4


@dataclass(frozen=True)
class LqgElasticScheduled(LqgElastic):
    """A mix of a careful and a fast `LqgElastic`; an oscillation shifts it to the careful one.

        torque = s careful + (1 - s) fast,    s = c^2 / (c^2 + onset^4)

    c is the mean square of the change, over one sample, of the difference between both torques
    over the inertia, for each joint. The agent `ppo-blend` chooses s by a network; this is a fixed
    rule in its place. Both laws get the torque that is sent.

    Sensors: position. Source: Rugh and Shamma, "Research on gain scheduling", Automatica 36(10),
    2000, for the method; the rule itself is this package's.

    Args:
        careful: bandwidth of the careful law's filter, in multiples of `observer`.
        fast: that of the fast law's filter, in multiples of `observer`.
        onset: root of c at which both have equal shares [rad/s^2].
        memory: time constant of the mean square [s].
    """

    careful: float = number(0.5, above=0)
    fast: float = number(1.3, above=0)
    onset: float = number(12.0, unit="rad/s^2", low=1e-6, high=1e6)
    memory: float = number(0.3, unit="s", above=0)

    def validate(self) -> None:
        """Refuse a careful law that is not slower than the fast one."""
        super().validate()
        if not self.careful < self.fast:
            raise ValueError(f"careful must be less than fast={self.fast:g}, got {self.careful:g}")

    @cached_property
    def both(self) -> tuple[LqgElastic, LqgElastic]:
        """The careful and the fast law."""
        gains = {each.name: getattr(self, each.name) for each in fields(LqgElastic)}
        careful, fast = (LqgElastic(**gains | {"observer": self.observer * each}) for each in (self.careful, self.fast))
        return careful, fast

    def initial(self, observation: Array) -> State:
        """Return the state: that of both laws, without an oscillation."""
        careful, fast = (law.initial(observation) for law in self.both)
        zero = np.zeros((len(observation), 2))
        return ScheduledState(careful, fast, zero, zero)

    def decide(self, observation: Array, state: State) -> tuple[Array, Any]:
        """Return the torque [n x 2] N m, and a draft for `settle`."""
        (careful, first), (fast, second) = (law.decide(observation, state[i]) for i, law in enumerate(self.both))
        apart = (careful - fast) / self.stretched
        weight = min(1.0, self.interface.control_dt / self.memory)
        change = state.change + weight * ((apart - state.apart) ** 2 - state.change)
        share = change**2 / (change**2 + self.onset**4)
        return fast + share * (careful - fast), ScheduledState(first, second, apart, change)

    def settle(self, draft: Any, torque: Array) -> State:
        """Return the next state where a torque [n x 2] N m is sent."""
        sent = torque if self.drive.sent is None else self.drive.sent
        careful, fast = (law.settle(each, sent) for law, each in zip(self.both, draft[:2], strict=True))
        return draft._replace(careful=careful, fast=fast)


def _product(matrix: Array, vector: Array) -> Array:
    return np.einsum("nij,nj->ni", matrix, vector)
