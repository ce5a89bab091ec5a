"""A closed loop in one environment, as many tests of controllers run it."""

import numpy as np
from scipy.linalg import expm

from benchmarks.run.contract import check
from fbl_gym import TwoLinkArmEnv, scenarios

STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}
"""A reference at rest, on which loops are linear."""

FAST = {"reference": STILL, "control_dt": 1e-3, "physics_dt": 1e-3}
EXACT = {**FAST, "action": "torque", "actuator": None}
"""A law at 1 kHz, without a drive."""


def nominal(**changes):
    """Return the nominal scenario with changes."""
    return scenarios.get("nominal").replace(**changes)


def loaded(*torque):
    """Return the options of a constant load on an arm that shall rest."""
    return {"reference": STILL, "disturbance": {"kind": "array", "torque": (torque,)}}


def error_of(env):
    """Return the true tracking error now [2] or [lanes x 2]; `env.truth` is slow."""
    signals = env._batch.true_signals()
    error = signals["reference"] - signals["position"]
    return error[0] if isinstance(env, TwoLinkArmEnv) else error


def loop(policy, env, steps, seed=0, state=None):
    """Yield observation, state, action and next state before each step."""
    observation, _ = env.reset(seed=seed)
    for _ in range(steps):
        action, after = policy.predict(observation, state)
        yield observation, state, action, after
        observation, state = env.step(action)[0], after


def tracking(policy, env, steps, seed=0):
    """Return the true tracking error at each sample [steps + 1 x ...], and the state after each step."""
    pairs = [(error_of(env), state) for *_, state in loop(policy, env, steps, seed)]
    errors, states = zip(*pairs, strict=True)
    return np.array([*errors, error_of(env)]), states


def broken_promises(policy, scenario=None):
    """Return what `fbl-gym check-policy` finds broken, by default where a payload is picked up after 3 of 4 s."""
    scenario = scenario or scenarios.get("everything-2").replace(duration=4.0)
    return [f"{found.promise}: {found.detail}" for found in check(policy, scenario) if not found.kept]


def response(a, x0, dt, steps):
    """First component of x' = a x from x0, at each sample."""
    step, x, log = expm(np.array(a) * dt), np.array(x0), []
    for _ in range(steps + 1):
        log.append(x[0])
        x = step @ x
    return np.array(log)
