"""`fbl-gym evaluate --trace`: what the arm does, what the policy reads and commands, and its state."""

import csv

import numpy as np
import pytest

import controllers
from benchmarks import cli
from benchmarks.run.rollout import rollout_trials
from benchmarks.run.traces import table
from fbl_gym import TwoLinkArmVectorEnv, scenarios

LAW, TASK = "cascade-flm+eso", "servo-elastic-2"


@pytest.fixture(scope="module")
def signals():
    """Return the signals of two seeds of a law with an integral and an observer, [seed, sample] each."""
    (trace,) = rollout_trials(LAW, scenarios.get(TASK).replace(duration=0.4), (0, 1), 1, detailed=True)
    return {name: column.reshape(2, 41) for name, column in table(trace).items()}


def test_signals_are_those_of_the_environment_and_the_policy(signals):
    def both(name, k):
        return np.stack([signals[name.format(joint)][:, k] for joint in (1, 2)], axis=1)

    env = TwoLinkArmVectorEnv(2, scenarios.get(TASK).replace(duration=0.4))
    policy, state, action = controllers.make(LAW, env), None, np.zeros((2, 2))
    observation, _ = env.reset(seed=[0, 1])
    for k in range(41):
        truth = env.truth
        for sensor, unit in (("position", "rad"), ("velocity", "rad_s")):
            measured = both(f"measured_{sensor}_{{}}_{unit}", k)
            np.testing.assert_array_equal(measured, observation[:, env.layout[sensor]])
            np.testing.assert_array_equal(both(f"motor_{sensor}_{{}}_{unit}", k), getattr(truth, f"motor_{sensor}"))
        np.testing.assert_array_equal(both("torque_{}_Nm", k), truth.applied_torque)
        if state is not None:
            for i in range(4):
                np.testing.assert_array_equal(both(f"state_memory_{{}}_{i + 1}", k), state.memory[..., i])
            np.testing.assert_array_equal(both("state_inside_integral_{}", k), state.inside.integral)
            np.testing.assert_allclose(both("command_{}_Nm", k), action * env.interface.torque_limit)
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    assert np.isnan(both("state_memory_{}_1", 0)).all()
    assert (np.abs(both("motor_position_{}_rad", 20) - both("position_{}_rad", 20)) > 1e-4).any()


def test_a_file_has_the_numbers_of_the_table(signals, tmp_path):
    (tmp_path / "short.toml").write_text(f'base = "{TASK}"\nduration = 0.4\n')
    line = ["evaluate", LAW, "--scenario", str(tmp_path / "short.toml"), "--seeds", "2"]
    assert cli.main([*line, "--trace", str(tmp_path / "trace.csv")]) == 0
    with (tmp_path / "trace.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 41
    assert list(rows[0]) == list(signals)
    for name, numbers in signals.items():
        written = np.array([float(row[name]) for row in rows])
        np.testing.assert_allclose(written, numbers.ravel(), rtol=1e-9, err_msg=name)
