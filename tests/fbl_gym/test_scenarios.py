"""The named scenarios: names, families, the paper's figures; and scenarios in TOML files, which change a base."""

import tomllib
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.run.suite import load
from fbl_gym import ParameterError, Scenario, TwoLinkArmEnv, scenarios
from fbl_gym.scenarios import as_scenario
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


# Files. An error names the file and the key.


ERRORS = tomllib.loads(Path(__file__).with_name("scenario_errors.toml").read_text(encoding="utf-8"))
ARM = """
base = "servo-everything-2"
control_dt = 0.02
noise.position = 1e-4
friction = false
parameter_error.radius = 0.1
reference = { kind = "sine", amplitude = [0.5, 0.5] }

[arm]
m1 = 12.0
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms/arm.toml").write_text(ARM)
    (tmp_path / "arm.toml").write_text('base = "arms/arm.toml"\nname = "second"\nduration = 4.0')
    return tmp_path


def test_a_file_changes_its_base_table_by_table(folder):
    base, scenario = scenarios.get("servo-everything-2"), scenarios.get(str(folder / "arms/arm.toml"))
    assert (scenario.name, scenario.control_dt, scenario.friction) == ("arm", 0.02, None)
    assert (scenario.arm.m1, scenario.parameter_error.radius, scenario.reference.kind) == (12.0, 0.1, "sine")
    for option, name in (("arm", "m2"), ("parameter_error", "payload"), ("actuator", "lag")):
        assert getattr(getattr(scenario, option), name) == getattr(getattr(base, option), name)
    second = scenarios.get(str(folder / "arm.toml"))
    assert second.name == "second"
    assert second == scenario.replace(name="second", duration=4.0, description=second.description)


def test_a_mapping_has_a_base_and_draws_replace_draws():
    uniform, choice = ({"payload": {"mass": {kind: [1, 2]}, "pick_up": 1.0}} for kind in ("uniform", "choice"))
    plain = as_scenario({"parameter_error": uniform}).to_dict()
    changed = as_scenario({**plain, "base": "nominal", "parameter_error": choice})
    assert changed.parameter_error.payload.mass.choice == (1.0, 2.0)
    assert as_scenario({"base": "noise-2"}).noise == scenarios.get("noise-2").noise


def test_environments_and_suites_take_files(folder):
    env = gym.make("fbl_gym/TwoLinkArm-v0", scenario=str(folder / "arm.toml"))
    assert env.unwrapped.interface.control_dt == 0.02
    third = '{base = "arm.toml", name = "third", duration = 2.0}, {name = "third"}'
    (folder / "suite.toml").write_text(f'policies = ["zero"]\nscenarios = ["arms/arm.toml", "noise-1", {third}]')
    names = [scenario.name for scenario in load(str(folder / "suite.toml")).scenarios]
    assert (names[:3], names[3][:6]) == (["arm", "noise-1", "third"], "third~")
    assert scenarios.get(f"{folder}/suite.toml:third").duration == 2.0  # the first of this name
    assert scenarios.get(f"{folder}/suite.toml:noise-1") == scenarios.get("noise-1")


def test_a_world_moves_the_arm_of_a_file(folder):
    (folder / "rigid.toml").write_text('\ufeffbase = "noise-1"')  # as Notepad writes UTF-8
    assert scenarios.get(f"{folder}/rigid.toml@mujoco").plant is not None


@pytest.mark.parametrize(("text", "message"), ERRORS["wrong"])
def test_an_error_names_the_file_and_the_key_once(text, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text(text)
    (tmp_path / "child.toml").write_text("base = 'bad.toml'")
    for name in ("bad.toml", "child.toml"):
        with pytest.raises(ValueError, match=message):
            scenarios.get(name)


def test_the_torques_of_a_tier_follow_the_arm(tmp_path):
    (tmp_path / "mine.toml").write_text('base = "servo-friction-2"\narm = "pelican"\ncontrol_dt = 0.005\n')
    scenario = scenarios.get(str(tmp_path / "mine.toml"))
    arm = scenarios.get("servo-surprise-arm").arm
    expected = scenarios.Scenario(**scenarios.conditions(arm, "servo", "friction", 2))
    for name in ("friction", "actuator", "parameter_error"):
        assert getattr(scenario, name) == getattr(expected, name)
    assert scenario.control_dt == 0.005
    moved = scenarios.as_scenario({"base": "servo-friction-2@mujoco", "arm": "pelican"})
    assert (moved.actuator, moved.name) == (expected.actuator, "servo-friction-2@mujoco")


SHEET = """
base = "geared-friction-2"
[arm]
mass = [3.0, 1.5]
length = [0.4, 0.3]
centre = [0.18, 0.12]
inertia = [0.04, 0.01]
"""


def test_an_arm_may_be_in_kg_m_and_kg_m2(tmp_path):
    """It replaces the base's arm, whose rotors it does not have; p1 to p5 by hand."""
    (tmp_path / "sheet.toml").write_text(SHEET)
    (tmp_path / "rotors.toml").write_text('base = "sheet.toml"\n[arm]\nrotor = [0.3, 0.1]\n')
    scenario, second = (scenarios.get(str(tmp_path / name)) for name in ("sheet.toml", "rotors.toml"))
    p2, p3 = 1.5 * 0.12**2 + 0.01, 1.5 * 0.4 * 0.12
    lumped = 3 * 0.18**2 + 0.04 + 1.5 * 0.4**2, p2, p3, (3 * 0.18 + 1.5 * 0.4) * 9.81, 1.5 * 0.12 * 9.81
    assert scenario.arm.lumped == pytest.approx(lumped)
    assert (scenario.arm.rotor, second.arm.rotor) == ((0.0, 0.0), (0.3, 0.1))
    assert second.arm.lumped == pytest.approx(lumped)
    assert scenario.friction != scenarios.get("geared-friction-2").friction  # it follows the arm
    plain = {"base": "geared-friction-2", "arm": {"mass": (3, 1.5), "length": (0.4, 0.3)}}
    for more, message in (({}, "arm must give centre and inertia"), ({"m1": 1.0}, "or m1, m2, L1 and L2, got also m1")):
        with pytest.raises(ValueError, match=message):
            as_scenario({**plain, "arm": {**plain["arm"], **more}})
    light = {**plain, "arm": {**plain["arm"], "centre": 0.1, "inertia": 0.01, "rotor": 1e-3}}
    with pytest.raises(ValueError, match=r"physics_dt=0.0005 s is too long .*; physics_dt=.* s would do"):
        as_scenario(light)
    assert as_scenario({**light, "physics_dt": 2e-5}).physics_dt == 2e-5


@pytest.mark.parametrize(("arm", "doubt"), ERRORS["doubtful"])
def test_a_number_that_looks_like_a_mistake_of_units_warns(tmp_path, arm, doubt):
    (tmp_path / "far.toml").write_text(f'base = "nominal"\n[arm]\n{arm}\n')
    with warnings.catch_warnings(record=True, action="always") as caught:
        scenarios.get(str(tmp_path / "far.toml"))
    assert [f"far.toml: {doubt}" in str(warning.message) for warning in caught] == [True] * bool(doubt)
