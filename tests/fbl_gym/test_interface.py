"""`Interface`: a policy knows what a datasheet states, perhaps falsely, of drive, sensors and springs, and no draw or error."""

import dataclasses
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.controllers.closed_loop import mean_error

CASES = tomllib.loads(Path(__file__).with_name("interface.toml").read_text(encoding="utf-8"))
IDEAL = TwoLinkArmEnv().interface
FIELDS = ("delay", "lag", "rate_limit", "latency", "resolution", "noise_std")
SPRINGS = ("stiffness", "damping", "rotor_inertia", "backlash", "encoder")


@pytest.mark.parametrize(("options", "stated"), CASES["stated"], ids=str)
def test_the_interface_states_drive_and_sensors(options, stated):
    interface = TwoLinkArmEnv(**options).interface
    for name in FIELDS:
        given, expected = getattr(interface, name), stated.get(name, getattr(IDEAL, name))
        np.testing.assert_allclose(np.array(given, float), np.array(expected, float), err_msg=name)
    assert hash(interface) == hash(dataclasses.replace(interface))


@pytest.mark.parametrize("options", CASES["hidden"], ids=str)
def test_the_interface_hides_the_errors_of_the_real_arm(options):
    assert TwoLinkArmEnv(**options).interface == IDEAL


def test_the_interface_states_the_springs():
    joint = {"stiffness": [{"uniform": [3e3, 5e3]}, 2e3], "damping": 5.0, "backlash": {"uniform": [0, 1e-3]}}
    interface = TwoLinkArmEnv(joint={**joint, "rotor_inertia": (0.5, 0.2), "encoder": "link"}).interface
    stated = (((3e3, 2e3), (5e3, 2e3)), ((5.0, 5.0), (5.0, 5.0)), (0.5, 0.2), (1e-3, 1e-3), "link")
    assert tuple(getattr(interface, name) for name in SPRINGS) == stated
    assert IDEAL.stiffness is None


TRUTH = {
    "actuator": {"delay": 0.02, "lag": {"uniform": [0.002, 0.004]}, "torque_limit": (2000, 800)},
    "joint": {"stiffness": {"uniform": [3e3, 5e3]}, "rotor_inertia": 0.5},
    "noise": {"position": 1e-3, "velocity": 1e-2},
}
TOLD = {
    "delay": (0.01, {"delay": (0.01, 0.01)}), "lag": (0.001, {"lag": (0.001, 0.001)}),
    "rate_limit": (100.0, {"rate_limit": (100.0, 100.0)}), "latency": (0.003, {"latency": 0.003}),
    "velocity_noise": (0.5, {"noise_std": ((1e-3, 1e-3), (0.5, 0.5), (0.0, 0.0))}),
    "stiffness": ((1e3, 2e3), {"stiffness": ((1e3, 2e3), (1e3, 2e3))}),
    "damping": (3.0, {"damping": ((3.0, 3.0), (3.0, 3.0))}), "rotor_inertia": (0.7, {"rotor_inertia": (0.7, 0.7)}),
    "backlash": (0.01, {"backlash": (0.01, 0.01)}),
}  # fmt: skip


def motion(told):
    """Return the observations, truths and interface of an episode under fixed torques."""
    env = TwoLinkArmVectorEnv(3, **TRUTH, datasheet=told)
    rows = [env.reset(seed=5)[0], *(env.step(np.full((3, 2), 0.3 * math.sin(k)))[0] for k in range(40))]
    return np.array(rows), env.truth, env.interface


@pytest.mark.parametrize("name", TOLD)
def test_a_datasheet_changes_the_interface_and_no_bit_of_the_arm(name):
    value, stated = TOLD[name]
    rows, truth, interface = motion(None)
    rows_told, truth_told, told = motion({name: value})
    assert told == dataclasses.replace(interface, **stated) != interface
    np.testing.assert_array_equal(rows_told, rows)
    np.testing.assert_equal(vars(truth_told), vars(truth))


def test_a_predictor_trusts_the_datasheet_and_an_oracle_does_not():
    late, policy = {"actuator": {"delay": 0.02}, "steps": 200, "skip": 0, "lanes": 1}, "computed-torque+predictor"
    assert mean_error(policy, datasheet={"delay": 0.01}, **late) > 1.5 * mean_error(policy, **late)
    assert mean_error("oracle-flm", datasheet={"delay": 0.0}, **late) == mean_error("oracle-flm", **late)
