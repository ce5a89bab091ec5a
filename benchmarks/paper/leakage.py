"""The leakage of a wrong model: in the simulation, and by the paper's formulas."""

from typing import Any

import numpy as np

from benchmarks.paper.claim import Case, Finding, run
from benchmarks.report.plot import Line, Panel
from benchmarks.run.rollout import Watch
from fbl_gym import Scenario, TwoLinkArmVectorEnv
from fbl_gym.model.arm import Array, coriolis_matrix, forward_dynamics, gravity_torque, inertia_matrix


def leakage(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return LS(t) = a - q'' of equation (5) from the simulated acceleration, [n x 2] rad/s^2."""
    return env.truth.leakage


def leakage_formula(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
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


def stiction_leakage(env: TwoLinkArmVectorEnv, _policy: Any, _state: Any) -> Array:
    """Return M^-1 F_s of equation (45), F_s being all of the friction, [n x 2] rad/s^2."""
    truth = env.truth
    inertia = inertia_matrix(truth.lumped, truth.position)
    m11, m12, m22 = inertia[:, 0, 0], inertia[:, 0, 1], inertia[:, 1, 1]
    f1, f2 = truth.friction_torque.T
    return np.stack([m22 * f1 - m12 * f2, m11 * f2 - m12 * f1], axis=-1) / (m11 * m22 - m12 * m12)[:, None]


def compare_leakage(policy: str, scenario: Scenario, formula: Watch = leakage_formula, **perfect: Any) -> Finding:
    """Return the finding that a formula computes the leakage, and that a perfect model has none.

    `perfect` has the options of the scenario with which the model is perfect.
    """
    series = []
    for task in (scenario, scenario.replace(**perfect)):
        trace, _ = run(policy, task, watch={"leakage": leakage, "formula": formula})
        end = int(trace.alive[1:, 0].sum())
        series.append([trace.time[1 : end + 1], *(trace.watched[name][:end, 0] for name in ("leakage", "formula"))])
    (t, measured, computed), (_, complete, _) = series
    difference, remaining = np.abs(measured - computed).max(), np.abs(complete).max()
    panels = [
        Panel(
            f"joint {joint + 1}", "time [s]", "leakage [rad/s²]",
            (
                Line(t, measured[:, joint], "a − q̈ in the simulation", "tab:red"),
                Line(t, computed[:, joint], "formula", "black", ":"),
                Line(t, complete[: len(t), joint], "complete model", "tab:blue"),
            ),
        )
        for joint in (0, 1)
    ]  # fmt: skip
    text = (
        f"up to {np.abs(measured).max():.3g} rad/s^2; simulation and formula differ by at most {difference:.1e} at "
        f"{len(t):,} samples; with a complete model the leakage is at most {remaining:.1e}"
    )
    cases = [Case("all samples", difference < 1e-8 and remaining < 1e-8)]
    return Finding(cases, text, f"Leakage, {policy} on {scenario.name}", panels)
