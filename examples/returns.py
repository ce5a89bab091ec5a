"""Print how policies rank by the reward, and by the error.

    python examples/returns.py servo-practice-nominal

Each line shows the mean return of 32 episodes, the mean absolute error in mrad (0 after a run has
diverged), and the number of runs that diverged.
"""

import sys

import numpy as np

import controllers
from fbl_gym import TwoLinkArmVectorEnv

POLICIES = ("random", "zero", "cascade-flm@tuned", "computed-torque-dob@tuned", "lqg-elastic@tuned", "ppo")
for scenario in sys.argv[1:]:
    for name in POLICIES:
        env = TwoLinkArmVectorEnv(32, scenario, action="normalized")
        env.action_space.seed(0)
        law, state = None if name == "random" else controllers.make(name, env), None
        (observation, _), alive, returns, errors = env.reset(seed=0), np.ones(32), 0.0, 0.0
        for _ in range(env.scenario.steps):
            action = env.action_space.sample()
            if law is not None:
                action, state = law.predict(observation, state)
            observation, reward, terminated, _, _ = env.step(action)
            returns += alive * reward
            errors += alive * np.abs(env.truth.reference - env.truth.position).mean(axis=1)
            alive *= ~terminated
        error = 1e3 * errors.mean() / env.scenario.steps
        print(f"{scenario} {name}: {returns.mean():.1f}, {error:.1f} mrad, {32 - alive.sum():.0f} diverged")
