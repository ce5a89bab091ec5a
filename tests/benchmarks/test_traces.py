"""`fbl-gym evaluate --trace`: what the arm does, what the policy reads and commands, and its state."""

import csv

import numpy as np
import pytest

import controllers
from benchmarks import cli
from fbl_gym import TwoLinkArmVectorEnv, scenarios

TASK = "servo-elastic-2"


@pytest.fixture(scope="module")
def trace(tmp_path_factory):
    """Return the signals of two seeds of a law with an integral and an observer."""
    folder = tmp_path_factory.mktemp("trace")
    (folder / "short.toml").write_text(f'base = "{TASK}"\nduration = 0.4\n')
    for name in ("trace.npz", "trace.csv"):
        line = ["evaluate", "cascade-flm+eso", "--scenario", str(folder / "short.toml"), "--seeds", "2"]
        assert cli.main([*line, "--store", str(folder), "--trace", str(folder / name)]) == 0
    with (folder / "trace.csv").open() as file:
        return dict(np.load(folder / "trace.npz")), list(csv.DictReader(file))


def test_signals_are_those_of_the_environment_and_the_policy(trace):
    signals, _ = trace
    env = TwoLinkArmVectorEnv(2, scenarios.get(TASK).replace(duration=0.4))
    policy, state, action = controllers.make("cascade-flm+eso", env), None, np.zeros((2, 2))
    observation, _ = env.reset(seed=[0, 1])
    for k in range(41):
        truth = env.truth
        for sensor, unit in (("position", "rad"), ("velocity", "rad_s")):
            np.testing.assert_array_equal(signals[f"measured_{sensor}_{unit}"][k], observation[:, env.layout[sensor]])
            np.testing.assert_array_equal(signals[f"motor_{sensor}_{unit}"][k], getattr(truth, f"motor_{sensor}"))
        np.testing.assert_array_equal(signals["torque_Nm"][k], truth.applied_torque)
        if state is not None:
            np.testing.assert_array_equal(signals["state_memory"][k], state.memory)
            np.testing.assert_array_equal(signals["state_inside_integral"][k], state.inside.integral)
            np.testing.assert_allclose(signals["command_Nm"][k], action * env.interface.torque_limit)
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    assert np.isnan(signals["state_memory"][0]).all()
    assert (np.abs(signals["motor_position_rad"] - signals["position_rad"]) > 1e-4).any()


def test_a_table_has_the_numbers_of_the_arrays(trace):
    signals, rows = trace
    assert len(rows) == 2 * 41
    row = rows[41 + 7]  # of the second seed
    for column, number in {
        "command_2_Nm": signals["command_Nm"][7, 1, 1],
        "measured_velocity_1_rad_s": signals["measured_velocity_rad_s"][7, 1, 0],
        "state_memory_2_4": signals["state_memory"][7, 1, 1, 3],
        "payload_kg": signals["payload_kg"][7, 1],
    }.items():
        assert float(row[column]) == pytest.approx(number), column
    assert rows[0]["state_memory_1_1"] == ""
