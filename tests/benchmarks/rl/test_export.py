"""The export of SB3 models to NumPy."""

import numpy as np
import pytest

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.export import export
from benchmarks.rl.sb3 import ALGORITHMS, find_class
from benchmarks.rl.vec_env import ArmVecEnv, VectorAdapter
from fbl_gym import TwoLinkArmVectorEnv

OFF_POLICY = {"learning_starts": 10, "buffer_size": 100}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_exported_actor_acts_like_sb3s(algorithm):
    """Equal to single precision, in which SB3 computes; after some learning, so that biases and normalization matter."""
    if ALGORITHMS[algorithm].startswith("sb3_contrib"):
        pytest.importorskip("sb3_contrib")
    arms = TwoLinkArmVectorEnv(2, "everything-2", autoreset_mode="SameStep")
    options = {"n_steps": 16, "batch_size": 16} if algorithm == "ppo" else OFF_POLICY
    model = find_class(algorithm)(
        "MlpPolicy",
        ArmVecEnv(VectorAdapter(arms, AdapterSettings())),
        seed=0,
        device="cpu",
        learning_rate=0.01,
        policy_kwargs={"net_arch": [16, 16]},
        **options,
    )
    model.learn(64)
    observations = np.random.default_rng(0).uniform(-2, 2, (200, 12)).astype(np.float32)
    actions = model.predict(observations, deterministic=True)[0]
    assert actions.std() > 0.01
    np.testing.assert_allclose(export(model)(observations.astype(float)), actions, rtol=0, atol=2e-6)
