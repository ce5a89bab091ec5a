"""The oracle of drives at their limits: it plans the feasible motion closest to the reference.

Where the reference needs more torque than the drives have, no law follows it. The least error is
then that of an optimal control problem over the whole episode (Betts, "Practical Methods for
Optimal Control", 2010, chapter 4), which IPOPT solves (Wächter and Biegler, "On the implementation
of an interior-point filter line-search algorithm for large-scale nonlinear programming", Math.
Program. 106(1), 2006).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from controllers.base import State, number
from controllers.oracles.oracle import PREVIEW, ElasticState, OracleElastic
from controllers.oracles.true_arm import TrueArm
from controllers.preview import Places, between
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.model.arm import Array, coriolis_terms, gravity_terms, inertia_terms, inverse_dynamics, with_rotors

try:
    import casadi as ca
except ImportError as problem:
    raise DependencyNotInstalled("oracle-planned needs casadi: pip install 'fbl-gym[mpc]'") from problem

#: Interval of the plan [s], to the nearest multiple of the control interval.
STEP = 0.02

#: Speed over which the plan's dry friction changes its sign [rad/s].
SLOW = 0.05

#: Sizes of position, velocity and acceleration, by which the solver's unknowns are divided.
UNITS = np.array([1.0, 1.0, 10.0, 10.0, 100.0, 100.0])


@lru_cache(maxsize=4)
def planner(count: int, step: float) -> Any:
    """Return the solver of a plan of `count` intervals of `step` [s].

    It is a function (guess, parameters) -> (solution, success). Its unknowns are q, v and a at the
    knots and a bound s of each joint's error, [8 x (count + 1)]. In between, a is linear, so that
    the motion is exact. The sum of s is minimised. The parameters are q and v at the start [4]; at
    each knot [2 x (count + 1)], the reference; then of both joints the amplitude, viscous friction,
    dry friction and torque limit [2 x 4]; lag, and arm [7].
    """
    x, start, r = ca.MX.sym("x", 8, count + 1), ca.MX.sym("start", 4), ca.MX.sym("r", 2, count + 1)
    joints, lag, arm = ca.MX.sym("joints", 2, 4), ca.MX.sym("lag"), ca.MX.sym("arm", 7)
    amplitude, viscous, dry, limit = (ca.repmat(joints[:, i], 1, count + 1) for i in range(4))
    q, v, a = (unit * x[i : i + 2, :] for i, unit in ((0, UNITS[0]), (2, UNITS[2]), (4, UNITS[4])))
    torque = (_load(arm, q, v, a) + viscous * v + dry * ca.tanh(v / SLOW)) / limit
    lead = lag * (torque[:, 1:] - torque[:, :-1]) / step
    error, bound = (q - r) / amplitude, x[6:, :]
    # Without jumps of q and v at the knots; a is linear in between.
    q_next = q[:, :-1] + step * v[:, :-1] + step**2 * (a[:, :-1] / 3 + a[:, 1:] / 6)
    v_next = v[:, :-1] + step * (a[:, :-1] + a[:, 1:]) / 2
    zeros = [q[:, 1:] - q_next, (v[:, 1:] - v_next) / 10, (ca.vertcat(q[:, 0], v[:, 0]) - start) / UNITS[:4]]
    shares = [torque[:, :-1] + lead, torque[:, 1:] + lead]
    cost = ca.sum1(ca.vec(bound)) + 1e-9 * ca.sumsqr((a[:, 1:] - a[:, :-1]) / step)
    given = ca.vertcat(start, ca.vec(r), ca.vec(joints), lag, arm)
    # The constraints are expressions that are zero, in [-1, 1], and positive.
    groups = [[ca.vec(each) for each in group] for group in (zeros, shares, [bound - error, bound + error])]
    problem = {"x": ca.vec(x), "p": given, "f": cost, "g": ca.vertcat(*groups[0], *groups[1], *groups[2])}
    options: Any = {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 300, "ipopt.tol": 1e-5}
    solver = ca.nlpsol("planner", "ipopt", problem, options | {"print_time": False, "expand": True})
    sizes = [sum(part.numel() for part in group) for group in groups]
    low, high = (np.repeat(bound, sizes) for bound in ([0.0, -1.0, 0.0], [0.0, 1.0, np.inf]))
    return lambda guess, given: (solver(x0=guess, p=given, lbg=low, ubg=high)["x"], solver.stats()["success"])


def _load(arm: Any, q: Any, v: Any, a: Any) -> Any:
    """Return the torque M a + C v + G [2 x knots] N m of an arm [7], as an expression."""
    p1, p2, p3, p4, p5, r1, r2 = ca.vertsplit(arm)
    m11, m12, m22 = inertia_terms(p1, p2, p3, r1, r2, ca.cos(q[1, :]))
    b1, b2 = coriolis_terms(p3, ca.sin(q[1, :]), v[0, :], v[1, :])
    g1, g2 = gravity_terms(p4, p5, ca.cos(q[0, :]), ca.cos(q[0, :] + q[1, :]))
    return ca.vertcat(m11 * a[0, :] + m12 * a[1, :] + b1 + g1, m12 * a[0, :] + m22 * a[1, :] + b2 + g2)


class PlannedState(NamedTuple):
    """State of `OraclePlanned`."""

    motion: Array  # position, velocity, acceleration to follow at each step [n x steps x 6]; NaN: none yet
    regulator: ElasticState


@dataclass(frozen=True)
class OraclePlanned(OracleElastic):
    """The oracle of drives at their limits: `oracle-elastic` along a motion that they can make.

        minimise    mean |q - r| / amplitude over the episode
        subject to  |torque + lag torque'| <= (1 - reserve) limit,
                    torque = M(q) q'' + C v + G + friction

    The plan is made at the start of an episode for each lane's true arm, from the true state at
    which the first command acts, with the whole reference. Acceleration is linear over 20 ms
    (`STEP`), and torques are those of rigid joints. Where the reference needs less than the limits,
    it is the plan itself. Disturbances, and changes of the arm after the start, are left to
    feed-forward and feedback. CasADi must be installed. Source: Betts 2010; see the module.

    Args:
        env: the environment, single or batched.
        reserve: share of the limits that is left to the feedback.
    """

    reserve: float = number(0.01, low=0, high=0.5)

    packages: ClassVar[tuple[str, ...]] = ("casadi",)

    def initial(self, observation: Array) -> State:
        """Return the state before any plan is made."""
        steps = self.env.scenario.steps + math.ceil(PREVIEW / self.interface.control_dt)
        return PlannedState(np.full((len(observation), steps + 1, 6), np.nan), super().initial(observation))

    def drive(self, observation: Array, arm: TrueArm, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m that the drives are asked for, the plan and the gains."""
        motion, now = state.motion, np.rint(arm.truth.time / arm.scenario.control_dt).astype(int)
        new = np.flatnonzero(np.isnan(motion[:, 0, 0]))
        if len(new):
            motion = motion.copy()
            motion[new] = self.whole_reference(len(observation), motion.shape[1] - 1)[new]
            self.plan(arm, new, now, motion)
        columns = self.interface.layout.reference
        samples = np.minimum(now[:, None] + np.arange(len(columns) // 6), motion.shape[1] - 1)
        planned = observation.copy()
        planned[:, columns] = np.take_along_axis(motion, samples[..., None], axis=1).reshape(len(motion), -1)
        torque, regulator = super().drive(planned, arm, state.regulator)
        return torque, PlannedState(motion, regulator)

    def whole_reference(self, lanes: int, steps: int) -> Array:
        """Return the reference of each lane's episode from its start [lanes x steps + 1 x 6]."""
        scenario = self.env.scenario.replace(plant=None)
        twin = TwoLinkArmVectorEnv(lanes, scenario, action=self.interface.action, preview=steps)
        batch = self.env._batch
        twin._batch.seed(np.arange(lanes), *map(batch.field, ("seed", "episode")))
        if hasattr(scenario.reference, "points"):  # its way-points, which `reset` may have given
            first, count = (int(batch.settings[name]) for name in ("waypoint_row", "reference_points"))
            rows = batch._rows[:, first : first + 2 * count].swapaxes(1, 2)
            twin._batch.give(np.arange(lanes), {"reference": rows.reshape(-1, count, 2)[:lanes]})
        observation = np.empty((lanes, twin.layout.size))
        twin._batch.reset(np.arange(lanes), observation)
        return observation[:, twin.layout.reference].reshape(lanes, -1, 6)

    def plan(self, arm: TrueArm, lanes: NDArray[np.int64], now: NDArray[np.int64], motion: Array) -> None:
        """Replace the reference by the plan in some lanes of `motion`, from `now` on, in steps."""
        if self.interface.torque_limit is None:
            return
        truth, dt = arm.truth, arm.scenario.control_dt
        x = arm.predicted()
        links = with_rotors(truth.lumped, truth.rotor)
        # A joint needs more torque by the friction that its own torque causes.
        limits = (1 - self.reserve) * (1 - truth.load_friction) * truth.gain * self.interface.torque_limit
        for i in lanes:
            first = now[i] + math.ceil(truth.delay[i] / dt - 1e-9)
            r, r_dot, r_ddot = np.split(motion[i, first:], 3, axis=-1)
            torque = inverse_dynamics(links[i], r, r_dot, r_ddot)
            torque += truth.viscous[i] * r_dot + truth.coulomb[i] * np.sign(r_dot)
            if np.all(np.abs(torque + truth.lag[i] * np.gradient(torque, dt, axis=0)) <= limits[i]):
                continue
            joints = np.maximum(np.ptp(r, axis=0) / 2, 1e-9), truth.viscous[i], truth.coulomb[i], limits[i]
            plan = planned(motion[i, first:], dt, x[i, :4], (*joints, truth.lag[i : i + 1], links[i]))
            motion[i, first : first + len(plan)] = plan


def planned(motion: Array, dt: float, start: Array, arm: tuple[Array, ...]) -> Array:
    """Return the plan closest to a motion, in samples dt [s] apart; none, if there is no solution.

    Start and arm are the parameters of `planner` before and after the reference.
    """
    stride = max(1, round(STEP / dt))
    knots = motion[::stride]
    guess = np.concatenate([knots / UNITS, np.full((len(knots), 2), 0.01)], axis=1)
    given = np.concatenate([start, knots[:, :2].ravel(), *arm])
    x, solved = planner(len(knots) - 1, stride * dt)(guess.ravel(), given)
    plan = np.asarray(x).reshape(-1, 8)[:, :6] * UNITS
    at = np.arange(stride * (len(plan) - 1) + 1) if solved else np.arange(0)
    k = np.minimum(at // stride, len(plan) - 2)
    return between(plan[None], Places(k[None], dt * (at - stride * k)[None]), stride * dt)[0]
