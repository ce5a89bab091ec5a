"""The parts of composed laws (`composition.py`): observers, predictor, springs and barrier."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are

from controllers.drive import Acting, Drive
from controllers.numerics.dynamics import forward_dynamics, inverse_dynamics
from controllers.preview import Places, between, places
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair
from fbl_gym.records.record import Record, number, pair

#: Tuning range of an observer's bandwidth [rad/s].
TUNE = (15.0, 300.0)


@dataclass(frozen=True)
class Observer(Record):
    """Base of the observers: each estimates both joints' motion from the measured position.

    `correct` returns the estimate from the memory and the position that is measured at a sample
    [n x 2] rad. `predict` returns the memory for the next sample from the estimate and the nominal
    acceleration u [n x 2] rad/s^2.

    An estimate [n x 2 x 4] is position, velocity, acceleration and f of each joint. f is the
    acceleration that the nominal model does not explain; zero, if the observer does not estimate
    it. The memory [n x 2 x 4], all that changes from sample to sample, is the prediction of
    position, velocity and f, and u.

    Args:
        dt: sample time [s].
    """

    dt: float

    def initial(self, position: Array, velocity: Array) -> Array:
        """Return the memory before an episode, from the motion [n x 2] rad and rad/s."""
        zeros = np.zeros_like(position)
        return np.stack([position, velocity, zeros, zeros], axis=-1)

    def predict(self, estimate: Array, u: Array) -> Array:
        """Return the memory for the next sample, under the nominal acceleration u [n x 2]."""
        q, v, _, f = estimate.transpose(2, 0, 1)
        dt, a = self.dt, u + f
        # x = F x + G u
        return np.stack([q + dt * v + 0.5 * dt**2 * a, v + dt * a, f, u], axis=-1)


@dataclass(frozen=True)
class Eso(Observer):
    """The extended state observer, driven by the nominal acceleration u.

    Each joint of the nominally linearised arm is x'' = u + f. u is the nominal acceleration under
    the applied torque, and f all the rest: wrong parameters, friction, disturbance. f is the third
    state (Han, "From PID to active disturbance rejection control", IEEE TIE 56(3), 2009, §IV), so a
    constant load leaves no error of the velocity. All three poles lie at -bandwidth (Gao, "Scaling
    and bandwidth-parameterization based controller tuning", ACC 2003).

    The observer is the current estimator of the plant held between samples (Miklosovic, Radke and
    Gao, "Discrete implementation and generalization of the extended state observer", ACC 2006). Its
    error obeys e(k+1) = (F - F L H) e(k) with three eigenvalues exp(-bandwidth dt), so it is stable
    at every rate.

    Args:
        bandwidth: all three poles are minus this [rad/s], per joint.
    """

    bandwidth: Pair | float = pair(80.0, unit="rad/s", above=0, tune=TUNE)

    @cached_property
    def gain(self) -> Array:
        """L [2 x 3], per joint."""
        z, dt = np.exp(-np.array(self.bandwidth) * self.dt), self.dt
        # det(s I - F + F L H) = (s - z)^3
        return np.stack([1.0 - z**3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / dt, (1.0 - z) ** 3 / dt**2], axis=-1)

    def correct(self, memory: Array, position: Array) -> Array:
        """Return the estimate at a sample."""
        # x = x + L (y - H x)
        q, v, f = (memory[..., :3] + self.gain * (position - memory[..., 0])[..., None]).transpose(2, 0, 1)
        return np.stack([q, v, memory[..., 3] + f, f], axis=-1)


@dataclass(frozen=True)
class Kalman(Observer):
    """The Kalman filter of a double integrator at steady state, driven by the nominal acceleration.

    Only the ratio of the noises counts: bandwidth^2 is the noise of the acceleration over that of
    the position, both per sample. At a fast rate the poles have this frequency,
    and the damping 0.71. A constant load f leaves an error of the velocity.

    Args:
        bandwidth: of the filter [rad/s].
    """

    bandwidth: float = number(100.0, unit="rad/s", above=0, tune=TUNE)

    @cached_property
    def gain(self) -> Array:
        """K at steady state [2]."""
        f, b = np.array([[1.0, self.dt], [0.0, 1.0]]), np.array([[0.5 * self.dt**2], [self.dt]])
        p = solve_discrete_are(f.T, np.array([[1.0], [0.0]]), self.bandwidth**4 * b @ b.T, np.eye(1))
        return p[:, 0] / (p[0, 0] + 1.0)

    def correct(self, memory: Array, position: Array) -> Array:
        """Return the estimate at a sample; the acceleration is that of the estimated velocity."""
        q, v, f, u = memory.transpose(2, 0, 1)
        innovation = position - q
        change = self.gain[1] * innovation
        return np.stack([q + self.gain[0] * innovation, v + change, u + change / self.dt, f], axis=-1)


@dataclass(frozen=True)
class Predictor(Record):
    """The predictor: a law gets motion and reference of the time at which its torque acts.

    The nominal model is integrated through the age of the readings, the delay and the lag, with the
    torques under way. With an exact model the law acts as if there were no delay (Smith, "A
    controller to overcome dead time", ISA J. 6(2), 1959, in the state-space form of Manitius and
    Olbrot, IEEE TAC 24(4), 1979). The reference comes from the preview as far as it reaches; beyond
    (or without preview), the reference's acceleration is held.

    A share of the lag may be inverted in place of predicted: torque + k (wanted - torque) is
    commanded, and the torque on the joints approaches the wanted one with the time constant
    (1 - lead) lag. A large share amplifies the noise.

    Args:
        interface: of the policy.
        lead: share of the lag that is inverted.
    """

    interface: Interface = field(repr=False)
    lead: float = number(0.5, low=0, high=1, tune=(0.05, 1.0))

    @cached_property
    def drive(self) -> Drive:
        """The known drive."""
        return Drive.of(self.interface)

    @cached_property
    def gain(self) -> float:
        """k, from the torque wanted less the present one to the command; 1 without lead."""
        lag, dt, left = self.drive.lag, self.drive.dt, (1.0 - self.lead) * self.drive.lag
        if lag == 0.0:
            return 1.0
        return (1.0 if left == 0.0 else -math.expm1(-dt / left)) / -math.expm1(-dt / lag)

    @cached_property
    def lateness(self) -> float:
        """Mean time by which the torque on the joints follows the wanted one [s]."""
        lag, dt = self.drive.lag, self.drive.dt
        if lag == 0.0:
            return 0.0
        gap = -math.expm1(-dt / lag)
        # Area between the wanted torque and a step's response in the first interval; the later
        # ones are smaller by the same factor each.
        area = dt - self.gain * (dt - lag * gap)
        return area / (self.gain * gap)

    @cached_property
    def _late(self) -> Array:
        """The lateness in steps of at most a control interval [m] s."""
        count = max(math.ceil(self.lateness / self.drive.dt - 1e-9), 1)
        return np.full(count, self.lateness / count)

    def motion(self, motion: dict[str, Array], f: Array, acting: Acting) -> tuple[dict[str, Array], Array]:
        """Return the motion at which a torque acts, and the torque due before it [n x 2] N m.

        Args:
            motion: position, velocity and acceleration at the last reading, [n x 2] each.
            f: the acceleration that the model does not explain [n x 2] rad/s^2.
            acting: the torques at that reading.
        """
        arm, drive, (q, v, a) = self.interface.nominal, self.drive, motion.values()
        commands = acting.queue.swapaxes(0, 1)
        due = drive.predict(arm, [q, v, acting.torque], f, drive.coming, commands[::-1])
        last = commands[:1].repeat(len(self._late), axis=0)
        q_then, v_then, torque = drive.predict(arm, due, f, self._late, last)
        a = forward_dynamics(arm, q_then, v_then, torque) + (a - forward_dynamics(arm, q, v, acting.torque))
        return {"position": q_then, "velocity": v_then, "acceleration": a}, due[2]

    def reference(self, known: Array) -> Array:
        """Return the reference at that time and later [n x k x 6], from that of an observation."""
        return between(known, self._places, self.drive.dt)

    @cached_property
    def _places(self) -> Places:
        """Places of the law's reference in that of an observation."""
        samples = len(self.interface.layout.reference) // 6
        ahead = self.drive.delay - self.interface.latency + self.lateness
        return places(self.drive.dt, samples, ahead + self.drive.dt * np.arange(samples, dtype=float))


@dataclass(frozen=True)
class Springs(Record):
    """The motion of the motors at which elastic joints carry the reference of the links.

    Where the encoders are on the motors, a law follows the motors, and the links stay behind by the
    deflection of the springs. The law therefore gets the reference r + d of the motors, with the
    deflection d = share K^-1 (M(r) r'' + C(r, r') r' + G(r)) under the nominal torque on the links
    and the stiffness K, the geometric middle of the datasheet (De Luca and Book, "Robots with
    flexible elements", Springer Handbook of Robotics, chapter 11: the inverse dynamics of elastic
    joints). Rate and acceleration of d are differences from sample to sample. With rigid joints, or
    encoders on the links, the reference stays.

    Args:
        interface: of the policy.
        share: of the deflection that the motors lead by.
    """

    interface: Interface = field(repr=False)
    share: float = number(1.0, low=0, high=2, tune=(0.5, 1.5))

    @cached_property
    def softness(self) -> Array | None:
        """The share over the stiffness [2] rad/(N m); None: nothing is left to do."""
        stiffness = self.interface.stiffness
        if stiffness is None or self.interface.encoder != "motor":
            return None
        return self.share / np.sqrt(np.prod(np.array(stiffness), axis=0))

    def moved(self, reference: Array, memory: Array) -> tuple[Array, Array]:
        """Return the reference of the motors.

        Args:
            reference: of the links, now and at coming samples [n x k x 6].
            memory: deflection and its rate at the last sample [n x 2 x 2]; infinite: none.

        Returns:
            The reference [n x k x 6] and the memory for the next sample.
        """
        if self.softness is None:
            return reference, memory
        dt, (r, r_dot, r_ddot) = self.interface.control_dt, np.split(reference, 3, axis=-1)
        # The rotors turn before the springs: the links alone bend them.
        bend = self.softness * inverse_dynamics(self.interface.nominal.lumped, r, r_dot, r_ddot)
        rate = np.diff(np.concatenate([memory[:, :1], bend], axis=1), axis=1) / dt
        change = np.diff(np.concatenate([memory[:, 1:], rate], axis=1), axis=1) / dt
        moved = np.concatenate([bend, *(np.where(np.isfinite(x), x, 0.0) for x in (rate, change))], axis=-1)
        return reference + moved, np.stack([bend[:, 0], rate[:, 0]], axis=1)


@dataclass(frozen=True)
class Barrier(Record):
    """The safety filter: the torque nearest to the wanted one that keeps the constraints.

    Each bound has a control barrier function h, which is positive inside: the distance to the
    bound. A position's h obeys h'' + 2 d h' + d^2 h >= 0, a velocity's h' + d h >= 0, with the
    decay d (Nguyen and Sreenath, "Exponential control barrier functions", ACC 2016; Ames et al.,
    "Control barrier functions: theory and applications", ECC 2019). The gains below place the poles
    of the sampled motion at z = exp(-d dt), since the torque is held for dt. All bounds together
    are a box for the acceleration. "Nearest" refers to the acceleration under the nominal model, so
    the solution of the quadratic program is the nearest point of a box: the wanted acceleration,
    clipped. Where the wanted acceleration lies in the box, the torque is returned unchanged.

    The bounds hold for an exact model, exact readings, a drive without delay that can give the
    torque, and a fast rate. They also need a start inside, slow enough to brake: h' + d h >= 0.

    Args:
        interface: of the policy. Without constraints in it, no torque is changed.
        decay: d. A larger one brakes later and harder.
        margin: distance that is kept from the bounds of the position.
    """

    interface: Interface = field(repr=False)
    decay: float = number(10.0, unit="1/s", above=0, tune=(2.0, 50.0))
    margin: Pair | float = pair(0.0, unit="rad", low=0)

    def filtered(self, torque: Array, position: Array, velocity: Array) -> Array:
        """Return the nearest safe torque [n x 2] N m to a torque at a state, [n x 2] each."""
        if self.interface.constraints is None:
            return torque
        arm, (low, high) = self.interface.nominal, self.accelerations(position, velocity)
        wanted = forward_dynamics(arm, position, velocity, self.interface.saturate(torque))
        nearest = np.minimum(np.maximum(wanted, low), high)
        changes = (nearest != wanted).any(axis=-1, keepdims=True)
        return np.where(changes, inverse_dynamics(arm, position, velocity, nearest), torque)

    def accelerations(self, position: Array, velocity: Array) -> tuple[Array, Array]:
        """Return the least and the largest safe acceleration [n x 2] at a state, [n x 2] each.

        Outside of the constraints the box may be empty; then the bounds of the position count.
        """
        low, high, fastest = self.interface.constraints.bounds  # type: ignore[union-attr]
        low, high, dt = low + np.array(self.margin), high - np.array(self.margin), self.interface.control_dt
        z = math.exp(-self.decay * dt)
        # det(s I - F + G K) = (s - z)^2 of the double integrator held between samples
        k1, k2, k = (1.0 - z) ** 2 / dt**2, (1.0 - z) * (3.0 + z) / (2.0 * dt), (1.0 - z) / dt
        least, most = (k1 * (bound - position) - k2 * velocity for bound in (low, high))
        slowest, quickest = -k * (fastest + velocity), k * (fastest - velocity)
        return np.minimum(np.maximum(least, slowest), most), np.maximum(np.minimum(most, quickest), least)


#: The observers, by name.
OBSERVERS: dict[str, type[Eso | Kalman]] = {"kalman": Kalman, "eso": Eso}

#: All parts, by name.
PARTS: Mapping[str, type] = {**OBSERVERS, "predictor": Predictor, "springs": Springs, "barrier": Barrier}
