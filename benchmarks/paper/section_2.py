"""Section 2: the linearised plant, the leakage of a wrong model, and PID; figures 2 and 3."""

from typing import Any

import numpy as np

from benchmarks.paper.claim import Outcome, Rows, Values, claim, percents
from benchmarks.paper.measuring import at_rate, run, with_estimates
from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import Array, coriolis_matrix, forward_dynamics, gravity_torque, inertia_matrix, inverse_dynamics

HANGING = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.0),)}
"""A reference that stays at the hanging position."""


@claim(
    "2", "the linearised plant is decoupled", paper="second-order decoupled dynamics",
    bound="joint 1 is commanded to move 1 rad: it stays within 1 mrad of a double integrator, and joint 2 within 1 mrad",
    stated={"arm": ("§2.2", "Table 1"), "estimates": ("exact",)}, chosen={"rate": "10 kHz"},
    cases=[{"arm": "Table 1"}, {"estimates": "half"}, {"estimates": "mixed"}],
)  # fmt: skip
def figure_2(v: Values) -> Outcome:
    scenario = at_rate(scenarios.get("nominal"), v["rate"], actuator=None, duration=1.0, reference=HANGING)
    q = _pulse_motion(with_estimates(scenario, v["arm"], v["estimates"]))
    t = scenario.control_dt * np.arange(len(q))
    integrator = 2.0 * t**2 - 4.0 * np.maximum(t - 0.5, 0.0) ** 2
    deviation, stray = np.abs(q[:, 0] - integrator).max(), np.abs(q[:, 1]).max()
    text = f"joint 2 moves {stray:.2g} rad, joint 1 within {deviation:.2g} rad of a double integrator"
    return Outcome(max(stray, deviation) < 1e-3, text)


def _pulse_motion(scenario: Scenario) -> Array:
    """Return the joint angles from the start, [T + 1 x 2] rad.

    The acceleration of joint 1 is 4 rad/s^2 for 0.5 s, then -4 rad/s^2 for 0.5 s.
    """
    env = TwoLinkArmEnv(scenario, action="torque")
    observation, _ = env.reset(seed=0)
    position, velocity = (env.interface.layout[name] for name in ("position", "velocity"))
    positions = [observation[position]]
    for k in range(scenario.steps):
        a = np.array([4.0 if k * scenario.control_dt < 0.5 - 1e-9 else -4.0, 0.0])
        torque = inverse_dynamics(env.interface.nominal, observation[position], observation[velocity], a)
        observation = env.step(torque)[0]
        positions.append(observation[position])
    return np.array(positions) - positions[0]


def leakage_of(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return LS(t) = a - q'' of equation (5) from the simulated acceleration, [n x 2] rad/s^2.

    a is the acceleration that the nominal model expects of the applied torque.
    """
    truth = env.truth
    return (
        forward_dynamics(env.interface.nominal, truth.position, truth.velocity, truth.applied_torque)
        - truth.acceleration
    )


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
    truth = env.truth
    inertia = inertia_matrix(truth.lumped, truth.position)
    m11, m12, m22 = inertia[:, 0, 0], inertia[:, 0, 1], inertia[:, 1, 1]
    f1, f2 = truth.friction_torque.T
    return np.stack([m22 * f1 - m12 * f2, m11 * f2 - m12 * f1], axis=-1) / (m11 * m22 - m12 * m12)[:, None]


_LOADED = scenarios.get("paper-8").replace(
    friction=None, disturbance={"kind": "piecewise-constant", "amplitude": (50.0, 20.0)}
)
_CAUSES: dict[str, tuple[str, Scenario, Any]] = {
    "parameters": ("pid-flm", scenarios.get("paper-3b"), _leakage_formula),
    "disturbance": ("cascade-flm", _LOADED, _leakage_formula),
    "stiction": ("cascade-flm", scenarios.get("paper-8"), _stiction_formula),
}


@claim(
    "(5), (6), (45)", "a wrong model leaves the leakage LS of (5), (6) and (45)", paper="x2' = a - LS",
    bound="simulation and formula differ by less than 1e-9 rad/s^2 at every sample. (6) is read as M^-1 (tau_d - tau_d^); "
    "for parameters, its general form with the differences of M, C and G",
    stated={"cause": tuple(_CAUSES)}, chosen={}, cases=[{"cause": "disturbance"}, {"cause": "stiction"}],
    scenario="paper-3b, paper-8",
)  # fmt: skip
def leakage(v: Values) -> Outcome:
    policy, scenario, formula = _CAUSES[v["cause"]]
    trace, _ = run(policy, scenario, watch={"leakage": leakage_of, "formula": formula})
    simulated, computed = (trace.watched[name][trace.alive[1:]] for name in ("leakage", "formula"))
    met = bool(np.abs(simulated - computed).max() < 1e-9)
    return Outcome(met, f"up to {np.abs(simulated).max():.3g} rad/s^2 at {len(simulated):,} samples")


_REFERENCES: dict[str, dict[str, Any]] = {
    "literal steps": {"kind": "steps", "period": 4.0},
    "steps behind 8 rad/s": {"kind": "filtered-steps", "period": 4.0, "bandwidth": 8.0},
    "moves of 1.5 s": {"kind": "minimum-jerk", "move_time": 1.5, "hold_time": 2.5},
}
_OTHERS = [{"reference": name} for name in ("moves of 1.5 s", "steps behind 8 rad/s")]
_GAINS: dict[str, Any] = {"P 10, D 3": {}, "P 10, I 3, D 0 (as printed)": {"kp": 10.0, "ki": 3.0, "kd": 0.0}}


def _pid(v: Values) -> Rows:
    """Return the metrics of PID on figure 3's motion."""
    scenario = with_estimates(scenarios.get("paper-3a"), v["arm"], v["estimates"])
    reference = {"points": vars(scenario.reference)["points"], **_REFERENCES[v["reference"]]}
    return run("pid-flm", scenario.replace(reference=reference), **_GAINS[v["gains"]])[1]


@claim(
    "3a", "PID with a perfect model tracks", paper="good control performance",
    bound="error at rest below 1 %; P, I, D = 10, 3, 0 is read as P = 10, D = 3",
    stated={"arm": ("§2.2", "Table 1"), "estimates": ("exact",), "gains": ("P 10, D 3",)},
    chosen={"reference": "literal steps"}, scenario="paper-3a",
    cases=[*_OTHERS, {"arm": "Table 1"}, {"gains": "P 10, I 3, D 0 (as printed)"}],
)  # fmt: skip
def figure_3a(v: Values) -> Outcome:
    rows = _pid(v)
    steady = max(float(rows["steady_1_pct"][0]), float(rows["steady_2_pct"][0]))
    return Outcome(steady < 1.0, f"{percents(steady)} at rest, mean error {percents(rows['error_pct'])}")


@claim(
    "3b", "PID with model errors of 50 % does not track", paper="nonlinear and coupled leakages",
    bound="the mean error is at least twice that with a perfect model",
    stated={"arm": ("§2.2", "Table 1"), "estimates": ("half",), "gains": ("P 10, D 3",)},
    chosen={"reference": "literal steps"}, scenario="paper-3b",
    cases=[*_OTHERS, {"arm": "Table 1"}, {"estimates": "double"}, {"estimates": "double", **_OTHERS[1]}],
)  # fmt: skip
def figure_3b(v: Values) -> Outcome:
    rows, perfect = _pid(v), _pid({**v, "estimates": "exact"})
    text = f"mean error {percents(rows['error_pct'])}, {percents(perfect['error_pct'])} with a perfect model"
    return Outcome(bool(rows["error_pct"][0] > 2.0 * perfect["error_pct"][0]), text)
