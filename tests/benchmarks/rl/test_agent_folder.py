"""The folder of a trained agent."""

import dataclasses

import numpy as np
import pytest

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.agent import files, read, saved_agent, write
from fbl_gym import TwoLinkArmEnv
from tests.benchmarks.rl.agents import random_actor


def write_agent(folder, interface, **changes):
    settings = AdapterSettings(**changes)
    actor = random_actor(settings, interface)
    write(folder, actor, {"interface": dataclasses.asdict(settings)})
    return settings, actor


def test_a_folder_returns_the_agent_that_was_written(tmp_path):
    interface = TwoLinkArmEnv().interface
    settings, actor = write_agent(tmp_path, interface, action="residual", history=1)
    read_settings, read_actor = read(tmp_path)
    assert read_settings == settings
    for layer, read_layer in zip(actor.layers, read_actor.layers, strict=True):
        for values, read_values in zip(layer, read_layer, strict=True):
            np.testing.assert_array_equal(values, read_values)


def test_weights_that_need_code_to_load_are_refused(tmp_path):
    interface = TwoLinkArmEnv().interface
    write_agent(tmp_path, interface)
    np.savez(files(tmp_path)[1], weight_0=np.array([print], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        saved_agent(interface, str(tmp_path))


def test_a_folder_without_an_agent_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"folder must hold an agent.json"):
        saved_agent(TwoLinkArmEnv().interface, str(tmp_path))


@pytest.mark.parametrize(
    "damage",
    ["", "[]", "3", "{", "{}", '{"interface": 3}', '{"interface": {}, "weights": 3}', '{"interface": {"action": 1}}',
     r'{"interface": {}, "weights": "\u0000"}',
     '{"interface": {"x": 1}, "network": {"layers": 0}}', '{"interface": {}, "network": {"layers": "x"}}'],
)  # fmt: skip
def test_a_malformed_folder_is_an_error_that_names_the_file(damage, tmp_path):
    write_agent(tmp_path, TwoLinkArmEnv().interface)
    (tmp_path / "agent.json").write_text(damage)
    with pytest.raises(ValueError, match=r"must be as `fbl-gym train` wrote it"):
        saved_agent(TwoLinkArmEnv().interface, str(tmp_path))


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\x03\x04" + 40 * b"x"])
def test_damaged_weights_are_an_error_that_names_the_file(content, tmp_path):
    write_agent(tmp_path, TwoLinkArmEnv().interface)
    files(tmp_path)[1].write_bytes(content)
    with pytest.raises(ValueError, match=r"weights.npz must be as `fbl-gym train` wrote it"):
        saved_agent(TwoLinkArmEnv().interface, str(tmp_path))
