"""Laws whose torque is linear in parameters: Slotine and Li's, Craig's and Spong's."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.base import Acting, Gain, State, TorqueLaw, number, pair
from fbl_gym.model.arm import Array, inertia_matrix, matrix_of, regressor, with_rotors

#: Speed over which Coulomb friction changes its sign [rad/s].
TURN = 0.05

#: Largest estimate of a friction, over the stretched arm's inertia [1/s and rad/s^2].
MOST = 5.0


def slotine_li_regressor(q: Array, v: Array, v_r: Array, a_r: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = M(q) a_r + C(q, v) v_r + G(q).

    v_r and a_r are velocity and acceleration of the reference motion. C is that of the Christoffel
    symbols. Slotine and Li, "Applied Nonlinear Control", 1991, §9.2. With v_r = v and a_r = a it is
    `arm.regressor`.
    """
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    c1, c12 = np.cos(q[:, 0]), np.cos(q[:, 0] + q[:, 1])
    both = a_r[:, 0] + a_r[:, 1]
    # C v_r of the Christoffel symbols, over p3: (-s2 (v2 vr1 + (v1 + v2) vr2), s2 v1 vr1).
    first = c2 * (a_r[:, 0] + both) - s2 * (v[:, 1] * v_r[:, 0] + (v[:, 0] + v[:, 1]) * v_r[:, 1])
    second = c2 * a_r[:, 0] + s2 * v[:, 0] * v_r[:, 0]
    return matrix_of((a_r[:, 0], both, first, c1, c12), (0.0, both, second, 0.0, c12))


def momentum_regressor(q: Array, v: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = M(q) v."""
    c2, both = np.cos(q[:, 1]), v[:, 0] + v[:, 1]
    return matrix_of((v[:, 0], both, c2 * (v[:, 0] + both), 0.0, 0.0), (0.0, both, c2 * v[:, 0], 0.0, 0.0))


def drift_regressor(q: Array, v: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = G(q) - C'(q, v) v, so torque = d/dt (M v) + Y p."""
    c1, c12 = np.cos(q[:, 0]), np.cos(q[:, 0] + q[:, 1])
    third = np.sin(q[:, 1]) * v[:, 0] * (v[:, 0] + v[:, 1])
    return matrix_of((0.0, 0.0, 0.0, c1, c12), (0.0, 0.0, third, 0.0, c12))


def friction_regressor(v: Array) -> Array:
    """Return Y [n x 2 x 4] with Y p = viscous friction v + Coulomb friction tanh(v / TURN).

    p has both joints' viscous friction, then both joints' Coulomb friction.
    """
    dry = np.tanh(v / TURN)
    return matrix_of((v[:, 0], 0.0, dry[:, 0], 0.0), (0.0, v[:, 1], 0.0, dry[:, 1]))


class SlotineLiState(NamedTuple):
    """State of `SlotineLi`."""

    estimate: Array  # p^ [n x 9]


class CompositeState(NamedTuple):
    """State of `SlotineLiComposite`."""

    estimate: Array  # p^ [n x 9]
    position: Array  # at the last sample [n x 2] rad
    velocity: Array  # at the last sample [n x 2] rad/s
    regressor: Array  # W [n x 2 x 9]
    filtered: Array  # torque through the low-pass filter, without the rotors' part [n x 2] N m
    acting: Acting
    started: Array  # False before the first sample [n]


@dataclass(frozen=True)
class _Sliding(TorqueLaw):
    """Base of the laws along a reference motion: v_r = r' + slope e, a_r = r'' + slope e'.

    Args:
        slope: of the sliding surface s = e' + slope e [1/s], per joint.
        damping: K over the nominal inertia [1/s].
    """

    slope: Gain = pair(10.0, unit="1/s", above=0, tune=(2.0, 80.0))
    damping: float = number(15.0, unit="1/s", above=0, tune=(5.0, 150.0))

    def surface(self, observation: Array) -> tuple[Array, ...]:
        """Return q, v_r, a_r and s, [n x 2] each, and Y of the lumped parameters [n x 2 x 5]."""
        q, v, r, r_dot, r_ddot = self.motion(observation)
        slope = np.array(self.slope)
        v_r, a_r = r_dot + slope * (r - q), r_ddot + slope * (r_dot - v)
        return q, v_r, a_r, v_r - v, slotine_li_regressor(q, v, v_r, a_r)

    def along(self, y: Array, p: Array, q: Array, a_r: Array, s: Array) -> Array:
        """Return the torque Y p + K s, and that of known rotors [n x 2] N m."""
        nominal = self.interface.nominal
        gain = self.damping * inertia_matrix(nominal, q)
        return np.einsum("nij,nj->ni", y, p) + np.einsum("nij,nj->ni", gain, s) + np.array(nominal.rotor) * a_r


@dataclass(frozen=True)
class SlotineLi(_Sliding):
    """Slotine and Li's adaptive law, with friction among the unknowns.

        torque = Y p^ + K s,    p^' = Gamma Y' s,    s = e' + slope e

    Y is the regressor along the reference motion v_r = r' + slope e, a_r = r'' + slope e'. p has
    the five lumped parameters, and of each joint the viscous and the Coulomb friction, whose torque
    is p_6 v_r + p_8 tanh(v_r / TURN) at the first one. Gains scale with the nominal arm:
    K = damping M(q), Gamma_i = adaptation p_i^2 / p_1, and for the frictions of joint j it is
    friction M_jj of the stretched arm. Known rotors add their torque to Y p^. The estimates are
    clipped to a box: lumped parameters within a factor `reach` of the nominal ones, friction
    between 0 and `MOST`. They are held where the torque saturates.

    Sensors: position and velocity. Source: Slotine and Li, "On the adaptive control of robot
    manipulators", Int. J. Robotics Research 6(3), 1987; "Applied Nonlinear Control", 1991, §9.2.

    Args:
        adaptation: gain of the lumped parameters' estimates.
        friction: gain of the friction's estimates [1/s^2]; 0: no friction is estimated. Along a
            motion in one direction it acts as an integrator: s'' + damping s' + friction s = 0 for
            a joint alone.
        reach: largest factor between an estimate and its nominal value.
    """

    adaptation: float = number(1.0, low=0, tune=(0.1, 300.0))
    friction: float = number(3.0, unit="1/s^2", low=0, tune=(0.5, 50.0))
    reach: float = number(16.0, above=1)

    @cached_property
    def rates(self) -> Array:
        """Diagonal of Gamma [9]."""
        lumped = self.interface.nominal.lumped
        return np.concatenate([self.adaptation * lumped**2 / lumped[0], self.friction * np.tile(self.stretched, 2)])

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Least and largest estimates, [9] each."""
        lumped = self.interface.nominal.lumped
        low, high = np.sort([lumped / self.reach, lumped * self.reach], axis=0)
        return np.concatenate([low, np.zeros(4)]), np.concatenate([high, MOST * np.tile(self.stretched, 2)])

    def initial(self, observation: Array) -> State:
        """Return the state: the estimates [n x 9], nominal and without friction."""
        start = np.concatenate([self.interface.nominal.lumped, np.zeros(4)])
        return SlotineLiState(np.tile(start, (len(observation), 1)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next estimates."""
        torque, estimate = self.adapt(observation, state.estimate)
        return torque, SlotineLiState(estimate)

    def adapt(self, observation: Array, estimate: Array, prediction: Array | float = 0.0) -> tuple[Array, Array]:
        """Return the torque [n x 2] N m, and the next estimates [n x 9].

        `prediction` [n x 9] is added to Y's: p^' = Gamma (Y's + prediction).
        """
        q, v_r, a_r, s, y = self.surface(observation)
        y = np.concatenate([y, friction_regressor(v_r)], axis=-1)
        torque = self.along(y, estimate, q, a_r, s)
        change = self.rates * (np.einsum("nij,ni->nj", y, s) + prediction)
        return torque, self.updated(estimate, change, torque)

    def updated(self, estimate: Array, change: Array, torque: Array) -> Array:
        """Return the next estimates [n x 9], from their rates of change under a torque."""
        free = np.all(self.interface.saturate(torque) == torque, axis=-1, keepdims=True)
        return np.clip(estimate + self.interface.control_dt * np.where(free, change, 0.0), *self.box)


@dataclass(frozen=True)
class SlotineLiComposite(SlotineLi):
    """`SlotineLi` with estimates that the error of predicting the torque drives too.

        p^' = Gamma (Y' s - composite W' (W p^ - LP(torque)) / (p1 + tr(W Gamma W')))

    W is the low-pass filtered regressor of the torque, with the momentum's difference in place of
    acceleration: torque = d/dt (M v) + G - C'v + friction. p1 of the nominal arm gives the
    normalisation its unit. The prediction takes the torque as the known drive applies it.

    Sensors: position and velocity. Source: Slotine and Li, "Composite adaptive control of robot
    manipulators", Automatica 25(4), 1989.

    Args:
        composite: gain of the prediction error [1/s].
        filtering: bandwidth of the filter of the prediction [rad/s].
    """

    composite: float = number(30.0, unit="1/s", low=0, tune=(0.3, 300.0))
    filtering: float = number(20.0, unit="rad/s", above=0)

    def initial(self, observation: Array) -> State:
        """Return the state before the first sample, with the estimates of `SlotineLi`."""
        n, (q, v) = len(observation), self.read(observation, "position", "velocity")
        estimate, w, zeros = super().initial(observation).estimate, np.zeros((n, 2, 9)), np.zeros((n, 2))
        hold = self.drive.hold(self.holding(q))
        return CompositeState(estimate, q, v, w, zeros, hold, np.zeros(n, dtype=bool))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q0, v0, estimate = state.position, state.velocity, state.estimate
        q, v = self.read(observation, "position", "velocity")
        dt = self.interface.control_dt
        # Over the interval that ends now, torque = d/dt (M v) + (G - C'v) + friction.
        mean = 0.5 * (drift_regressor(q, v) + drift_regressor(q0, v0))
        mean += (momentum_regressor(q, v) - momentum_regressor(q0, v0)) / dt
        friction = 0.5 * (friction_regressor(v) + friction_regressor(v0))
        keep = np.where(state.started, np.exp(-self.filtering * dt), 1.0)[:, None]
        w = keep[..., None] * state.regressor + (1.0 - keep[..., None]) * np.concatenate([mean, friction], axis=-1)
        rotors = np.array(self.interface.nominal.rotor) * (v - v0) / dt
        filtered = keep * state.filtered + (1.0 - keep) * (state.acting.mean - rotors)
        missed = np.einsum("nij,nj->ni", w, estimate) - filtered
        size = self.interface.nominal.lumped[0] + np.einsum("nij,nij,j->n", w, w, self.rates)[:, None]
        prediction = -self.composite * np.einsum("nij,ni->nj", w, missed) / size
        torque, estimate = self.adapt(observation, estimate, prediction)
        acting, started = self.drive.act(state.acting, self.interface.saturate(torque)), np.ones_like(state.started)
        return torque, CompositeState(estimate, q, v, w, filtered, acting, started)


@dataclass(frozen=True)
class ComputedTorqueAdaptive(SlotineLi):
    """Computed torque on an estimated model, whose estimates follow the tracking error.

        torque = M^ a + C^ v + G^ + friction^,    a = r'' + (slope + damping) e' + slope damping e
        p^' = Gamma Y(q, v, q'')' M^^-1 W s,    s = e' + slope e

    The error obeys s' + damping s = M^^-1 Y (p - p^). With W the diagonal of the stretched nominal
    inertia, V = (s'W s + (p - p^)' Gamma^-1 (p - p^)) / 2 falls by damping s'W s. Parameters, box
    and gains are those of `SlotineLi`. M^ is inverted, so p3 stays below 0.95 (p1 p2)^(1/2), which
    keeps it positive definite.

    Sensors: position, velocity and acceleration. Source: Craig, Hsu and Sastry, "Adaptive control
    of mechanical manipulators", Int. J. Robotics Research 6(2), 1987.

    Args:
        slope, damping, adaptation, friction, reach: as in `SlotineLi`. The poles of the error are
            -slope and -damping.
    """

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next estimates."""
        q, v, acceleration = self.read(observation, "position", "velocity", "acceleration")
        r, r_dot, r_ddot = self.reference(observation)
        slope, rotor, estimate = np.array(self.slope), np.array(self.interface.nominal.rotor), state.estimate
        s = r_dot - v + slope * (r - q)
        a = r_ddot + slope * (r_dot - v) + self.damping * s
        friction = friction_regressor(v)
        y, measured = (np.concatenate([regressor(q, v, x), friction], axis=-1) for x in (a, acceleration))
        torque = np.einsum("nij,nj->ni", y, estimate) + rotor * a
        inertia = inertia_matrix(with_rotors(estimate[:, :5], rotor), q)
        weighted = np.linalg.solve(inertia, (self.stretched * s)[..., None])[..., 0]
        change = self.rates * np.einsum("nij,ni->nj", measured, weighted)
        estimate = self.updated(estimate, change, torque)
        most = 0.95 * np.sqrt(estimate[:, 0] * estimate[:, 1])
        estimate[:, 2] = np.clip(estimate[:, 2], -most, most)
        return torque, SlotineLiState(estimate)


@dataclass(frozen=True)
class SpongRobust(_Sliding):
    """Spong's robust law, with a bound for each lumped parameter.

        torque = Y (p^ + u) + K s,    s = e' + slope e
        u_i = bound p^_i sat((Y's)_i p^_i / (epsilon p1))

    Y is the regressor along the reference motion v_r = r' + slope e, p^ the nominal lumped
    parameters, and sat clips to [-1, 1]. Known rotors add the torque rotor a_r.

    Sensors: position and velocity. Source: Spong, "On the robust control of robot manipulators",
    IEEE TAC 37(11), 1992.

    Args:
        bound: largest deviation of a lumped parameter, as a share of the nominal one.
        epsilon: width of the boundary layer over the nominal inertia p1 [1/s^3]. A small one tracks
            closer and chatters more.
    """

    bound: float = number(1.0, low=0, tune=(0.1, 8.0))
    epsilon: float = number(20.0, unit="1/s^3", above=0, tune=(0.03, 100.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, _, a_r, s, y = self.surface(observation)
        nominal = self.interface.nominal.lumped
        power = np.einsum("nij,ni->nj", y, s) * nominal
        u = self.bound * nominal * np.clip(power / (self.epsilon * nominal[0]), -1.0, 1.0)
        return self.along(y, nominal + u, q, a_r, s), state
