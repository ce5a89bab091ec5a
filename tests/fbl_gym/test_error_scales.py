"""The entries of error coordinates; `test_tracking.py` has the environments with them."""

import numpy as np

from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv

OPTIONS = {"scenario": "everything-2", "duration": 0.5, "preview": 2, "actuator": {"delay": 0.01}}


def test_error_coordinates_are_the_documented_ones():
    plain, wrapped = TwoLinkArmEnv(**OPTIONS), TwoLinkArmTrackingEnv(**OPTIONS)
    a, b = plain.reset(seed=1)[0], wrapped.reset(seed=1)[0]
    for _ in range(20):
        at = plain.layout
        expected = [
            (a[at["reference_position"]] - a[at["position"]]) / 0.1,
            a[at["reference_velocity"]] - a[at["velocity"]],
            a[at["position"]] + [np.pi / 2, 0.0],
            a[at["velocity"]],
            a[at["reference_acceleration"]] / 10.0,
        ]
        now = np.concatenate([a[at[f"reference_{name}"]] for name in ("position", "velocity", "acceleration")])
        scale = np.array([0.1, 0.1, 1.0, 1.0, 10.0, 10.0])
        expected += [(sample - now) / scale for sample in a[at["preview"]].reshape(2, 6)]
        expected.append(a[at["previous_actions"]])
        np.testing.assert_allclose(b, np.clip(np.concatenate(expected), -10, 10), rtol=1e-6, atol=1e-6)
        a, b = plain.step((0.1, -0.2))[0], wrapped.step((0.1, -0.2))[0]


def test_error_coordinates_without_sensors():
    env = TwoLinkArmTrackingEnv(sensors=("position",))
    assert env.reset(seed=0)[0].shape == (8,)
