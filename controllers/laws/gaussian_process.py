"""Computed torque with a sparse Gaussian process that learns the torque that the model misses."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from controllers.base import Acting, Gain, State, number
from controllers.laws.computed_torque import ComputedTorque
from fbl_gym.model.arm import STANDARD_GRAVITY, Array, gravity_torque

#: Number of random cosines.
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
        prior = np.zeros((n, 2, COSINES)), np.tile(SIGNAL**2 * np.eye(COSINES), (n, 1, 1))
        acting = self.drive.hold(self.holding(q))._replace(mean=self.inverse(q, v, np.zeros_like(v)))
        return GpState(acting, v, *prior)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        dt, last, (frequencies, phases) = self.interface.control_dt, state.velocity, self.spectrum
        z = np.sqrt(2.0 / COSINES) * np.cos(np.concatenate(self.reference(observation), axis=-1) @ frequencies + phases)
        y = (state.acting.mean - self.inverse(q, 0.5 * (v + last), (v - last) / dt)) / self.weight
        # The weights decay towards the prior, then the sample corrects them.
        keep = np.exp(-dt / self.memory)
        covariance = keep**2 * state.covariance + (1.0 - keep**2) * SIGNAL**2 * np.eye(COSINES)
        spread = (covariance @ z[:, :, None])[..., 0]
        gain = spread / (self.noise**2 + (z * spread).sum(axis=-1, keepdims=True))
        covariance = covariance - gain[:, :, None] * spread[:, None, :]
        weights = keep * state.weights
        weights = weights + (y - (weights @ z[:, :, None])[..., 0])[:, :, None] * gain[:, None, :]
        learned = (weights @ z[:, :, None])[..., 0]
        torque = self.inverse(q, v, self.acceleration(observation, q, v)) + self.weight * learned
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        return torque, GpState(acting, v, weights, covariance)
