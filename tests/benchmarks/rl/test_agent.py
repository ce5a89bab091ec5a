"""The folder of a trained agent, its compiled network, and the shipped agents, which match their descriptions."""

import dataclasses
import hashlib
import io
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from benchmarks.agents import policy
from benchmarks.agents.adapter import AdapterSettings
from benchmarks.agents.agent import describe, read, write
from benchmarks.agents.network import Actor
from benchmarks.agents.policy import SHIPPED, best_seed, folders, shipped
from benchmarks.training.validation import validate
from fbl_gym import Scenario, TwoLinkArmEnv, scenarios
from tests.benchmarks.rl.agents import random_actor


def write_agent(folder, interface, **changes):
    settings = AdapterSettings(**changes)
    actor = random_actor(settings, interface)
    write(folder, actor, {"interface": dataclasses.asdict(settings)})
    return settings, actor


def test_a_folder_returns_the_agent_that_was_written(tmp_path):
    settings, actor = write_agent(tmp_path, TwoLinkArmEnv().interface, action="residual", history=1)
    read_settings, read_actor = read(tmp_path)
    assert read_settings == settings
    np.testing.assert_equal(read_actor.layers, actor.layers)


np.savez(NEEDS_CODE := io.BytesIO(), weight_0=np.array([print], dtype=object))


DAMAGED = {
    "agent.json": [
        b"", b"[]", b"3", b"{", b"{}", b'{"interface": 3}', b'{"interface": {}, "weights": 3}',
        b'{"interface": {"action": 1}}', rb'{"interface": {}, "weights": "\u0000"}',
        b'{"interface": {}, "network": {"layers": 0}}',
        b'{"interface": {}, "network": {"layers": -1}}', b'{"interface": {}, "network": {"layers": "x"}}',
    ],
    "weights.npz": [b"", b"PK", b"PK\x03\x04" + 40 * b"x", NEEDS_CODE.getvalue()],  # the last runs code
}  # fmt: skip


@pytest.mark.parametrize(("name", "content"), [(name, content) for name in DAMAGED for content in DAMAGED[name]])
def test_a_damaged_file_of_an_agent_is_an_error(name, content, tmp_path):
    write_agent(tmp_path, TwoLinkArmEnv().interface)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=f"{name} must be as `fbl-gym train` wrote it"):
        read(tmp_path)


FUNCTIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0), "clip": lambda x: np.clip(x, -1.0, 1.0)}


def exact(shape, scale):
    """Return numbers without a pattern that are equal on every machine."""
    return scale * ((np.arange(np.prod(shape)) * 7919 % 10007) / 10007 - 0.5).reshape(shape)


def network(activation="tanh", output="tanh", sizes=(13, 20, 9, 2)):
    return Actor(tuple((exact((o, i), 1.0), exact(o, 0.3)) for i, o in pairwise(sizes)), activation, output)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["tanh", "clip"])
@pytest.mark.parametrize("sizes", [(13, 20, 9, 2), (4, 2), (1, 3, 2)])
def test_the_network_equals_its_formula(activation, output, sizes):
    actor = network(activation, output, sizes)
    x = observations = np.random.default_rng(0).normal(0, 2, (50, sizes[0]))
    for i, (weight, bias) in enumerate(actor.layers):
        x = FUNCTIONS[output if i == len(actor.layers) - 1 else activation](x @ weight.T + bias)
    np.testing.assert_allclose(actor(observations), x, rtol=0, atol=1e-14)


def test_tanh_is_accurate_and_bounded():
    x = np.concatenate([np.linspace(-25, 25, 99_999), [0.0, 1e-9, -1e300, 1e300]])
    y = Actor(((np.ones((1, 1)), np.zeros(1)),), "tanh", "tanh")(x[:, None])[:, 0]
    np.testing.assert_allclose(y, np.tanh(x), rtol=0, atol=4e-16)


def test_the_bits_are_the_same_on_every_machine():
    """The hash is that of any machine, also of one without fused multiply-adds (`NUMBA_CPU_NAME=generic`)."""
    bits = hashlib.sha256(network()(exact((64, 13), 4.0)).tobytes()).hexdigest()
    assert bits[:16] == "ac0eac93101ff4e6"


def test_a_lane_has_the_same_bits_alone_and_in_a_batch():
    actor = random_actor(AdapterSettings(), TwoLinkArmEnv().interface)
    observations = np.random.default_rng(1).normal(0, 3, (37, 12))
    np.testing.assert_array_equal(actor(observations), np.concatenate([actor(row[None]) for row in observations]))
    np.testing.assert_array_equal(actor(np.asfortranarray(observations)), actor(observations))


@pytest.mark.parametrize(("make", "message"), [
    (lambda: network()(np.zeros((1, 12))), "observation must have 13 entries for this network, got 12"),
    (lambda: Actor((), "tan", "clip"), "unknown activation 'tan'; did you mean 'tanh'"),
    (lambda: Actor((), "tanh", "clipped"), "unknown output 'clipped'; did you mean 'clip'"),
    (lambda: policy.td3(TwoLinkArmEnv().interface, seed=9), "unknown training seed 9"),
])  # fmt: skip
def test_a_wrong_argument_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_every_shipped_agent_has_a_factory_and_three_training_seeds_or_more_in_10_megabytes():
    factories = [name for name, value in vars(policy).items() if getattr(value, "kind", "") == "learned"]
    assert sorted(shipped()) == sorted(name.replace("_", "-") for name in factories)
    assert min(map(len, shipped().values())) >= 3
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*")) < 10e6


SLOW = ("direct", "geared", "ppo-blend")  # at 500 Hz and 1 kHz, a validation takes minutes
PLACES = [folder for name in shipped() for folder in folders(name, best_seed(name))]


@pytest.mark.parametrize("place", [pytest.param(x, marks=[pytest.mark.slow] * (x.parent.name in SLOW)) for x in PLACES])
def test_an_agent_has_the_validation_error_of_its_description(place):
    given = describe(place)
    each = tuple(map(scenarios.get, given.get("scenarios", ()))) or (Scenario.from_dict(given["scenario"]),)
    assert validate(*read(place), each) == pytest.approx(given["validation_mrad"], rel=0.02)
    assert (given["command"][:13], given["licence"]) == ("fbl-gym train", "MIT")
    assert {"steps", "wall_s", "packages", "hyperparameters", "seed"} <= set(given)


def test_an_agent_of_classes_is_that_of_the_robots_class():
    for folder in folders("ppo", best_seed("ppo")):
        settings = policy.ppo(TwoLinkArmEnv(f"{folder.parent.name}-nominal").interface).settings
        assert settings == read(folder)[0]


def test_an_agent_of_other_classes_is_not_applicable(tmp_path, monkeypatch):
    shutil.copytree(SHIPPED / "ppo" / "servo", tmp_path / "ppo" / "servo")
    monkeypatch.setattr(policy, "SHIPPED", tmp_path)
    with pytest.raises(ValueError, match="not applicable: ppo was trained for servo, got a robot like geared"):
        policy._factory("ppo", "")(TwoLinkArmEnv("geared-nominal").interface)


@pytest.mark.parametrize("name", shipped())
def test_the_model_card_of_an_agent_has_the_numbers_of_its_description(name):
    page = (Path(__file__).parents[3] / "docs" / "reference" / "agents.md").read_text(encoding="utf-8")
    card = page.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    assert getattr(policy, name.replace("-", "_")).__doc__ in card
    for robot in {place.parent.name for seed in shipped()[name] for place in folders(name, seed)}:
        places = {seed: next(x for x in folders(name, seed) if x.parent.name == robot) for seed in shipped()[name]}
        agents = {seed: describe(place) for seed, place in places.items()}
        for seed, agent in agents.items():
            rows = (places[seed] / "curve.csv").read_text(encoding="utf-8").splitlines()[1:]
            assert min(rows, key=lambda row: float(row.split(",")[-1])).split(",")[0] == str(agent["steps"])
        best = agents[best_seed(name)]
        steps = "; ".join(f"{agent['steps']:,}" for agent in agents.values())
        errors = ", ".join(f"{agent['validation_mrad']:.3g}" for agent in agents.values())
        assert all(text in card for text in (steps, errors, best["command"], best["machine"])), robot
