"""Agents as policies: what SB3's model did in training, the NumPy actor does anywhere."""

import dataclasses
import importlib
import json
import zipfile

import gymnasium
import numpy as np
import pytest

from benchmarks.policies import external
from benchmarks.policies.spec import resolve
from benchmarks.rl.interface import ACTIONS, CONTEXT, AgentInterface, Body, VectorBody
from benchmarks.rl.policy import ALGORITHMS, Actor, Agent, SavedAgent, load_zip, read, saved_agent, write
from benchmarks.rl.train import export
from benchmarks.rl.vec_env import ArmVecEnv
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.wrappers import ErrorCoordinates

SMALL = {
    "ppo": {"n_steps": 16, "batch_size": 16},
    "sac": {"learning_starts": 10, "buffer_size": 100},
    "td3": {"learning_starts": 10, "buffer_size": 100},
    "tqc": {"learning_starts": 10, "buffer_size": 100},
    "crossq": {"learning_starts": 10, "buffer_size": 100},
}


def actor(agent, interface, seed=0):
    """A network of random weights that fits."""
    rng, size = np.random.default_rng(seed), Body(agent, interface).size
    layers = ((rng.normal(0, 0.3, (8, size)), rng.normal(0, 0.1, 8)), (rng.normal(0, 0.3, (2, 8)), np.zeros(2)))
    return Actor(tuple((np.float32(w).astype(float), np.float32(b).astype(float)) for w, b in layers), "tanh", "clip")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_exported_actor_is_sb3s_own(algorithm):
    """To the single precision in which SB3 computes; after some learning, so that no bias or normalisation is trivial."""
    module, name = ALGORITHMS[algorithm].split(":")
    if module == "sb3_contrib":
        pytest.importorskip(module)
    env = ArmVecEnv(VectorBody(TwoLinkArmVectorEnv(2, "everything-2", autoreset_mode="SameStep"), AgentInterface()))
    model = getattr(importlib.import_module(module), name)(
        "MlpPolicy",
        env,
        seed=0,
        device="cpu",
        learning_rate=0.01,
        policy_kwargs={"net_arch": [16, 16]},
        **SMALL[algorithm],
    )
    model.learn(64)
    seen = np.random.default_rng(0).uniform(-2, 2, (200, 12))
    theirs = model.predict(seen.astype(np.float32), deterministic=True)[0]
    assert theirs.std() > 0.01
    np.testing.assert_allclose(export(model)(seen.astype(np.float32).astype(float)), theirs, rtol=0, atol=2e-6)


# A payload that is picked up and dropped within a short episode.
HEAVY = {"radius": 0.5, "payload": {"mass": 10.0, "pick_up": 0.1, "drop": 0.2}}
SHORT = {"scenario": "everything-2", "duration": 0.3, "parameter_error": HEAVY}


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("history", [0, 3])
@pytest.mark.parametrize("context", [False, True])
def test_an_agent_acts_as_it_did_in_training(action, history, context):
    """Its closed loop on the plain environment is that of its actor on the training environment, over several episodes."""
    agent = AgentInterface(action=action, history=history, context=context)
    options = {**SHORT, "autoreset_mode": "SameStep"}
    plain, trained = TwoLinkArmVectorEnv(3, **options), VectorBody(TwoLinkArmVectorEnv(3, **options), agent)
    policy = Agent(plain.interface, agent, actor(agent, plain.interface), plain if context else None)
    a, b = plain.reset(seed=3)[0], trained.reset(seed=3)[0]
    state, starts = None, np.ones(3, dtype=bool)
    ended = 0
    for _ in range(70):
        actions, state = policy.predict(a, state, starts)
        a, reward, terminated, truncated, _ = plain.step(actions)
        b, *theirs, infos = trained.step(policy.actor(b))
        starts = terminated | truncated
        for mine, his in zip((reward, terminated, truncated), theirs, strict=True):
            np.testing.assert_array_equal(mine, his)
        for lane in np.flatnonzero(starts):
            assert infos["final_obs"][lane].shape == (policy.body.size,)
            ended += 1
    assert ended == 6
    np.testing.assert_array_equal(plain.truth.position, trained.env.unwrapped.truth.position)


def test_history_is_the_errors_and_actions_of_the_last_steps():
    env = VectorBody(TwoLinkArmVectorEnv(2, autoreset_mode="SameStep", duration=0.1), AgentInterface(history=2))
    seen, actions = [env.reset(seed=1)[0]], []
    np.testing.assert_array_equal(seen[0][:, 12:], 0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions.append(rng.uniform(-1, 1, (2, 2)).astype(np.float32))
        seen.append(env.step(actions[-1])[0])
    expected = np.concatenate([seen[5][:, :12], seen[4][:, :12], actions[4], seen[3][:, :12], actions[3]], axis=-1)
    np.testing.assert_array_equal(seen[5], expected)
    for _ in range(5):
        last, *_, infos = env.step(np.zeros((2, 2)))
    np.testing.assert_array_equal(last[:, 12:], 0)  # a new episode
    assert np.any(infos["final_obs"][0][12:] != 0)


def told(env):
    """What an agent with context is to be told, by its definition."""
    truth, nominal = env.unwrapped.truth, env.unwrapped.interface.nominal
    real = zip(*truth.masses.T, *truth.lengths.T, truth.payload, strict=True)
    return [
        [
            np.log(a / nominal.m1),
            np.log(b / nominal.m2),
            np.log(c / nominal.L1),
            np.log(d / nominal.L2),
            load / nominal.m2,
        ]
        for a, b, c, d, load in real
    ]


@pytest.mark.parametrize("history", [0, 2])
def test_context_is_the_truth_behind_what_any_agent_sees(history):
    """The truth of each instant, of the finished episode in its last observation; all else as without context."""
    plain, env = (
        VectorBody(
            TwoLinkArmVectorEnv(3, **SHORT, autoreset_mode="SameStep"), AgentInterface(history=history, context=context)
        )
        for context in (False, True)
    )
    size = plain.single_observation_space.shape[0]
    assert env.single_observation_space.shape == (size + len(CONTEXT),)
    rng, loads = np.random.default_rng(0), set()
    one, two = plain.reset(seed=4)[0], env.reset(seed=4)[0]
    for _ in range(45):
        before = told(env)
        np.testing.assert_array_equal(two[:, :size], one)
        np.testing.assert_allclose(two[:, size:], before, rtol=0, atol=1e-15)
        loads.add(float(two[0, -1]))
        actions = rng.uniform(-1, 1, (3, 2))
        one, *_, old = plain.step(actions)
        two, *_, new = env.step(actions)
        for lane in np.flatnonzero(new.get("_final_obs", [])):
            np.testing.assert_array_equal(new["final_obs"][lane][:size], old["final_obs"][lane])
            np.testing.assert_allclose(new["final_obs"][lane][size:], before[lane], rtol=0, atol=1e-15)
            assert np.any(np.abs(np.subtract(before, told(env))) > 0.01)
    assert loads == {0.0, 10.0 / 15.0}


def test_a_lane_with_context_has_the_same_bits_alone_and_in_a_batch():
    agent, batch = AgentInterface(context=True), TwoLinkArmVectorEnv(5, **SHORT)
    network = actor(agent, batch.interface)
    policy = Agent(batch.interface, agent, network, batch)
    alone = [TwoLinkArmEnv(**SHORT) for _ in range(5)]
    policies = [Agent(env.interface, agent, network, env) for env in alone]
    seen = batch.reset(seed=3)[0]
    each = [env.reset(seed=3 + lane)[0] for lane, env in enumerate(alone)]
    for _ in range(25):
        actions, _ = policy.predict(seen)
        single = [one.predict(observation)[0] for one, observation in zip(policies, each, strict=True)]
        np.testing.assert_array_equal(actions, single)
        seen = batch.step(actions)[0]
        each = [env.step(action)[0] for env, action in zip(alone, single, strict=True)]


def test_an_agent_with_context_is_of_the_truth_tier(tmp_path):
    """It needs the environment, and by its folder too it is no honest policy; an honest one is given no environment."""
    env = TwoLinkArmVectorEnv(3, "everything-2")
    for context, access in ((False, "nominal"), (True, "privileged")):
        agent = AgentInterface(context=context)
        folder = tmp_path / str(context)
        write(folder, actor(agent, env.interface), {"interface": dataclasses.asdict(agent)})
        assert resolve(str(folder)).access == access
        made = resolve(str(folder)).make(env)
        assert made.env is (env if context else None)
        assert made.configuration.keys() == {"agent"}
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match="made for an environment of 3 lanes, whose truth it is told, got 1"):
        made.predict(observations[:1])
    for make in (
        lambda: saved_agent(env.interface, str(folder)),
        lambda: resolve(str(folder)).make(env.interface),
        lambda: SavedAgent(env.interface, str(folder)),
        lambda: Agent(env.interface, agent, actor(agent, env.interface)),
    ):
        with pytest.raises(ValueError, match="is told the truth, so it needs the environment, got its interface"):
            make()
    with pytest.raises(ValueError, match="context must be True or False, got 'no'"):
        AgentInterface(context="no")


@pytest.mark.parametrize("kind", ["normalized", "torque", "acceleration"])
def test_any_kind_of_action_gives_the_same_torque(kind):
    agent = AgentInterface(action="residual")
    env = TwoLinkArmEnv("mixed-error-2", action=kind)
    observation, _ = env.reset(seed=0)
    policy = Agent(env.interface, agent, actor(agent, env.interface))
    action, _ = policy.predict(observation)
    torque, _ = policy.torque(observation[None], policy.initial(observation[None]))
    position, velocity = observation[:2], observation[2:4]
    np.testing.assert_allclose(
        env.interface.torque_from_action(action, position, velocity), env.interface.saturate(torque[0]), rtol=1e-9
    )


def test_saved_agents_are_plain_data(tmp_path):
    interface, agent = TwoLinkArmEnv().interface, AgentInterface(action="residual", history=1)
    network = actor(agent, interface)
    write(tmp_path, network, {"interface": dataclasses.asdict(agent)})
    found, again = read(tmp_path)
    assert found == agent
    for (w, b), (w2, b2) in zip(network.layers, again.layers, strict=True):
        np.testing.assert_array_equal(w, w2)
        np.testing.assert_array_equal(b, b2)
    assert SavedAgent(interface, str(tmp_path)) == SavedAgent(interface, str(tmp_path))
    # Weights that would need code to load are refused.
    np.savez(tmp_path / "weights.npz", weight_0=np.array([print], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        SavedAgent(interface, str(tmp_path))


def test_what_is_wrong_is_named(tmp_path):
    interface = TwoLinkArmEnv().interface
    with pytest.raises(ValueError, match="folder must hold"):
        SavedAgent(interface, str(tmp_path))
    with pytest.raises(ValueError, match="unknown action 'torques'; did you mean 'torque'"):
        AgentInterface(action="torques")
    with pytest.raises(ValueError, match="SameStep"):
        VectorBody(TwoLinkArmVectorEnv(2), AgentInterface())


def test_a_strangers_zip_is_loaded_on_trust_only(tmp_path):
    from stable_baselines3 import PPO

    env = TwoLinkArmEnv()
    model = PPO("MlpPolicy", env, device="cpu")
    model.save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="runs the code in it"):
        load_zip(tmp_path / "model.zip", env.interface)
    policy = load_zip(tmp_path / "model.zip", env.interface, trust=True)
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(
        policy.predict(observation, deterministic=True)[0], model.predict(observation, deterministic=True)[0]
    )
    with pytest.raises(ValueError, match="observation_space must have the environment's shape"):
        load_zip(tmp_path / "model.zip", TwoLinkArmEnv(preview=1).interface, trust=True)


def saved(folder, env, algorithm="PPO", module="stable_baselines3", **settings):
    """A small model as it is before it learns anything, written by SB3."""
    policy = settings.pop("policy", "MlpPolicy")
    model = getattr(importlib.import_module(module), algorithm)(policy, env, device="cpu", seed=0, **settings)
    model.save(folder / "model.zip")
    return model, folder / "model.zip"


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (
            lambda: ErrorCoordinates(TwoLinkArmEnv()),
            "observation_space .* -25.1327 to 25.1327, .* got -10 to 10: train it",
        ),
        (lambda: TwoLinkArmEnv(action="torque"), 'got -2000 to 2000, -800 to 800: train it with action="normalized"'),
        (lambda: TwoLinkArmEnv(action="acceleration"), 'got -100 to 100: train it with action="normalized"'),
    ],
)
def test_a_zip_of_other_observations_or_actions_is_refused(env, message, tmp_path):
    """Their shapes are the environment's, their meaning is not."""
    _, path = saved(tmp_path, env())
    with pytest.raises(ValueError, match=message):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
def test_a_zip_of_single_precision_or_monitored_by_sb3_acts_as_it_was_saved(tmp_path):
    from stable_baselines3.common.monitor import Monitor

    plain = gymnasium.make("fbl_gym/TwoLinkArm-v0")
    observation, _ = plain.reset(seed=0)
    for env in (Monitor(plain), gymnasium.wrappers.DtypeObservation(plain, np.float32)):
        model, path = saved(tmp_path, env)
        np.testing.assert_array_equal(
            load_zip(path, plain.unwrapped.interface, trust=True).predict(observation, deterministic=True)[0],
            model.predict(observation, deterministic=True)[0],
        )


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        ("A2C", {}),
        ("SAC", {"buffer_size": 10}),
        ("TD3", {"buffer_size": 10}),
        ("DDPG", {"buffer_size": 10}),
        ("TQC", {"module": "sb3_contrib", "buffer_size": 10}),
        ("CrossQ", {"module": "sb3_contrib", "buffer_size": 10}),
        ("TRPO", {"module": "sb3_contrib"}),
        ("ARS", {"module": "sb3_contrib"}),
        ("RecurrentPPO", {"module": "sb3_contrib", "policy": "MlpLstmPolicy"}),
    ],
)
def test_a_zip_of_any_algorithm_acts_as_it_was_saved(algorithm, settings, tmp_path):
    if settings.get("module"):
        pytest.importorskip("sb3_contrib")
    env = TwoLinkArmEnv()
    model, path = saved(tmp_path, env, algorithm, **settings)
    external.trust(str(path))
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(
        resolve(str(path)).make(env).predict(observation, deterministic=True)[0],
        model.predict(observation, deterministic=True)[0],
    )


def test_a_zip_of_an_unknown_algorithm_is_named(tmp_path):
    path = tmp_path / "model.zip"
    for data, message in (
        ({"policy_class": {"__module__": "sbx.sac.policies"}}, "A2C, .* got one whose network is of sbx.sac.policies"),
        ({}, "must be an archive that stable-baselines3's save wrote"),
    ):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("data", json.dumps(data))
        with pytest.raises(ValueError, match=message):
            load_zip(path, TwoLinkArmEnv().interface, trust=True)
    path.write_bytes(b"PK")
    with pytest.raises(ValueError, match="must be an archive that stable-baselines3's save wrote"):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)


def test_a_lane_has_the_same_bits_alone_and_in_a_batch():
    network = actor(AgentInterface(), TwoLinkArmEnv().interface)
    seen = np.random.default_rng(1).normal(0, 3, (37, 12))
    np.testing.assert_array_equal(network(seen), np.concatenate([network(row[None]) for row in seen]))
