"""The named scenarios: names, families, the paper's figures."""

import dataclasses
import itertools

import numpy as np
import pytest

from fbl_gym import ParameterError, Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
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


def test_severities_grow_from_the_nominal_arm():
    for name in set(scenarios.families()) - {"nominal"}:
        nominal, none = scenarios.get("nominal"), scenarios.get(f"{name}-0")
        assert dataclasses.replace(none, name=nominal.name, description=nominal.description) == nominal
        levels = [scenarios.get(f"{name}-{severity}") for severity in scenarios.SEVERITIES]
        assert len({dataclasses.replace(level, name="", description="") for level in levels}) == 4
    assert scenarios.get("nominal") == Scenario()


def test_a_scenarios_family_severity_and_tier():
    assert scenarios.member("mass-error-2@mujoco") == ("mass-error", 2, "ideal")
    assert scenarios.member("nominal") == ("nominal", 0, "ideal")
    assert scenarios.member("servo-noise-1") == ("noise", 1, "servo")
    for other in ("paper-8", "heavy-3", "noise", "noise-2~3f9a20"):
        assert scenarios.member(other) is None


def test_the_papers_scenarios_have_the_papers_arms():
    assert scenarios.get("paper-3b").parameter_error.ratio == (2.0,) * 4
    for name, arm in (("paper-3b", [0.7, 0.5, 20.0, 15.0]), ("paper-6a", [200.0, 150.0, 7.0, 5.0])):
        truth = started(name, action="torque").truth
        np.testing.assert_allclose([*truth.masses, *truth.lengths], arm)


def test_the_names_are_figures_real_arms_and_the_families():
    figures = {f"paper-{name}" for name in ("3a", "3b", "4a", "4b", "6a", "6b", "8", "10")}
    errors = {f"{kind}-error" for kind in ("mass", "length", "mixed", "uniform", "larger", "smaller")}
    families = errors | {"payload", "noise", "stiction", "disturbance", "everything"}
    members = {"nominal"} | {f"{family}-{severity}" for family in families for severity in range(4)}
    arms = {"dfki-c1", "dfki-c1-acrobot", "dfki-c1-pendubot", "dfki-a0", "cicese"}
    tiers = {name for tier in scenarios.TIERS if tier != "ideal" for name in scenarios.in_tier(tier)}
    assert set(scenarios.in_tier("ideal", scenarios.SEVERITIES)) | {n for n in members if n[-2:] == "-0"} == members
    assert set(scenarios.names()) == figures | arms | members | tiers
    assert len(scenarios.names()) == len(set(scenarios.names()))
    assert set(scenarios.families()) == {"nominal", *families}


def test_each_family_changes_only_its_option():
    changes = {f"{kind}-error": {"parameter_error"} for kind in ("mass", "length", "mixed")} | {
        "payload": {"parameter_error"},
        "noise": {"noise"},
        "stiction": {"friction"},
        "disturbance": {"disturbance"},
        "everything": {"parameter_error", "noise", "friction", "disturbance"},
    }
    nominal = vars(Scenario())
    for name, options in changes.items():
        for severity in (1, 2, 3):
            scenario = vars(scenarios.get(f"{name}-{severity}"))
            changed = {field for field, value in scenario.items() if value != nominal[field]}
            assert changed - {"name", "description"} == options


def test_parameter_families_have_their_radius():
    parameters = {"mass": ("m1", "m2"), "length": ("L1", "L2"), "mixed": ("m1", "m2", "L1", "L2")}
    for name, severity in itertools.product(parameters, (1, 2, 3)):
        error = ParameterError(radius=(0.25, 0.5, 1.0)[severity - 1], parameters=parameters[name])
        assert scenarios.get(f"{name}-error-{severity}").parameter_error == error


def test_an_unknown_field_of_a_scenario_is_named():
    with pytest.raises(ValueError, match="unknown option 'rate'"):
        scenarios.get("everything-3").replace(rate=3)
    with pytest.raises(ValueError, match="unknown field of scenario 'nme'; did you mean 'name'"):
        Scenario.from_dict({"nme": "x"})


def test_the_payload_family_carries_up_to_the_second_links_mass_from_3_to_7_s():
    for severity, share in ((1, 1 / 3), (2, 2 / 3), (3, 1.0)):
        load = scenarios.get(f"payload-{severity}").parameter_error.payload
        assert (load.mass, load.pick_up, load.drop) == (pytest.approx(15.0 * share), 3.0, 7.0)


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


NEAR = {"paper3a": "paper-3a", "everthing-3": "everything-3", "servo-nominl": "servo-nominal"}


@pytest.mark.parametrize(("name", "near"), NEAR.items())
def test_the_nearest_scenario_is_suggested(name, near):
    with pytest.raises(ValueError, match=f"unknown scenario '{name}'; did you mean '{near}'"):
        TwoLinkArmVectorEnv(2, name)


def test_the_papers_scenarios_run_at_the_papers_rates():
    rates = {name: scenarios.get(name).control_dt for name in scenarios.names() if name.startswith("paper-")}
    assert rates.pop("paper-6b") == 1e-4
    assert set(rates.values()) == {1e-3}
    assert all(scenarios.get(name).physics_dt == scenarios.get(name).control_dt for name in rates)
    assert all("roject's choice" in scenarios.get(name).description for name in rates if name not in ("paper-3b",))
