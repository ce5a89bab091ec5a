"""The option `actuator`: limit, delay and lag, between the command and the plant."""

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv
from tests.fbl_gym.episodes import play, torques


def test_the_torque_limit_clips_the_applied_torque():
    _, _, truths = play(actuator={"torque_limit": (100.0, 30.0)})
    for k, truth in enumerate(truths[1:]):
        assert np.array_equal(truth.applied_torque, np.clip(torques(k), [-100.0, -30.0], [100.0, 30.0]))


@pytest.mark.parametrize("plant", [None, "mujoco"])
@pytest.mark.parametrize(("action", "acts"), [("normalized", 6.0), ("torque", 1.0), ("acceleration", None)])
def test_a_joint_without_a_drive_moves_freely_and_laws_refuse_it(action, acts, plant):
    if plant:
        pytest.importorskip("mujoco")
    options = {"scenario": "dfki-c1-acrobot", "action": action, "plant": plant, "info": True}
    env, batch = TwoLinkArmTrackingEnv(**options), TwoLinkArmTrackingVectorEnv(2, **options)
    for each in (env, batch):
        each.reset(seed=0)
        observation, reward, _, _, info = each.step(np.ones((2, 2) if each is batch else 2))
        torque = np.atleast_2d(each.truth.applied_torque)
        assert (torque[:, 0] == 0.0).all()
        assert acts is None or (torque[:, 1] == acts).all()
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        np.testing.assert_array_equal(info["saturation"], 0.5 if acts == 6.0 else 0.0)
    assert env.interface.torque_limit == (0.0, 6.0)
    with pytest.raises(ValueError, match="ComputedTorque needs both drives"):
        controllers.make("computed-torque", env)


@pytest.mark.parametrize("late", [1, 3, 10, 13, 20, 37])
def test_a_delay_counts_in_physics_steps(late):
    """An arm without a delay gets the same commands later, and before them the torque at rest."""
    slow = TwoLinkArmEnv(action="torque", actuator={"delay": late * 1e-3})
    prompt = TwoLinkArmEnv(action="torque", control_dt=1e-3)
    slow.reset(seed=0)
    prompt.reset(seed=0)
    commands = [prompt.truth.applied_torque] * late
    for k in range(20):
        commands += [torques(3 * k, 1)[0]] * 10
        slow.step(commands[-1])
        for j in range(10):
            prompt.step(commands[10 * k + j])
        for name in ("position", "velocity", "applied_torque"):
            np.testing.assert_array_equal(getattr(slow.truth, name), getattr(prompt.truth, name))
