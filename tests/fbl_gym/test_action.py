"""Actions, from what is given to the torque at the joints."""

import numpy as np

from fbl_gym import TwoLinkArmEnv
from fbl_gym.arm import gravity_torque


def test_three_kinds_of_action_are_one_plant():
    """The same wish as fraction, torque and acceleration moves the arm alike."""
    ends = []
    for action in ("fraction", "torque", "acceleration"):
        env = TwoLinkArmEnv(action=action, parameter_error=1.3)
        observation, _ = env.reset(seed=2)
        rng = np.random.default_rng(0)
        for _ in range(100):
            q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
            torque = gravity_torque(env.nominal, q) + rng.normal(size=2) * (40.0, 10.0)
            wish = env.interface.action_from_torque(torque, q, v)
            np.testing.assert_allclose(env.interface.torque_from_action(wish, q, v), torque, rtol=1e-9)
            observation = env.step(wish)[0]
        ends.append(env.truth.position)
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], (3, 2)), atol=1e-9)


def test_an_action_beyond_the_box_acts_as_its_edge():
    one, two = TwoLinkArmEnv(), TwoLinkArmEnv()
    one.reset(seed=0)
    two.reset(seed=0)
    np.testing.assert_array_equal(one.step((7.0, -3.0))[0], two.step((1.0, -1.0))[0])
