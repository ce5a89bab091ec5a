"""Swing up an acrobot and a pendubot, and score the motion by the rules of DFKI's leaderboard.

    python examples/swing_up.py

The robots have one drive for two joints. The rules are those of version 2,
github.com/dfki-ric-underactuated-lab/real_ai_gym_leaderboard.
"""

import numpy as np

import controllers
import fbl_gym
from fbl_gym.model.arm import joint_positions

NORMS = {"time": 20.0, "energy": 60.0, "torque_cost": 20.0, "smoothness": 0.1, "velocity_cost": 400.0}


def criteria(env, policy):
    """Return DFKI's criteria of an episode by name: success, time [s], energy [J] and so on."""
    (observation, _), state, over = env.reset(seed=0), None, False
    truth = env.truth
    motion, torques = [[*truth.position, *truth.velocity]], []
    while not over:
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        truth = env.truth
        motion.append([*truth.position, *truth.velocity])
        torques.append(truth.applied_torque)
    motion, torques, dt = np.array(motion), np.array(torques), env.scenario.control_dt
    arm = env.scenario.arm
    height = joint_positions(arm, motion[:, :2])[:, 2, 1]
    up = height > 0.9 * (arm.L1 + arm.L2)  # the threshold line
    return {
        "success": bool(up[-1]) and not terminated,
        "time": dt * np.max(np.flatnonzero(~up), initial=-1) + dt,  # from which the tip stays above the line
        "energy": np.abs(np.diff(motion[:, :2], axis=0) * torques).sum(),
        "torque_cost": dt * (torques**2).sum(),
        "smoothness": np.diff(torques, axis=0).std(axis=0).sum(),  # standard deviation of the torque's changes
        "velocity_cost": dt * (motion[:-1, 2:] ** 2).sum(),
    }


def score(found):
    """Return the RealAI score of criteria: 0 to 1, and 0 without success."""
    return found["success"] * (1.0 - np.mean([np.tanh(np.pi * found[name] / norm) for name, norm in NORMS.items()]))


if __name__ == "__main__":
    for robot in ("acrobot", "pendubot"):
        env = fbl_gym.TwoLinkArmEnv(f"dfki-c1-{robot}")
        found = criteria(env, controllers.make("swing-up", env))
        print(robot, {name: round(float(value), 3) for name, value in found.items()}, f"score {score(found):.3f}")
