"""A closed loop in one environment, as many tests of controllers run it."""

import numpy as np


def tracking(policy, env, steps, seed=0):
    """Return the true tracking error at each sample [steps + 1 x ...], and the state after each step."""
    observation, _ = env.reset(seed=seed)
    state, states = None, []
    errors = [env.truth.reference - env.truth.position]
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        states.append(state)
        errors.append(env.truth.reference - env.truth.position)
    return np.array(errors), states
