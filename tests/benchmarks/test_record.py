"""`fbl-gym record`: the data set says all that happened, and the environment repeats it."""

import json

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import cli
from benchmarks.run.episodes import record
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios

COMMAND = ["record", "computed-torque", "--scenario", "payload-2", "--episodes", "2", "--noise", "0.1", "--out"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "noisy-v0"
    assert cli.main([*COMMAND, str(path)]) == 0
    return path


def replay(env, seed, observations, actions, rewards):
    """Check that an environment repeats an episode bit for bit."""
    np.testing.assert_array_equal(env.reset(seed=int(seed))[0], observations[0])
    for action, reward, observation in zip(actions, rewards, observations[1:], strict=True):
        result = env.step(action)
        np.testing.assert_array_equal(result[0], observation)
        assert result[1] == reward
    assert result[3]


def test_the_environment_repeats_a_recorded_episode(folder):
    description = json.loads((folder / "description.json").read_text())
    env = gym.make(description["environment"], **description["options"])
    data = np.load(folder / "episodes.npz")
    assert set(data["seeds"]) <= set(SPLITS["training"][:1000])
    assert data["episode_ends"].tolist() == [1000, 2000]
    assert np.flatnonzero(data["truncations"]).tolist() == [999, 1999]
    second = slice(1000, 2000)
    observations = np.concatenate([data["observations"][second], data["next_observations"][-1:]])
    replay(env, data["seeds"][1], observations, data["actions"][second], data["rewards"][second])


def test_the_truth_stands_apart(folder):
    names, truth = np.load(folder / "episodes.npz").files, np.load(folder / "truth.npz")
    assert not set(names) & set(truth.files)
    assert truth["position"].shape == truth["masses"].shape == (2000, 2)
    assert set(truth["payload"]) == {0.0, 10.0}


def test_minari_loads_the_data_set_and_its_environment(folder, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder.parent))
    data = minari.load_dataset("noisy-v0")
    (seed,) = [metadata["seed"] for metadata in data.storage.get_episode_metadata([1])]
    replay(data.recover_environment(), seed, data[1].observations, data[1].actions, data[1].rewards)


@pytest.mark.parametrize(("observed", "size"), [("tracking", 12), ("raw", 12)])
def test_an_episode_ends_where_the_arm_diverged(observed, size):
    """The lane's next episode is not recorded."""
    limits = {"error": 0.5, "error_time": 0.05}
    data = record("zero", scenarios.get("nominal").replace(limits=limits), range(3), observed=observed)
    steps = data.steps
    assert data.ends[-1] == len(steps["observations"]) < 3000
    assert np.flatnonzero(steps["terminations"]).tolist() == (data.ends - 1).tolist()
    assert steps["observations"].shape[1] == size
    first, last = [0, *data.ends[:-1]], data.ends
    for begin, end in zip(first, last, strict=True):
        np.testing.assert_array_equal(
            steps["observations"][begin + 1 : end], steps["next_observations"][begin : end - 1]
        )
        assert data.truth["time"][begin] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--scenario hardware-noise-2 --out a-v0", "hardware-noise-2 is for judging alone"),
        ("--out mine", "must end in a name and a version, such as data/expert-v0, got 'mine'"),
        ("--out old-v0", "must be a new folder, got 'old-v0', which exists; give another version"),
        ("--out a-v0 --episodes 1001", "must be at most 1000, the seeds of one --seed, got '1001'"),
        ("--out a-v0 --seed 99999999", "seed must be 0 to 2146482, got 99999999"),
        ("--out a-v0 --noise -1", "noise must not be negative, got -1"),
    ],
)
def test_a_mistake_is_answered_with_what_is_right(options, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old-v0").mkdir()
    try:
        status = cli.main(["record", "zero", *options.split()])
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert message in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 1
