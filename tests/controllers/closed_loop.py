"""A closed loop in one environment, as many tests of controllers run it."""

import numpy as np

import controllers
from benchmarks.run.contract import check
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios

# References at rest, on which loops are linear, and an exciting one.
STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}
EXCITING = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}
REST = (-np.pi / 2, 0.4)
HANGING = {"reference": {"kind": "minimum-jerk", "points": (REST,)}}

FAST = {"reference": STILL, "control_dt": 1e-3, "physics_dt": 1e-3}
# A law at 1 kHz, without a drive.
EXACT = {**FAST, "action": "torque", "actuator": None}


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


def mean_error(name, steps=300, skip=50, lanes=4, **options):
    """Return the mean true error of a law after its first samples [rad]."""
    env = TwoLinkArmVectorEnv(lanes, **options)
    return np.abs(tracking(controllers.make(name, env), env, steps)[0][skip:]).mean()


def broken_promises(policy, scenario=None):
    """Return what `fbl-gym check-policy` finds broken, by default where a payload is picked up after 3 of 4 s."""
    scenario = scenario or scenarios.get("everything-2").replace(duration=4.0)
    return [f"{found.promise}: {found.detail}" for found in check(policy, scenario) if not found.kept]
