"""LQG on the full nominal arm, springs and drives included, and what it shares with the ceiling."""

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.linalg import expm

from controllers.base import State, TorqueLaw, between, known_reference, sampled_at
from controllers.numerics.dynamics import forward_dynamics, inverse_dynamics
from controllers.parts import Acting
from fbl_gym.interface import Interface, clip
from fbl_gym.model.arm import ArmParameters, Array, inertia_matrix
from fbl_gym.records.record import number

COSINES = np.linspace(-1.0, 1.0, 5)
"""Cosines of the second joint's angle for which gains are computed."""

ANGLES = np.stack([np.zeros_like(COSINES), np.arccos(COSINES)], axis=-1)
"""The joints' angles there [5 x 2] rad."""


RATES = np.gradient(np.eye(5), axis=0, edge_order=2)
"""Differences of second order over five samples."""

FASTEST = 0.8
"""Largest bandwidth of the filter, times a sample's length: a faster one rings."""

REVERSAL = 0.03
"""Speed of the reference at which dry friction has 0.76 of its size [rad/s]."""


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
    damping: float = number(0.7, low=0, tune=(0.05, 2.0))
    observer: float = number(60.0, unit="rad/s", above=0, tune=(10.0, 1000.0))
    reading: float = number(1e-4, unit="rad", above=0, tune=(1e-6, 1e-3))
    links: float = number(1.0, above=0, tune=(0.03, 30.0))
    friction: float = number(2.0, unit="s", above=0)
    braking: float = number(0.4, above=0)

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @cached_property
    def springs(self) -> Array | None:
        """Stiffness [N m/rad] and damping [N m s/rad] of the joints [2 x 2]; None: rigid ones."""
        ranges = self.interface.stiffness, self.interface.damping
        return None if ranges[0] is None else np.sqrt(np.prod(np.array(ranges), axis=1))

    @cached_property
    def measured(self) -> slice:
        """Slice of the state that has the position which the encoder reads."""
        return slice(0, 2) if self.springs is None or self.interface.encoder == "link" else slice(4, 6)

    @cached_property
    def arm(self) -> ArmParameters:
        """The links, with those rotors that turn with them."""
        nominal = self.interface.nominal
        return nominal if self.springs is None else dataclasses.replace(nominal, rotor=(0.0, 0.0))

    @cached_property
    def rotor(self) -> Array:
        """Inertia of the rotors behind springs [2] kg m^2."""
        return np.array(self.interface.rotor_inertia)

    @cached_property
    def slope(self) -> Array:
        """Derivative of the state's rate by state and torque, at `ANGLES` [5 x s x (s + 2)]."""
        zero, one, rows = np.zeros((2, 2)), np.eye(2), []
        for m in inertia_matrix(self.arm, ANGLES):
            w = np.linalg.inv(m)
            if self.springs is None:
                rows.append(np.block([[zero, one, zero], [zero, zero, w]]))
                continue
            (k, c), b = (np.diag(x) for x in self.springs), np.diag(1.0 / self.rotor)
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
        slot = "velocity" if "velocity" in self.interface.layout else "reference_velocity"
        (q, v), hold = self.read(observation, "position", slot), self.holding(self.read(observation, "position")[0])
        x = [q, v]
        if self.springs is not None:
            bend = hold / self.springs[0]
            x = [q, v, q + bend, v] if self.interface.encoder == "link" else [q - bend, v, q, v]
        estimate = np.concatenate([*x, np.zeros_like(q)], axis=1)
        zero = np.zeros_like(q)
        return LqgState(estimate, self.drive.hold(hold), past_reference(self.interface, observation), zero, zero)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        torque, draft = self.decide(observation, state)
        return torque, self.settle(draft, torque)

    def decide(self, observation: Array, state: State) -> tuple[Array, tuple[LqgState, Array]]:
        """Return the torque [n x 2] N m, and a draft for `settle`."""
        (position,), x, drive = self.read(observation, "position"), state.estimate, self.drive
        dt, latency = self.interface.control_dt, self.interface.latency
        x = x + _product(at_angle(self.filtering, x[:, 1]), position - x[:, self.measured])
        known = np.concatenate([state.past, known_reference(self.interface, observation)], axis=1)
        # The signs now, at the next sample, and when the command begins to act.
        course = sampled_at(known, dt, 2.0 * dt - latency + np.array([0.0, dt, drive.delay]))
        now, following, then = np.moveaxis(np.tanh(course[..., 2:4] / REVERSAL), 1, 0)
        innovation = x[:, -2:] + now * state.dry - state.mean
        share = -math.expm1(-dt / self.friction)
        mean = state.mean + share * innovation
        dry = np.maximum(state.dry - share * now * innovation, 0.0)
        ahead, due, d = x, state.acting.torque, x[:, -2:] + (now - then) * dry
        for h, command in drive.coming(state.acting.queue):
            if h > 0.0:
                keep = math.exp(-h / drive.lag) if drive.lag > 0.0 else 0.0
                ahead = self.moved(ahead, command + drive.lag * (1.0 - keep) / h * (due - command), h)
                due = command + keep * (due - command)
        wanted, command = self.course(known)
        error = wanted - np.concatenate([ahead[:, :-2], due + d], axis=1)
        near = at_angle(self.near, ahead[:, 1])[:, 0]
        far = np.maximum(np.abs(error[:, :2]), near)
        excess = np.sign(error[:, :2]) * (far - np.sqrt(near * (2.0 * far - near)))
        for body in range(0, error.shape[1] - 2, 4):  # links, and motors behind springs
            error[:, body : body + 2] -= excess
        torque = command - d + _product(at_angle(self.feedback, ahead[:, 1]), error)
        motion = self.measured_motion(observation)
        torque = self.interface.torque_from_action(self.interface.action_from_torque(torque, *motion), *motion)
        return torque, (LqgState(x, state.acting, known[:, 1:3], mean, dry), (now - following) * dry)

    def settle(self, draft: tuple[LqgState, Array], torque: Array) -> LqgState:
        """Return the next state where a torque [n x 2] N m is sent."""
        state, turned = draft
        acting = self.drive.act(state.acting, torque)
        x = self.moved(state.estimate, acting.mean, self.interface.control_dt)
        x[:, -2:] += turned
        # An arm that diverges may carry the estimate away; its numbers stay finite.
        return state._replace(estimate=clip(x, -1e6, 1e6), acting=acting)

    def moved(self, x: Array, torque: Array, h: float) -> Array:
        """Return state and disturbance after h [s] of a torque [n x 2] N m, by leapfrog steps."""
        q, v, *motor, d = np.ascontiguousarray(x.reshape(len(x), -1, 2).swapaxes(0, 1))
        steps = max(1, math.ceil(max(3.0 * h * self._fastest, h / 0.005) - 1e-9))
        h, torque = h / steps, torque + d
        for _ in range(steps):
            q, load = q + 0.5 * h * v, torque
            if self.springs is not None:
                (m, w), (k, c) = motor, self.springs
                m = m + 0.5 * h * w
                load = k * (m - q) + c * (w - v)
                w = w + h * (torque - load) / self.rotor
                motor = [m + 0.5 * h * w, w]
            v = v + h * forward_dynamics(self.arm, q, v, load)
            q = q + 0.5 * h * v
        return np.concatenate([q, v, *motor, d], axis=1)

    @cached_property
    def _fastest(self) -> float:
        """The fastest natural frequency [rad/s]."""
        return float(np.abs(np.linalg.eigvals(self.slope[..., :-2])).max())

    def course(self, known: Array) -> tuple[Array, Array]:
        """Return the state along the reference [n x (s + 2)], and the feed-forward [n x 2] N m.

        The known reference [n x k x 6] begins two samples before now.
        """
        h = self.interface.control_dt
        # Differences over five times. At the middle one the command begins to act.
        times = self.drive.delay - self.interface.latency + h * np.arange(5.0)
        r, r_dot, r_ddot = np.moveaxis(sampled_at(known, h, times).reshape(len(known), 5, 3, 2), 2, 0)
        load, motion = inverse_dynamics(self.arm, r, r_dot, r_ddot), [r, r_dot]
        if self.springs is not None:
            (k, c), change = self.springs, rate(load, h)
            motion += [r + load / k - c * change / k**2, r_dot + change / k]
            load = load + self.rotor * (r_ddot + rate(change, h) / k)
        x = np.concatenate([part[:, 2] for part in (*motion, load)], axis=1)
        return x, x[:, -2:] + (0.5 * h + self.drive.lag) * rate(load, h)[:, 2]


def design(slope: Array, lag: Array, dt: float, bandwidth: float, damping: float, inertia: Array) -> Array:
    """Return the gain K [... x 2 x (s + 2)] on the error of a state and of the drives' torque.

    Args:
        slope: derivative of the state's rate by state and torque [... x s x (s + 2)].
        lag: of the drives [...] s; at least 1 ms is used.
        dt: control interval [s].
        bandwidth: bandwidth^2 is the weight of the links' position [rad/s].
        damping: weight of their velocity over 2 bandwidth.
        inertia: the command over this is weighted with 1 [... x 2] kg m^2.
    """
    size = slope.shape[-1]
    a = np.zeros((*slope.shape[:-2], size + 2, size + 2))
    a[..., : size - 2, :size] = slope
    drive = np.concatenate([-np.eye(2), np.eye(2)], axis=1)
    a[..., size - 2 : size, size - 2 :] = drive / np.maximum(lag, 1e-3)[..., None, None]
    exact = expm(a * dt)
    q = np.zeros(size)
    q[0:2], q[2:4] = bandwidth**4, (2.0 * damping * bandwidth) ** 2
    return regulator(exact[..., :size, :size], exact[..., :size, size:], np.diag(q), inertia)


def regulator(f: Array, g: Array, q: Array, scale: Array) -> Array:
    """Return the gain K [... x m x n] of the optimal regulators u = -K x of x+ = f x + g u.

    The cost is the sum of x'qx + |u / scale|^2, scale [... x m]. The Riccati equation is solved by
    doubling: each turn takes twice as many samples into account (Chu, Fan, Lin and Wang,
    "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations", Int.
    J. Control 77(8), 2004).
    """
    weighted = g * scale[..., None, :]
    a, b, p = f, weighted @ np.swapaxes(weighted, -1, -2), np.broadcast_to(q, f.shape)
    for _ in range(10):
        left = np.linalg.solve(np.eye(f.shape[-1]) + b @ p, np.concatenate([a, np.broadcast_to(b, a.shape)], axis=-1))
        wa, wb = np.split(left, 2, axis=-1)
        turned = np.swapaxes(a, -1, -2)
        a, b, p = a @ wa, b + a @ wb @ turned, p + turned @ p @ wa
    to = np.swapaxes(weighted, -1, -2) @ p
    return scale[..., None] * np.linalg.solve(np.eye(g.shape[-1]) + to @ weighted, to @ f)


def at_angle(gains: Array, angle: Array) -> Array:
    """Return gains [n x a x b] at an angle of the second joint [n] rad.

    Those at `COSINES` are [n x 5 x a x b], or [5 x a x b] for all lanes.
    """
    index = (np.cos(angle) + 1.0) / (COSINES[1] - COSINES[0])
    low = np.fmin(index, len(COSINES) - 2).astype(int)  # of NaN, too
    share, lanes = (index - low)[:, None, None], np.arange(len(angle))
    gains = np.broadcast_to(gains, (len(angle), *gains.shape[-3:]))
    return (1.0 - share) * gains[lanes, low] + share * gains[lanes, low + 1]


def past_reference(interface: Interface, observation: Array) -> Array:
    """Return the reference of two samples before now [n x 2 x 6], its acceleration held."""
    dt, now = interface.control_dt, known_reference(interface, observation)[:, :1]
    return between(now, now, -dt * np.array([[2.0], [1.0]]), dt)


def rate(x: Array, h: float) -> Array:
    """Return the derivative over time of samples [n x 5 x 2] that lie h [s] apart."""
    return RATES @ x / h


def _product(matrix: Array, vector: Array) -> Array:
    return np.einsum("nij,nj->ni", matrix, vector)
