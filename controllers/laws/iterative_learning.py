"""Computed torque that learns over repeated trials of one motion."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from controllers.base import Array, Gain, State, number
from controllers.laws.computed_torque import ComputedTorque

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
        return self.inverse(q, v, a), state._replace(step=step + 1, u=u, e=e)
