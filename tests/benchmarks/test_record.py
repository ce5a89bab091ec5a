"""`fbl-gym record`: the data set says all that happened, and the environment repeats it."""

import numpy as np
import pytest

from benchmarks.training.training_settings import training_seeds
from fbl_gym import scenarios

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")
record = pytest.importorskip("benchmarks.run.episodes").record

COMMAND = ["record", "computed-torque", "--scenario", "payload-2", "--episodes", "2", "--noise", "0.1", "--out"]


def test_the_environment_repeats_a_recorded_episode(tmp_path, monkeypatch, fbl_gym):
    assert "2 episodes, 0 terminated" in fbl_gym([*COMMAND, str(tmp_path / "noisy-v0")]).out
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    data = minari.load_dataset("noisy-v0")
    assert data.storage.metadata["algorithm_name"] == "computed-torque"
    assert (data.total_episodes, data.total_steps) == (2, 2000)
    (seed,) = [metadata["seed"] for metadata in data.storage.get_episode_metadata([1])]
    assert seed == training_seeds(0)[1]
    env, episode = data.recover_environment(), data[1]
    np.testing.assert_array_equal(env.reset(seed=int(seed))[0], episode.observations[0])
    signals = episode.actions, episode.rewards, episode.observations[1:], episode.infos["position"][1:]
    for action, reward, observation, position in zip(*signals, strict=True):
        result = env.step(action)
        np.testing.assert_array_equal(result[0], observation)
        np.testing.assert_array_equal(env.unwrapped.truth.position, position)
        assert result[1] == reward
    assert result[3]
    assert np.flatnonzero(episode.truncations).tolist() == [999]
    assert set(episode.infos["payload"]) == {0.0, 10.0}
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(("observed", "size"), [("tracking", 12), ("raw", 12)])
def test_an_episode_ends_where_the_arm_diverged(observed, size):
    """The lane's next episode is not recorded."""
    limits = {"error": 0.5, "error_time": 0.05}
    episodes = record("zero", scenarios.get("nominal").replace(limits=limits), range(3), observed=observed)
    for episode in episodes:
        steps = len(episode["actions"])
        assert steps < 1000
        assert np.flatnonzero(episode["terminations"]).tolist() == [steps - 1]
        assert episode["observations"].shape == (steps + 1, size)
        np.testing.assert_allclose(episode["infos"]["time"], 0.01 * np.arange(steps + 1))
