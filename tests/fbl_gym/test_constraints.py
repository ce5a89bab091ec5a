"""Constraints: their cost in the info and their end of an episode. `test_lanes.py` compares batches with single arms."""

import numpy as np
import pytest

from fbl_gym import Constraints, TwoLinkArmEnv
from tests.fbl_gym.episodes import TIGHT, started


@pytest.mark.parametrize("options", [{}, {"joint": {"stiffness": 4000, "rotor_inertia": 0.5}, "info": True}], ids=str)
def test_the_cost_is_one_beyond_a_bound(options):
    env, plain = TwoLinkArmEnv("everything-2", constraints=TIGHT, **options), TwoLinkArmEnv("everything-2", **options)
    assert env.reset(seed=1)[1] == {}
    plain.reset(seed=1)
    costs = []
    for k in range(80):
        action = np.full(2, 0.4 if k % 40 < 20 else -0.4)
        *step, info = env.step(action)
        for ours, theirs in zip(step, plain.step(action), strict=False):
            np.testing.assert_array_equal(ours, theirs)
        truth = env.truth
        assert info["cost"] == env.scenario.constraints.violated(truth.position, truth.velocity)
        costs.append(info["cost"])
    assert set(costs) == {0.0, 1.0}
    assert set(info) == ({"cost"} if not options else {*plain.step(action)[4], "cost"})


@pytest.mark.parametrize(
    ("bound", "value", "joint"),
    [("low", (-1.5, -9.0), 0), ("high", (9.0, 0.3), 1), ("velocity", (0.5, 99.0), 0), ("velocity", (99.0, 0.5), 1)],
)
def test_each_bound_counts(bound, value, joint):
    env = started(constraints={bound: value}, action="torque", seed=3)
    costs = set()
    for _ in range(100):
        cost = env.step((0.0, 0.0))[4]["cost"]
        position, speed = env.truth.position[joint], abs(env.truth.velocity[joint])
        distances = {"low": position - value[joint], "high": value[joint] - position, "velocity": value[joint] - speed}
        costs.add(cost)
        assert cost == (distances[bound] < 0.0)
    assert costs == {0.0, 1.0}
    assert Constraints(**{bound: value}) == env.interface.constraints


def test_an_end_has_no_reward():
    env = started(constraints={**TIGHT, "violation": "end"})
    while not (step := env.step((0.3, 0.3)))[2]:
        assert step[4]["cost"] == 0.0
    assert (step[1], step[4]["cost"]) == (0.0, 1.0)
