"""Nonlinear model predictive control: the torques of the next 0.3 s, planned again every 20 ms.

The real-time iteration (Diehl, Bock, Schlöder, Findeisen, Nagy and Allgöwer, "Real-time
optimization and nonlinear model predictive control", J. Process Control 12(4), 2002): each decision
linearises the predicted motion about the last plan and solves one quadratic programme. CasADi
generates the derivatives. The solver is DAQP (Arnström, Bemporad and Axehill, "A dual active-set
solver for embedded quadratic programming using recursive LDL' updates", IEEE TAC 67(8), 2022).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled
from scipy.linalg import cholesky, solve_discrete_are

from controllers.parts import Eso, runge_kutta
from controllers.policy import State, TorqueLaw, reference_at
from fbl_gym.checks import Pair
from fbl_gym.model.arm import (
    ArmParameters,
    Array,
    coriolis_terms,
    forward_dynamics,
    gravity_terms,
    inertia_matrix,
    inertia_terms,
    solve_terms,
)
from fbl_gym.records import pair

try:
    import casadi as ca
except ImportError as problem:
    raise DependencyNotInstalled("nmpc needs casadi: pip install 'fbl-gym[mpc]'") from problem

HORIZON = 15
"""Steps of the plan."""

STEP = 0.02
"""Length of a step [s], to the nearest multiple of the control interval."""


def acceleration(arm: ArmParameters, x: Any, torque: Any) -> Any:
    """Return `forward_dynamics` [2] of x = (position, velocity) as a CasADi expression."""
    p1, p2, p3, p4, p5 = map(float, arm.lumped)
    r1, r2 = arm.rotor  # type: ignore[misc]
    q1, q2, v1, v2 = (x[i] for i in range(4))
    b1, b2 = coriolis_terms(p3, ca.sin(q2), v1, v2)
    g1, g2 = gravity_terms(p4, p5, ca.cos(q1), ca.cos(q1 + q2))
    m11, m12, m22 = inertia_terms(p1, p2, p3, r1, r2, ca.cos(q2))
    return ca.vertcat(*solve_terms(m11, m12, m22, torque[0] - b1 - g1, torque[1] - b2 - g2))


def terminal(step: float, position: float, velocity: float) -> Array:
    """Return R [2 x 2]: |R (e, e')|^2 is the cost after the horizon, without limits.

    `position` [1/s^2] and `velocity` [1/s] are the weights of e and e'.
    """
    f, g = np.array([[1.0, step], [0.0, 1.0]]), np.array([[0.5 * step**2], [step]])
    return cholesky(solve_discrete_are(f, g, np.diag([position, velocity]) ** 2, np.eye(1)))


def residuals(arm: ArmParameters, step: float, weights: tuple[Pair, Pair]) -> Any:
    """Return the function (start, reference, plan) -> residuals, whose squares sum to the cost.

    start [6] is position, velocity and f, the acceleration that the model does not explain, held
    over the horizon. reference is [6 x (HORIZON + 1)]. plan [2 HORIZON] is in units of the
    stretched arm's inertia, so its entries are accelerations. The weights are those of position and
    velocity, per joint.
    """
    (w1, w2), (c1, c2) = weights
    scale = ca.DM(np.diagonal(inertia_matrix(arm, (0.0, 0.0))))
    start, reference, plan = ca.SX.sym("s", 6), ca.SX.sym("r", 6, HORIZON + 1), ca.SX.sym("u", 2 * HORIZON)
    x, f, terms = start[:4], start[4:], []

    def rate(x: Any, torque: Any) -> Any:
        return ca.vertcat(x[2:], acceleration(arm, x, torque) + f)

    for k in range(HORIZON):
        torque = scale * plan[2 * k : 2 * k + 2]
        # e'' of the plan has the weight 1.
        terms.append(rate(x, torque)[2:] - reference[4:, k])
        (x,) = runge_kutta(lambda x, u: [rate(x[0], u)], [x], step, [torque] * 3)
        error = x - reference[:4, k + 1]
        if k < HORIZON - 1:
            terms.append(ca.vertcat(w1, w2, c1, c2) * error)
    for joint, joint_weights in enumerate(((w1, c1), (w2, c2))):
        terms.append(ca.DM(terminal(step, *joint_weights)) @ ca.vertcat(error[joint], error[2 + joint]))
    return ca.Function("residuals", [start, reference, plan], [ca.vertcat(*terms)])


@lru_cache(maxsize=16)
def planner(arm: ArmParameters, step: float, weights: tuple[Pair, Pair], limit: Pair | None, lanes: int) -> Any:
    """Return the function (start, reference, plan) -> better plan, mapped over the lanes.

    start is [6 x n], reference [6 x n (HORIZON + 1)], plan [2 HORIZON x n] N m. It makes one
    Gauss-Newton step: it linearises `residuals` about the plan, and minimises the sum of their
    squares within the limits.
    """
    cost = residuals(arm, step, weights)
    dense = ca.Sparsity.dense(2 * HORIZON, 2 * HORIZON)
    solver = ca.conic("solver", "daqp", {"h": dense}, {"error_on_fail": False})
    scale = ca.repmat(ca.DM(np.diagonal(inertia_matrix(arm, (0.0, 0.0)))), HORIZON, 1)
    bound = ca.inf if limit is None else ca.repmat(ca.DM(limit), HORIZON, 1) / scale
    symbols = [ca.SX.sym(f"s{i}", *cost.size_in(i)) for i in range(3)]
    value = cost(*symbols)
    slope = ca.jacobian(value, symbols[2])
    expand = ca.Function("expand", symbols, [slope.T @ slope, slope.T @ value])
    start, reference, plan = (ca.MX.sym(f"m{i}", *cost.size_in(i)) for i in range(3))
    u = plan / scale
    # min |value + slope du|^2 / 2 for u + du within the limits
    h, g = expand(start, reference, u)
    change = solver(h=h, g=g, lbx=-bound - u, ubx=bound - u)["x"]
    return ca.Function("planner", [start, reference, plan], [plan + scale * change]).map(lanes)


class NmpcState(NamedTuple):
    """State of `Nmpc`."""

    memory: Array  # of the observer [n x 2 x 4]
    plan: Array  # torques from now on [n x HORIZON x 2] N m
    steps: Array  # their number [n]


@dataclass(frozen=True)
class Nmpc(TorqueLaw):
    """Nonlinear model predictive control with preview and a disturbance estimate.

        minimise    sum of (position e)^2 + (velocity e')^2 + (e'')^2 + terminal cost,    e = r - q
        subject to  M(q) (q'' - f) + C v + G = torque, torque limits

    The first torque of the plan is applied. f comes from the extended state observer
    (`parts.Eso`) and is held over the horizon, so no constant load leaves an error. The terminal
    cost is that of the optimal regulator. A plan is made every 20 ms, or at each step of a slower
    control rate, and its torque is held in between. The reference comes from the observation's
    `preview` as far as it reaches; beyond, its acceleration is held.

    Sensors: position. CasADi must be installed. Source: Diehl et al. 2002; see the module.

    Args:
        position: weight of the error [1/s^2], per joint, against 1 for its acceleration.
        velocity: weight of the error's rate [1/s], per joint.
        observer_bandwidth: all poles of the observer are minus this [rad/s], per joint.
    """

    position: Pair | float = pair(100.0, unit="1/s^2", above=0, tune=(10.0, 1000.0))
    velocity: Pair | float = pair(10.0, unit="1/s", above=0, tune=(1.0, 100.0))
    observer_bandwidth: Pair | float = pair(45.0, unit="rad/s", above=0, tune=(15.0, 200.0))

    needs: ClassVar[tuple[str, ...]] = ("position",)
    preview: ClassVar[float] = HORIZON * STEP
    packages: ClassVar[tuple[str, ...]] = ("casadi",)

    @property
    def stride(self) -> int:
        """Control intervals from plan to plan."""
        return max(1, round(STEP / self.interface.control_dt))

    @property
    def observer(self) -> Eso:
        """The extended state observer of both joints."""
        return Eso(self.interface.control_dt, self.observer_bandwidth)

    def initial(self, observation: Array) -> State:
        """Return the state at rest."""
        q, r_dot = self.read(observation, "position", "reference_velocity")
        hold = self.holding(q)
        plan = np.repeat(hold[:, None], HORIZON, axis=1)
        return NmpcState(self.observer.initial(q, r_dot), plan, np.zeros(len(q), dtype=int))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        plan = state.plan
        (position,) = self.read(observation, "position")
        estimate = self.observer.correct(state.memory, position)
        due = state.steps % self.stride == 0
        if due.any():
            plan = plan.copy()
            plan[due] = self.plan(observation[due], estimate[due], plan[due])
        torque = plan[:, 0]
        u = forward_dynamics(self.interface.nominal, estimate[..., 0], estimate[..., 1], torque)
        return torque, NmpcState(self.observer.predict(estimate, u), plan, state.steps + 1)

    def plan(self, observation: Array, estimate: Array, plan: Array) -> Array:
        """Return the torques from now on [n x HORIZON x 2] N m, from those planned a step ago.

        The estimate [n x 2 x 4] is that of `parts.Observer`.
        """
        n = len(plan)
        step, weights = self.stride * self.interface.control_dt, (self.position, self.velocity)
        improve = planner(self.interface.nominal, step, weights, self.interface.torque_limit, n)
        start = estimate[..., [0, 1, 3]].transpose(2, 1, 0).reshape(6, n)
        times = step * np.arange(HORIZON + 1, dtype=float)
        reference = reference_at(self.interface, observation, times).reshape(-1, 6).T
        shifted = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        better = np.asarray(improve(start, reference, shifted.reshape(n, -1).T)).T.reshape(plan.shape)
        # Where the solver failed, the last plan goes on.
        return self.interface.saturate(np.where(np.isfinite(better).all(axis=(1, 2), keepdims=True), better, shifted))
