"""The named scenarios: names, families, the paper's figures."""

import numpy as np
import pytest

from fbl_gym import ParameterError, Scenario, TwoLinkArmEnv, scenarios
from tests.fbl_gym.episodes import started, started_batch


@pytest.mark.parametrize("name", scenarios.names())
def test_every_named_scenario_runs_single_and_batched(name):
    scenario = scenarios.get(name)
    assert scenario.name == name
    assert scenario.description
    action = "torque" if scenario.actuator.torque_limit is None else "normalized"
    env = TwoLinkArmEnv(scenario, action=action)
    batch = started_batch(3, name, action=action, seed=5)
    observation, _ = env.reset(seed=7)
    for _ in range(3):
        assert observation in env.observation_space
        observation = env.step((0.0, 0.0))[0]
        np.testing.assert_array_equal(batch.step(np.zeros((3, 2)))[0][2], observation)


def test_a_scenarios_family_severity_and_tier():
    members = map(scenarios.member, ("mass-error-2@mujoco", "nominal", "servo-noise-1"))
    assert [*members] == [("mass-error", 2, "ideal"), ("nominal", 0, "ideal"), ("noise", 1, "servo")]
    assert not any(map(scenarios.member, ("paper-8", "heavy-3", "noise", "noise-2~3f9a20")))


def test_the_papers_scenarios_have_the_papers_arms():
    assert scenarios.get("paper-3b").parameter_error.ratio == (2.0,) * 4
    for name, arm in (("paper-3b", [0.7, 0.5, 20.0, 15.0]), ("paper-6a", [200.0, 150.0, 7.0, 5.0])):
        truth = started(name, action="torque").truth
        np.testing.assert_allclose([*truth.masses, *truth.lengths], arm)


def test_each_family_changes_only_its_option():
    changes = {name: {"parameter_error"} for name in ("mass-error", "length-error", "mixed-error", "payload")}
    changes |= {"noise": {"noise"}, "stiction": {"friction"}, "disturbance": {"disturbance"}}
    changes["everything"] = set().union(*changes.values())
    nominal, parameters = vars(Scenario()), {"mass": ("m1", "m2"), "length": ("L1", "L2")}
    assert vars(scenarios.get("nominal")) == nominal
    for name, options in changes.items():
        levels = [vars(scenarios.get(f"{name}-{severity}")) for severity in scenarios.SEVERITIES]
        assert len({str([level[option] for option in sorted(options)]) for level in levels}) == 4
        for severity, level in enumerate(levels):
            changed = {field for field, value in level.items() if value != nominal[field]}
            assert changed - {"name", "description"} == (options if severity else set())
            if severity and (kind := name.removesuffix("-error")) in parameters:
                error = ParameterError(radius=2.0 ** (severity - 3), parameters=parameters[kind])
                assert level["parameter_error"] == error


def test_a_scenario_by_name_record_or_dict_is_the_same():
    scenario = scenarios.get("everything-2")
    built = [TwoLinkArmEnv(x).scenario for x in ("everything-2", scenario, scenario.to_dict())]
    assert built[0] == built[1] == built[2] == scenario
    assert TwoLinkArmEnv(None).scenario == TwoLinkArmEnv().scenario == scenarios.get("nominal")
    assert Scenario.from_dict({}) == Scenario()


def test_options_replace_a_scenarios_fields_and_keep_the_rest():
    scenario = TwoLinkArmEnv("everything-2", friction={"viscous": 1.0}, control_dt=0.02).scenario
    assert scenario.friction.viscous == (1.0, 1.0)
    assert scenario == scenarios.get("everything-2").replace(friction={"viscous": 1.0}, control_dt=0.02)
    assert scenario.noise == scenarios.get("everything-2").noise


def test_the_papers_scenarios_run_at_the_papers_rates():
    tasks = {name: scenarios.get(name) for name in scenarios.names() if name.startswith("paper-")}
    assert tasks.pop("paper-6b").control_dt == 1e-4
    assert {(task.control_dt, task.physics_dt) for task in tasks.values()} == {(1e-3, 1e-3)}
    assert {name for name, task in tasks.items() if "roject's choice" not in task.description} <= {"paper-3b"}
