"""Agents with context observe the true parameters; their access is privileged."""

import dataclasses

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.analysis.board import assemble
from benchmarks.policies.spec import resolve
from benchmarks.rl.adapter import CONTEXT, AdapterSettings
from benchmarks.rl.agent import Agent, saved_agent, write
from benchmarks.rl.policy import SHIPPED
from benchmarks.rl.vec_env import VectorAdapter
from benchmarks.run.cell import run_cell
from benchmarks.run.suite import Cell
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.benchmarks.rl.agents import PAYLOAD_OPTIONS, random_actor


def expected_context(env):
    """Return the context by its definition."""
    truth, nominal = env.unwrapped.truth, env.unwrapped.interface.nominal
    ratios = [
        truth.masses[:, 0] / nominal.m1,
        truth.masses[:, 1] / nominal.m2,
        truth.lengths[:, 0] / nominal.L1,
        truth.lengths[:, 1] / nominal.L2,
    ]
    return np.stack([*np.log(ratios), truth.payload / nominal.m2], axis=-1)


def test_the_context_follows_the_observation_of_other_agents():
    """It is the truth now; in an episode's last observation, that of the finished episode."""
    plain, env = (
        VectorAdapter(
            TwoLinkArmVectorEnv(3, **PAYLOAD_OPTIONS, autoreset_mode="SameStep"),
            AdapterSettings(history=2, context=context),
        )
        for context in (False, True)
    )
    size = plain.single_observation_space.shape[0]
    assert env.single_observation_space.shape == (size + len(CONTEXT),)
    rng, payloads = np.random.default_rng(0), set()
    plain_observation, observation = plain.reset(seed=4)[0], env.reset(seed=4)[0]
    for _ in range(45):
        context = expected_context(env)
        np.testing.assert_array_equal(observation[:, :size], plain_observation)
        np.testing.assert_allclose(observation[:, size:], context, rtol=0, atol=1e-15)
        payloads.add(float(observation[0, -1]))
        actions = rng.uniform(-1, 1, (3, 2))
        plain_observation, *_, plain_infos = plain.step(actions)
        observation, *_, infos = env.step(actions)
        for lane in np.flatnonzero(infos.get("_final_obs", [])):
            np.testing.assert_array_equal(infos["final_obs"][lane][:size], plain_infos["final_obs"][lane])
            np.testing.assert_allclose(infos["final_obs"][lane][size:], context[lane], rtol=0, atol=1e-15)
            assert np.any(np.abs(context - expected_context(env)) > 0.01)
    assert payloads == {0.0, 10.0 / 15.0}


def test_a_lane_has_the_same_bits_alone_and_in_a_batch():
    settings, batch = AdapterSettings(context=True), TwoLinkArmVectorEnv(5, **PAYLOAD_OPTIONS)
    actor = random_actor(settings, batch.interface)
    agent = Agent(batch.interface, settings, actor, batch)
    envs = [TwoLinkArmEnv(**PAYLOAD_OPTIONS) for _ in range(5)]
    agents = [Agent(env.interface, settings, actor, env) for env in envs]
    observation = batch.reset(seed=3)[0]
    observations = [env.reset(seed=3 + lane)[0] for lane, env in enumerate(envs)]
    for _ in range(25):
        batch_actions, _ = agent.predict(observation)
        actions = [one.predict(single)[0] for one, single in zip(agents, observations, strict=True)]
        np.testing.assert_array_equal(batch_actions, actions)
        observation = batch.step(batch_actions)[0]
        observations = [env.step(action)[0] for env, action in zip(envs, actions, strict=True)]


@pytest.mark.parametrize(("context", "access"), [(False, "nominal"), (True, "privileged")])
def test_only_an_agent_with_context_is_privileged_and_gets_the_environment(context, access, tmp_path):
    env = TwoLinkArmVectorEnv(3, "everything-2")
    settings = AdapterSettings(context=context)
    write(tmp_path, random_actor(settings, env.interface), {"interface": dataclasses.asdict(settings)})
    assert resolve(str(tmp_path)).access == access
    agent = resolve(str(tmp_path)).make(env)
    assert agent.env is (env if context else None)


def test_an_agent_with_context_needs_the_environment(tmp_path):
    env = TwoLinkArmVectorEnv(3, "everything-2")
    settings = AdapterSettings(context=True)
    actor = random_actor(settings, env.interface)
    write(tmp_path, actor, {"interface": dataclasses.asdict(settings)})
    for make in (
        lambda: saved_agent(env.interface, str(tmp_path)),
        lambda: resolve(str(tmp_path)).make(env.interface),
        lambda: Agent(env.interface, settings, actor),
    ):
        with pytest.raises(ValueError, match="so it needs the environment, got its interface"):
            make()
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match="made for 3 lanes, got 1 observations"):
        resolve(str(tmp_path)).make(env).predict(observations[:1])


AGENTS = ("ppo-context@0", str(SHIPPED / "ppo-context" / "0"))


def test_the_board_does_not_rank_an_agent_with_context():
    cells = [Cell(policy, "everything-2", (0, 1)) for policy in ("cascade-flm", "oracle-flm", *AGENTS)]
    board = assemble([run_cell(cell) for cell in cells])
    assert [board.policies[i] for i in board.ranked] == ["cascade-flm"]
    assert board.order[0] == 0


def test_commands_take_an_agent_with_context(tmp_path, capsys):
    """By its folder."""
    name = AGENTS[1]
    assert resolve(name).access == "privileged"
    assert resolve(name).kind == "learned"
    assert cli.main(["check-policy", name]) == 0
    assert "no: it knows the truth" in capsys.readouterr().out
    assert cli.main(["evaluate", name, "--seeds", "1"]) == 0
    arguments = ["--policies", "oracle-flm", name, "--scenarios", "everything-2", "--seeds", "2", "--workers", "1"]
    assert cli.main(["leaderboard", *arguments, "--store", str(tmp_path)]) == 0
    capsys.readouterr()
    assert cli.main(["verify", f"{name}/everything-2", "--store", str(tmp_path)]) == 0
    assert "holds, bit for bit" in capsys.readouterr().out
