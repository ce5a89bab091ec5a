"""Section 2: the linearised plant, the leakage of a wrong model, and PID; figures 2 and 3."""

from typing import Any

import numpy as np

from benchmarks.paper.measuring import HANGING, at_rate, metrics, run, with_estimates
from benchmarks.paper.outcome import Outcome, Rows, Values, percents
from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import Array, coriolis_matrix, forward_dynamics, gravity_torque, inertia_matrix, inverse_dynamics


def figure_2(v: Values) -> Outcome:
    scenario = at_rate(scenarios.get("nominal"), v["rate"], actuator=None, duration=1.0, reference=HANGING)
    env = TwoLinkArmEnv(with_estimates(scenario, v["arm"], v["estimates"]), action="torque")
    position, velocity = (env.interface.layout[name] for name in ("position", "velocity"))
    t = scenario.control_dt * np.arange(scenario.steps + 1)
    observation, _ = env.reset(seed=0)
    angles = [observation[position]]
    for acceleration in np.where(t[:-1] < 0.5 - 1e-9, 4.0, -4.0):
        motion = observation[position], observation[velocity], np.array([acceleration, 0.0])
        observation = env.step(inverse_dynamics(env.interface.nominal, *motion))[0]
        angles.append(observation[position])
    q = np.array(angles) - angles[0]
    integrator = 2.0 * t**2 - 4.0 * np.maximum(t - 0.5, 0.0) ** 2
    deviation, stray = np.abs(q[:, 0] - integrator).max(), np.abs(q[:, 1]).max()
    text = f"joint 2 moves {stray:.2g} rad, joint 1 within {deviation:.2g} rad of a double integrator"
    return Outcome(max(stray, deviation) < 1e-3, text)


def _leakage(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return LS(t) = a - q'' of equation (5) from the simulated acceleration, [n x 2] rad/s^2.

    a is the acceleration that the nominal model expects of the applied torque.
    """
    truth = env.truth
    expected = forward_dynamics(env.interface.nominal, truth.position, truth.velocity, truth.applied_torque)
    return expected - truth.acceleration


def _leakage_formula(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return LS from the two models, [n x 2] rad/s^2.

    LS = M^-1 [(M - M^) a + (C - C^) q' + (G - G^) + F + tau_d], where ^ marks the nominal model,
    which has neither friction nor disturbance.
    Equation (6) is the special case of a correct model and no friction.
    """
    truth, model = env.truth, env.interface.nominal
    q, v = truth.position, truth.velocity
    a = forward_dynamics(model, q, v, truth.applied_torque)
    inertia = inertia_matrix(truth.lumped, q)
    missing = np.einsum("nij,nj->ni", inertia - inertia_matrix(model, q), a)
    missing += np.einsum("nij,nj->ni", coriolis_matrix(truth.lumped, q, v) - coriolis_matrix(model, q, v), v)
    missing += gravity_torque(truth.lumped, q) - gravity_torque(model, q) + truth.friction_torque + truth.disturbance
    return np.linalg.solve(inertia, missing[..., None])[..., 0]


def _stiction_formula(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return M^-1 F_s of equation (45), F_s being all of the friction, [n x 2] rad/s^2."""
    (m11, m12), (_, m22) = np.moveaxis(inertia_matrix(env.truth.lumped, env.truth.position), 0, -1)
    f1, f2 = env.truth.friction_torque.T
    return np.stack([m22 * f1 - m12 * f2, m11 * f2 - m12 * f1], axis=-1) / (m11 * m22 - m12 * m12)[:, None]


_STICTION = scenarios.get("paper-8")
_LOAD = {"kind": "piecewise-constant", "amplitude": (50.0, 20.0)}
_CAUSES: dict[str, tuple[str, Scenario, Any]] = {
    "parameters": ("pid-flm", scenarios.get("paper-3b"), _leakage_formula),
    "disturbance": ("cascade-flm", _STICTION.replace(friction=None, disturbance=_LOAD), _leakage_formula),
    "stiction": ("cascade-flm", _STICTION, _stiction_formula),
}


def leakage(v: Values) -> Outcome:
    policy, scenario, formula = _CAUSES[v["cause"]]
    trace = run(policy, scenario, watch={"leakage": _leakage, "formula": formula})
    simulated, computed = (trace.watched[name][trace.alive[1:]] for name in ("leakage", "formula"))
    text = f"up to {np.abs(simulated).max():.3g} rad/s^2 at {len(simulated):,} samples"
    return Outcome(np.abs(simulated - computed).max() < 1e-9, text)


_REFERENCES: dict[str, dict[str, Any]] = {
    "literal steps": {"kind": "steps", "period": 4.0},
    "steps behind 8 rad/s": {"kind": "filtered-steps", "period": 4.0, "bandwidth": 8.0},
    "moves of 1.5 s": {"kind": "minimum-jerk", "move_time": 1.5, "hold_time": 2.5},
}
_GAINS: dict[str, Any] = {"P 10, D 3": {}, "P 10, I 3, D 0 (as printed)": {"kp": 10.0, "ki": 3.0, "kd": 0.0}}


def _pid(v: Values) -> Rows:
    """Return the metrics of PID on figure 3's motion."""
    scenario = with_estimates(scenarios.get("paper-3a"), v["arm"], v["estimates"])
    reference = {"points": vars(scenario.reference)["points"], **_REFERENCES[v["reference"]]}
    return metrics("pid-flm", scenario.replace(reference=reference), **_GAINS[v["gains"]])


def figure_3a(v: Values) -> Outcome:
    rows = _pid(v)
    steady = max(float(rows["steady_1_pct"][0]), float(rows["steady_2_pct"][0]))
    return Outcome(steady < 1.0, f"{percents(steady)} at rest, mean error {percents(rows['error_pct'])}")


def figure_3b(v: Values) -> Outcome:
    error, perfect = (_pid(each)["error_pct"] for each in (v, {**v, "estimates": "exact"}))
    return Outcome(error > 2.0 * perfect, f"mean error {percents(error)}, {percents(perfect)} with a perfect model")
