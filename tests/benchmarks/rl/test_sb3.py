"""Stable-baselines3: its archives are policies, its tools and vectors take the environment, actors are exported."""

import importlib
import json
import re
import subprocess
import sys
import zipfile
from argparse import Namespace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

import controllers
from benchmarks.agents.adapter import AdapterSettings
from benchmarks.agents.sb3 import ALGORITHMS, find_class, load_zip, statistics
from benchmarks.cli.parser import trust
from benchmarks.policies.loading import Untrusted
from benchmarks.policies.spec import resolve
from benchmarks.training.off_policy import export
from benchmarks.training.vec_env import ArmVecEnv
from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv
from tests.benchmarks.rl.agents import batch
from tests.controllers.closed_loop import broken_promises

ROOT = Path(__file__).parents[3]


def same_action(*policies, observation):
    """The policies give the same action, to the bit."""
    np.testing.assert_array_equal(*(policy.predict(observation, deterministic=True)[0] for policy in policies))


#: Of algorithms: their module, their network, and what makes them small.
SETTINGS = {
    "PPO": {}, "SAC": {"buffer_size": 10}, "TQC": {"module": "sb3_contrib", "buffer_size": 10},
    "ARS": {"module": "sb3_contrib"}, "RecurrentPPO": {"module": "sb3_contrib", "policy": "MlpLstmPolicy"},
}  # fmt: skip


def save_model(folder, env, algorithm="PPO"):
    """Save a model that has not learned."""
    settings = {"module": "stable_baselines3", "policy": "MlpPolicy"} | SETTINGS[algorithm]
    module = importlib.import_module(settings.pop("module"))
    model = getattr(module, algorithm)(settings.pop("policy"), env, device="cpu", seed=0, **settings)
    model.save(folder / "model.zip")
    return model, folder / "model.zip"


RescaleObservation = gymnasium.wrappers.RescaleObservation


@pytest.mark.parametrize(("env", "message"), [
    (lambda: RescaleObservation(TwoLinkArmEnv(), np.float64(-1), np.float64(1)),
     "observation_space .* -25.1327 to 25.1327, .* got .* of -1 to 1: train .*TwoLinkArmTracking-v0"),
    (lambda: TwoLinkArmEnv(action="torque"), 'got .* of -2000 to 2000, -800 to 800: train it .*"normalized"'),
    (lambda: TwoLinkArmTrackingEnv(action="torque"), "got .* of -2000 to 2000, -800 to 800: train it with action="),
    (lambda: TwoLinkArmEnv(action="acceleration"), 'got .* of -100 to 100: train it with action="normalized"'),
])  # fmt: skip
def test_an_archive_of_other_observations_or_actions_is_refused(env, message, tmp_path):
    """Although their shapes are those of the environment."""
    _, path = save_model(tmp_path, env())
    with pytest.raises(ValueError, match=message):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
def test_a_zip_of_single_precision_or_monitored_by_sb3_acts_as_it_was_saved(tmp_path):
    plain = gymnasium.make("fbl_gym/TwoLinkArm-v0")
    observation, _ = plain.reset(seed=0)
    for env in (Monitor(plain), gymnasium.wrappers.DtypeObservation(plain, np.float32)):
        model, path = save_model(tmp_path, env)
        same_action(load_zip(path, plain.unwrapped.interface, trust=True), model, observation=observation)


@pytest.mark.parametrize("algorithm", SETTINGS)
def test_an_archive_of_any_algorithm_acts_as_it_was_saved_with_trust_alone(algorithm, tmp_path):
    env = TwoLinkArmEnv()
    model, path = save_model(tmp_path, env, algorithm)
    with pytest.raises(Untrusted, match=r"give --trust if you trust its source \(in Python, trust=True\)"):
        resolve(str(path))
    with pytest.raises(ValueError, match="runs the code in it"):
        load_zip(path, env.interface)
    same_action(resolve(str(path), trust=True).make(env), model, observation=env.reset(seed=0)[0])


@pytest.mark.parametrize(("algorithm", "options"), [
    ("PPO", {}),
    ("PPO", {"scenario": "servo-delay-2", "preview": 3}),
    ("PPO", {"scenario": "servo-delay-2", "history": 2, "fine": (0.002, 0.05), "drive": True}),
    ("PPO", {"scenario": "geared-nominal", "past_actions": 0, "history": 1, "drive": True}),
    ("RecurrentPPO", {"scenario": "servo-delay-2"}),
])  # fmt: skip
def test_an_archive_of_the_tracking_environment_acts_on_the_arm_as_it_was_saved(algorithm, options, tmp_path):
    tracking = TwoLinkArmTrackingEnv(**options)
    model, path = save_model(tmp_path, tracking, algorithm)
    given = {"scenario": options.get("scenario"), "preview": options.get("preview", 0)}
    lanes = TwoLinkArmVectorEnv(2, **given, autoreset_mode="SameStep")
    archive = load_zip(path, lanes.interface, trust=True)
    a, b = tracking.reset(seed=1)[0], lanes.reset(seed=0)[0]
    mine = theirs = starts = None
    for _ in range(20):
        action, mine = model.predict(a, mine, None if starts is None else starts[1:], deterministic=True)
        actions, theirs = archive.predict(b, theirs, starts, deterministic=True)
        np.testing.assert_allclose(actions[1], action, atol=2e-3)  # the first action is from measured positions
        a, b = tracking.step(action)[0], lanes.step(actions)[0]
        starts = np.zeros(2, dtype=bool)
    restarted = archive.predict(b, theirs, np.array([True, False]), deterministic=True)[1][0]
    np.testing.assert_array_equal(restarted[1, :2], archive.predict(b, theirs, deterministic=True)[1][0][1, :2])


def test_a_file_declares_how_far_an_archive_sees(tmp_path, monkeypatch):
    """The file of the page, from another folder than the current one."""
    save_model(tmp_path, TwoLinkArmTrackingEnv("servo-nominal", preview=15))
    page = (ROOT / "docs" / "how-to" / "add-a-policy.md").read_text()
    (tmp_path / "ahead.py").write_text(re.search(r"```python\n(# ahead.py\n.*?)```", page, re.DOTALL)[1])
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert broken_promises(str(tmp_path / "ahead.py"), "servo-nominal") == []


def normalized(env, folder):
    """Return an environment behind `VecNormalize`, with statistics that are saved in a folder."""
    env = VecNormalize(env, norm_reward=False)
    env.reset()
    for _ in range(30):
        env.step(np.array([env.action_space.sample()]))
    env.training = False
    env.save(folder / "vecnormalize.pkl")
    return env


STACKS = [("first", ""), ("zeros", ""), ("first", "outside"), ("zeros", "outside"), ("zeros", "inside")]


@pytest.mark.parametrize(("padding", "place"), STACKS)
def test_an_archive_of_stacked_frames_acts_on_the_arm_as_it_was_saved(padding, place, tmp_path):
    """In a later episode, and with the statistics of `VecNormalize` outside or inside of the stack, too."""
    env = TwoLinkArmTrackingEnv("servo-delay-2", duration=0.1, preview=2, fine=(0.01, 0.1))
    frames = gymnasium.wrappers.FrameStackObservation(env, 3) if padding != "zeros" else env
    stacked = DummyVecEnv([lambda: frames])
    stacked = normalized(stacked, tmp_path) if place == "inside" else stacked
    stacked = VecFrameStack(stacked, 3) if padding == "zeros" else stacked
    stacked = normalized(stacked, tmp_path) if place == "outside" else stacked
    model, path = save_model(tmp_path, stacked)
    lanes = TwoLinkArmVectorEnv(1, "servo-delay-2", duration=0.1, preview=2, autoreset_mode="SameStep")
    archive = load_zip(path, lanes.interface, trust=True)
    stacked.seed(1)
    a, b = stacked.reset(), lanes.reset(seed=1)[0]
    state, starts = None, np.array([True])
    for _ in range(24):
        action = model.predict(a, deterministic=True)[0]
        mine, state = archive.predict(b, state, starts, deterministic=True)
        np.testing.assert_allclose(mine, action, atol=2e-3)  # the first action is from measured positions
        a, _, starts, _ = stacked.step(action)
        b, *_ = lanes.step(action)


def test_the_statistics_of_an_archive_are_the_nearest_and_named_and_part_of_its_key(tmp_path, capsys):
    _, path = save_model(tmp_path, TwoLinkArmEnv())
    checkpoint = path.with_name("rl_model_64_steps.zip")
    without = resolve(str(path), trust=True)
    (numbers := tmp_path / "vecnormalize.pkl").write_bytes(b"no pickle")
    path.with_suffix(".pkl").touch()  # of something else
    assert statistics(path) == statistics(checkpoint) == [numbers]
    assert "vecnormalize.pkl" in resolve(str(path), trust=True).data.keys() - without.data.keys()
    with pytest.raises(ValueError, match=r"vecnormalize\.pkl must be a file that VecNormalize's save wrote"):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)
    trust(Namespace(policies=["zero", str(path)], trust=True))
    assert capsys.readouterr().err == f"fbl-gym: {numbers} scales the observations of {path}\n"
    normalized(DummyVecEnv([TwoLinkArmTrackingEnv]), tmp_path)
    later = numbers.rename(tmp_path / "rl_model_vecnormalize_64_steps.pkl")
    assert (statistics(checkpoint), statistics(path)) == ([later], [])


def test_an_archive_of_the_tracking_environment_acts_on_any_arm(tmp_path):
    _, path = save_model(tmp_path, TwoLinkArmTrackingEnv())
    for scenario in ("everything-2", "servo-everything-2"):
        env = TwoLinkArmEnv(scenario)
        assert resolve(str(path), trust=True).make(env).predict(env.reset(seed=0)[0])[0] in env.action_space
    for options in ({"sensors": ("position",)}, {"preview": 1}):
        with pytest.raises(ValueError, match="observation_space must be"):
            load_zip(path, TwoLinkArmEnv(**options).interface, trust=True)


def test_an_archive_of_an_unknown_algorithm_is_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sbx", None)  # as if it were not installed
    path = tmp_path / "model.zip"
    for module, message in (
        ("mine.policies", "must be of .* got a network of mine.policies"),
        ("sbx.sac.policies", "needs sbx, which is not .*: pip install sbx-rl"),
        ("sb3_contrib.none.policies", "needs none of sb3_contrib, which has no such"),
        (None, "must be an archive that stable-baselines3's save wrote"),
        ("no zip", "must be an archive that stable-baselines3's save wrote"),
    ):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("data", json.dumps({"policy_class": {"__module__": module}} if module else {}))
        if module == "no zip":
            path.write_bytes(b"PK")
        with pytest.raises(ValueError, match=message):
            load_zip(path, TwoLinkArmEnv().interface, trust=True)


@pytest.mark.parametrize("name", ["td3", "oracle-flm"])
def test_sb3_evaluates_a_policy(name):
    env = Monitor(gymnasium.make("fbl_gym/TwoLinkArm-v0", scenario="everything-2", duration=1.0))
    env.reset(seed=0)
    reward, _ = evaluate_policy(controllers.make(name, env), env, n_eval_episodes=2)
    assert 80.0 < reward <= 100.0


@pytest.mark.slow
def test_rl_zoo3_trains_with_the_shipped_file_and_its_archive_is_a_policy(tmp_path):
    pytest.importorskip("rl_zoo3")
    options = "--env fbl_gym/TwoLinkArmTracking-v0 --gym-packages fbl_gym --eval-freq -1 -n 2048 --device cpu"
    file = str(ROOT / "benchmarks" / "training" / "rl_zoo3.yml")
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", "ppo", "--conf-file", file, *options.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (archive,) = tmp_path.rglob("*.zip")
    env = TwoLinkArmEnv("servo-nominal")
    assert load_zip(archive, env.interface, trust=True).predict(env.reset(seed=0)[0])[0] in env.action_space


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_exported_actor_acts_like_sb3s(algorithm):
    """Equal to single precision, in which SB3 computes; after some learning, so that biases and normalization matter."""
    env = ArmVecEnv(batch(2, AdapterSettings(), "everything-2"))
    options = {"n_steps": 32} if algorithm == "sb3-ppo" else {"learning_starts": 10, "buffer_size": 100}
    options |= {"seed": 0, "device": "cpu", "learning_rate": 0.01}
    model = find_class(algorithm)("MlpPolicy", env, policy_kwargs={"net_arch": [16, 16]}, **options)
    model.learn(64)
    observations = np.random.default_rng(0).uniform(-2, 2, (200, 12)).astype(np.float32)
    actions = model.predict(observations, deterministic=True)[0]
    assert actions.std() > 0.01
    np.testing.assert_allclose(export(model)(observations.astype(float)), actions, rtol=0, atol=2e-6)


LANES = 3
# Some lanes diverge, others are truncated, at different steps.
OPTIONS = {"scenario": "everything-3", "duration": 0.4, "limits": {"velocity": 4}, "constraints": {"velocity": 2}}
OPTIONS |= {"info": True, "context": True}


def batched():
    return ArmVecEnv(TwoLinkArmTrackingVectorEnv(LANES, autoreset_mode="SameStep", **OPTIONS))


def test_every_step_equals_that_of_single_environments():
    single = lambda: gymnasium.make("fbl_gym/TwoLinkArmTracking-v0", **OPTIONS)
    ours, theirs = batched(), DummyVecEnv([single] * LANES)
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    rng, ends, costs = np.random.default_rng(0), {True: 0, False: 0}, set()
    for seed in (5, None, 9):
        if seed is not None:
            assert ours.seed(seed) == theirs.seed(seed)
        np.testing.assert_array_equal(ours.reset(), theirs.reset())
        for _ in range(100):
            actions = rng.uniform(-0.5, 0.5, (LANES, 2)).astype(np.float32)
            one, two = ours.step(actions), theirs.step(actions)
            for a, b in zip(one[:3], two[:3], strict=True):
                np.testing.assert_array_equal(a, b)
                assert a.dtype == b.dtype
            infos = [*one[3], *ours.reset_infos], [*two[3], *theirs.reset_infos]
            np.testing.assert_equal(*infos)
            types = [[{name: type(x) for name, x in info.items()} for info in each] for each in infos]
            assert types[0] == types[1]
            for info in one[3]:
                costs.add(info["cost"])
                if "terminal_observation" in info:
                    ends[info["TimeLimit.truncated"]] += 1
    assert min(ends.values()) > 0
    assert costs == {0.0, 1.0}


def test_attributes_methods_and_autoreset_follow_sb3():
    env = batched()
    assert env.get_attr("render_mode") == [None] * LANES
    assert env.get_attr("interface", indices=1) == [env._batch.envs[0].interface]
    tight, mode = {"base": "nominal", "constraints": {"velocity": 2.0}}, {"autoreset_mode": "SameStep"}
    batches = [TwoLinkArmVectorEnv(2, scenario, **mode) for scenario in (tight, "everything-2")]
    for several in (ArmVecEnv(TwoLinkArmVectorEnv(4, [tight, "everything-2"], **mode)), ArmVecEnv(*batches)):
        assert [scenario.name for scenario in several.get_attr("scenario", [1, 2])] == ["nominal", "everything-2"]
    several.seed(1)  # for each of them
    np.testing.assert_array_equal(several.reset(), np.concatenate([each.reset(seed=1)[0] for each in batches]))
    assert ["cost" in info for info in several.step(np.zeros((4, 2)))[3]] == [True, True, False, False]
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [False] * LANES
    assert not env.has_attr("no_such_thing")
    for change in (lambda: env.set_attr("scenario", None), lambda: env.env_method("reset")):
        with pytest.raises(AttributeError, match="lanes share one environment"):
            change()
    with pytest.raises(ValueError, match="autoreset_mode"):
        ArmVecEnv(TwoLinkArmVectorEnv(2))


def test_seeds_and_options_hold_for_one_reset():
    env = batched()
    env.seed(4)
    first, second = env.reset(), env.reset()
    assert np.any(first != second)
    env.set_options({"mass": 3})
    with pytest.raises(ValueError, match="unknown reset option 'mass'"):
        env.reset()


def test_render_shows_all_lanes():
    pytest.importorskip("pygame")
    env = ArmVecEnv(TwoLinkArmVectorEnv(2, autoreset_mode="SameStep", render_mode="rgb_array", render_size=160))
    env.reset()
    assert (env.render("rgb_array").shape, env.metadata["render_fps"]) == ((320, 160, 3), 100)
