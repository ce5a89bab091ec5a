"""Laws that learn the torque that the model misses: by a Gaussian process, a network, trials."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from controllers.base import Gain, State, TorqueLaw
from controllers.laws.computed_torque import ComputedTorque
from controllers.numerics.dynamics import inverse_dynamics
from controllers.parts import Acting
from fbl_gym.model.arm import STANDARD_GRAVITY, Array, coriolis_matrix, gravity_torque, inertia_matrix
from fbl_gym.records.record import number, pair

#: Random cosines.
COSINES = 40

#: Length scales of the kernel: angles [rad], velocities [rad/s], accelerations [rad/s^2].
LENGTHS = np.array([1.0, 1.0, 2.0, 2.0, 5.0, 5.0])

#: Standard deviation of the process: the torque missed, as a share of the arm's weight.
SIGNAL = 0.3


class GpState(NamedTuple):
    """State of `ComputedTorqueGp`."""

    acting: Acting
    velocity: Array  # at the last sample [n x 2] rad/s
    weights: Array  # their mean [n x 2 x COSINES]
    covariance: Array  # of the weights [n x COSINES x COSINES]


@dataclass(frozen=True)
class ComputedTorqueGp(ComputedTorque):
    """Computed torque plus the mean of a Gaussian process, learned online.

        torque = M a + C v + G + f^(r, r', r''),    a = r'' + w^2 (r - q) + 2 w (r' - v)
        f^ = mean of a Gaussian process given the samples y = torque - (M q'' + C v + G)

    A sample y is the mean torque of an interval less that of the model, with q'' the velocity's
    difference, as a share of the nominal arm's weight. The covariance of two samples is SIGNAL^2
    z(x)'z(x') exp(-|t - t'| / memory). z are random cosines, with z(x)'z(x') near exp(-|x - x'|^2 /
    2), and x is the reference motion in units of `LENGTHS`. A Kalman filter of the cosines' weights
    gives the exact mean. Delay and lag of the drive are known: each torque is counted where it
    acts.

    Sensors: position and velocity. Source: Nguyen-Tuong and Peters, "Using model knowledge for
    learning inverse dynamics", ICRA 2010; Gijsberts and Metta, "Real-time model learning using
    incremental sparse spectrum Gaussian process regression", Neural Networks 41, 2013; Hartikainen
    and Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process regression
    models", MLSP 2010.

    Args:
        memory: correlation time of the missing torque [s]; older samples count less.
        noise: standard deviation of y's noise, as a share of the weight.
    """

    frequency: Gain = 10.0
    memory: float = number(20.0, unit="s", above=0, tune=(2.0, 100.0))
    noise: float = number(0.1, above=0, tune=(0.01, 3.0))

    @cached_property
    def weight(self) -> Array:
        """Torque that holds the stretched nominal arm, or moves it by 9.81 rad/s^2 [2] N m."""
        hold = np.abs(gravity_torque(self.interface.nominal, np.zeros(2)))
        return np.maximum(hold, STANDARD_GRAVITY * self.stretched)

    @cached_property
    def spectrum(self) -> tuple[Array, Array]:
        """Frequencies [6 x COSINES] and phases [COSINES] of the cosines, always the same."""
        rng = np.random.default_rng(0)
        return rng.normal(size=(6, COSINES)) / LENGTHS[:, None], rng.uniform(0.0, 2.0 * np.pi, COSINES)

    def initial(self, observation: Array) -> State:
        """Return the state: torques that hold the nominal arm still, and the weights' prior."""
        n = len(observation)
        q, v = self.read(observation, "position", "velocity")
        mean = inverse_dynamics(self.interface.nominal, q, v, np.zeros_like(v))
        prior = np.zeros((n, 2, COSINES)), np.tile(SIGNAL**2 * np.eye(COSINES), (n, 1, 1))
        return GpState(self.drive.hold(self.holding(q))._replace(mean=mean), v, *prior)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        motion = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        nominal, dt = self.interface.nominal, self.interface.control_dt
        frequencies, phases = self.spectrum
        z = np.sqrt(2.0 / COSINES) * np.cos(np.concatenate(motion, axis=-1) @ frequencies + phases)
        last = state.velocity
        y = (state.acting.mean - inverse_dynamics(nominal, q, 0.5 * (v + last), (v - last) / dt)) / self.weight
        # The weights decay towards the prior, then the sample corrects them.
        keep = np.exp(-dt / self.memory)
        covariance = keep**2 * state.covariance + (1.0 - keep**2) * SIGNAL**2 * np.eye(COSINES)
        spread = (covariance @ z[:, :, None])[..., 0]
        gain = spread / (self.noise**2 + (z * spread).sum(axis=-1, keepdims=True))
        covariance = covariance - gain[:, :, None] * spread[:, None, :]
        weights = keep * state.weights
        weights = weights + (y - (weights @ z[:, :, None])[..., 0])[:, :, None] * gain[:, None, :]
        learned = (weights @ z[:, :, None])[..., 0]
        torque = inverse_dynamics(nominal, q, v, self.acceleration(observation, q, v)) + self.weight * learned
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        return torque, GpState(acting, v, weights, covariance)


#: Basis functions around the circle of one joint angle.
NODES = 6

#: Unit of the network's accelerations [rad/s^2]: the largest of a move by two radians in 1.5 s.
ACCELERATION = 5.0

#: Speed over which the network's friction changes its sign [rad/s].
TURN = 0.05

#: Inputs of the network's weights.
FEATURES = NODES**2 + 2 * NODES + 2


def bumps(angle: Array) -> Array:
    """Return the basis functions of an angle, normalised to length one, [... x NODES].

    exp((cos(x - c) - 1) / s^2) about centres c evenly round the circle, s their distance.
    """
    distance = 2.0 * np.pi / NODES
    values = np.exp((np.cos(angle[..., None] - distance * np.arange(NODES)) - 1.0) / distance**2)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def features(q: Array, v: Array, a: Array) -> Array:
    """Return phi, the features of a motion [n x FEATURES].

    Lewis's partitioned network: gravity over both angles, inertia over the second angle in
    proportion to acceleration, friction over the signs of the velocities.
    """
    n = len(q)
    first, second = bumps(q[:, 0]), bumps(q[:, 1])
    gravity = (first[:, :, None] * second[:, None, :]).reshape(n, -1)
    inertia = (second[:, :, None] * (a / ACCELERATION)[:, None, :]).reshape(n, -1)
    return np.concatenate([gravity, inertia, np.tanh(v / TURN)], axis=-1)


class RbfState(NamedTuple):
    """State of `RbfAdaptive`."""

    weights: Array  # W [n x 2 x FEATURES]


@dataclass(frozen=True)
class RbfAdaptive(TorqueLaw):
    """Neural adaptive control with radial basis functions.

        torque = M (a_r + k s) + C v_r + G + D W' phi
        dW/dt = rate (phi s' - forget |s| W)
        s = e' + l e,    v_r = r' + l e,    a_r = r'' + l e'

    The features phi are taken along the reference, so they are free of noise. D is the nominal
    inertia of the bent arm (q2 = 90 degrees), so the network's outputs are accelerations.
    Forgetting (e-modification) keeps |W_i| below max |phi| / forget without excitation. A joint's
    weights are held while its torque is cut off and s asks for more.

    Sensors: position and velocity. Source: Lewis, Jagannathan and Yesildirek, "Neural Network
    Control of Robot Manipulators and Nonlinear Systems", 1999, ch. 4.

    Args:
        error_rate: l [1/s], per joint: the error's pole where s = 0 is -l.
        gain: k [1/s], per joint.
        rate: learning rate [1/s^2], per joint. At a constant reference the learned gravity acts as
            an integrator: s'' + k s' + rate s = 0 for a joint alone.
        forget: strength of forgetting.
    """

    error_rate: Gain = pair(10.0, unit="1/s", above=0, tune=(2.0, 40.0))
    gain: Gain = pair(15.0, unit="1/s", above=0, tune=(3.0, 60.0))
    rate: Gain = pair(40.0, unit="1/s^2", above=0, tune=(10.0, 3000.0))
    forget: float = number(0.03, low=0, tune=(1e-4, 1.0))

    def initial(self, observation: Array) -> State:
        """Return the state: the weights W [n x 2 x FEATURES], zero."""
        return RbfState(np.zeros((len(observation), 2, FEATURES)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next weights."""
        q, v = self.read(observation, "position", "velocity")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        nominal, error_rate = self.interface.nominal, np.array(self.error_rate)
        v_r, a_r = r_dot + error_rate * (r - q), r_ddot + error_rate * (r_dot - v)
        s, phi = v_r - v, features(r, r_dot, r_ddot)
        inertia, coriolis = inertia_matrix(nominal, q), coriolis_matrix(nominal, q, v, skew=True)
        model = np.einsum("nij,nj->ni", inertia, a_r + np.array(self.gain) * s)
        model = model + np.einsum("nij,nj->ni", coriolis, v_r) + gravity_torque(nominal, q)
        torque = model + self.learned(state.weights, phi)
        learns = (torque - self.interface.saturate(torque)) * s <= 0.0
        # Forgetting is implicit, which is stable at every size of s.
        step = (self.interface.control_dt * np.array(self.rate) * learns)[..., None]
        size = np.linalg.norm(s, axis=-1)[:, None, None]
        weights = (state.weights + step * s[..., None] * phi[:, None, :]) / (1.0 + step * self.forget * size)
        return torque, RbfState(weights)

    def learned(self, weights: Array, phi: Array) -> Array:
        """Return the network's torque [n x 2] N m."""
        return np.einsum("nif,nf->ni", weights, phi) @ inertia_matrix(self.interface.nominal, (0.0, np.pi / 2))


#: Samples of a trial that the state has room for at first. The room doubles when it is full.
CAPACITY = 64


class IlcState(NamedTuple):
    """State of `ComputedTorqueIlc`."""

    step: Array  # of the trial [n]
    longest: Array  # steps of the longest trial [n]
    start: Array  # of the reference [n x 2] rad
    u: Array  # u_k [n x capacity x 2] rad/s^2
    e: Array  # e_k [n x capacity x 2] rad


@dataclass(frozen=True)
class ComputedTorqueIlc(ComputedTorque):
    """Computed torque with iterative learning control of PD type.

        torque = M(q) (a + u_k) + C v + G,    a = r'' + w^2 e_k + 2 w (r' - v)
        u_1 = 0,    u_k+1(t) = Q [u_k(t) + gain (w^2 e_k + 2 w e_k')(t + lead)],    e = r - q

    k counts the trials. A trial is an episode; the next one begins with `episode_start`. e' is the
    central difference of the finished trial, so the measured velocity, which is late, leaves no
    error. Q is a Gaussian filter of the finished trial in both directions, without phase. The lead
    is the known delay and lag of the drive (their middle), and a sample.

    On the nominal arm, w^2 e + 2 w e' = T (d - u) for a missing acceleration d that repeats, with
    T = (2 w s + w^2) / (s + w)^2. At each frequency u then approaches its limit by the factor
    |Q (1 - gain T)| < 1 from trial to trial, for a gain up to 1.

    The law forgets what it has learned when a trial is shorter than one before, since the arm has
    diverged, and when the reference begins elsewhere, since the motion is another one.

    Sensors: position and velocity. Source: Bristow, Tharayil and Alleyne, "A survey of iterative
    learning control", IEEE Control Systems Magazine 26(3), 2006, (4) with PD-type design; Arimoto,
    Kawamura and Miyazaki, "Bettering operation of robots by learning", J. Robotic Systems 1(2),
    1984.

    Args:
        frequency: w of `ComputedTorque` [rad/s], per joint.
        gain: share of the feedback that the next trial applies in advance.
        bandwidth: frequency at which Q is 0.71 [rad/s].
    """

    frequency: Gain = 10.0
    gain: float = number(0.5, low=0, high=1, tune=(0.1, 1.0))
    bandwidth: float = number(15.0, unit="rad/s", above=0, tune=(5.0, 60.0))

    @cached_property
    def lead(self) -> int:
        """Samples from a command to the error that it acts on."""
        return int((self.drive.delay + self.drive.lag) / self.drive.dt + 1.5 + 1e-9)

    def initial(self, observation: Array) -> State:
        """Return the state before the first trial."""
        (start,) = self.read(observation, "reference_position")
        count, signal = np.zeros(len(start), dtype=int), np.zeros((len(start), CAPACITY, 2))
        return IlcState(count, count, start, signal, signal)

    def restart(self, observation: Array, state: State) -> State:
        """Return the state before the next trial, with u of it."""
        new = self.initial(observation)
        last, samples = np.maximum(state.step - 1, 0)[:, None], np.arange(state.u.shape[1])

        def held(signal: Array, sample: NDArray[np.int_]) -> Array:
            return np.take_along_axis(signal, np.minimum(sample, last)[..., None], axis=1)

        w, dt = np.array(self.frequency), self.interface.control_dt
        coming = held(state.e, samples + self.lead)
        p = w**2 * coming + 2.0 * w * np.gradient(coming, dt, axis=1)
        width = math.sqrt(math.log(2.0)) / (self.bandwidth * dt)
        u = gaussian_filter1d(held(state.u, samples) + self.gain * p, width, axis=1, mode="nearest")
        again = (state.start == new.start).all(axis=1)
        u = np.where((again & (state.step >= state.longest))[:, None, None], u, 0.0)
        longest = np.where(again, np.maximum(state.step, state.longest), 0)
        return IlcState(new.step, longest, new.start, u, np.zeros_like(state.e))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        step, u, e = state.step, state.u, state.e
        if step.max() >= u.shape[1]:
            u, e = (np.concatenate([signal, np.zeros_like(signal)], axis=1) for signal in (u, e))
        q, v, r = self.read(observation, "position", "velocity", "reference_position")
        now, e = (np.arange(len(step)), step), e.copy()
        e[now] = r - q
        a = self.acceleration(observation, q, v) + u[now]
        return inverse_dynamics(self.interface.nominal, q, v, a), state._replace(step=step + 1, u=u, e=e)
