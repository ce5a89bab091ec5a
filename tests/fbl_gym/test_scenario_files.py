"""A scenario in a TOML file changes a base, and an error names the file and the key."""

import gymnasium as gym
import pytest

from benchmarks.run.suite import Suite, load
from fbl_gym import scenarios
from fbl_gym.scenarios import as_scenario

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
    assert scenario.arm.m1 == 12.0
    assert scenario.arm.m2 == base.arm.m2
    assert scenario.parameter_error.radius == 0.1
    assert scenario.parameter_error.payload == base.parameter_error.payload
    assert scenario.reference.kind == "sine"
    assert scenario.actuator.lag == base.actuator.lag
    second = scenarios.get(str(folder / "arm.toml"))
    assert second.name == "second"
    assert second == scenario.replace(name="second", duration=4.0, description=second.description)


def test_a_mapping_has_a_base_and_draws_replace_draws():
    base = {"parameter_error": {"payload": {"mass": {"uniform": [0, 1]}, "pick_up": 1.0}}}
    plain = as_scenario(base).to_dict()
    changed = as_scenario(
        {**plain, "base": "nominal", "parameter_error": {"payload": {"mass": {"choice": [1, 2]}, "pick_up": 1.0}}}
    )
    assert changed.parameter_error.payload.mass.choice == (1.0, 2.0)
    assert as_scenario({"base": "noise-2"}).noise == scenarios.get("noise-2").noise


def test_environments_and_suites_take_files(folder):
    env = gym.make("fbl_gym/TwoLinkArm-v0", scenario=str(folder / "arm.toml"))
    assert env.unwrapped.interface.control_dt == 0.02
    (folder / "suite.toml").write_text(
        'policies = ["zero"]\nscenarios = ["arms/arm.toml", "noise-1", {base = "arm.toml", name = "third", duration = 2.0}]'
    )
    assert [scenario.name for scenario in load(str(folder / "suite.toml")).scenarios] == ["arm", "noise-1", "third"]
    assert scenarios.get(f"{folder}/suite.toml:third").duration == 2.0
    assert scenarios.get(f"{folder}/suite.toml:noise-1") == scenarios.get("noise-1")


def test_a_world_moves_the_arm_of_a_file(folder):
    (folder / "rigid.toml").write_text('base = "noise-1"')
    assert scenarios.get(f"{folder}/rigid.toml@mujoco-bend").plant is not None


def test_two_files_of_one_name_are_two_scenarios(folder):
    (folder / "arms/arm.toml").write_text('base = "noise-1"')
    (folder / "arm.toml").write_text('base = "noise-2"')
    both = Suite("own", ("zero",), tuple(scenarios.get(str(folder / f)) for f in ("arm.toml", "arms/arm.toml")), 1)
    assert len({cell.id for cell in both.cells}) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise.positon = 1.0", "^bad.toml: unknown field of noise 'positon'; did you mean 'position'"),
        ("nois = 1.0", "^bad.toml: unknown field of scenario 'nois'; did you mean 'noise'"),
        ("control_dt = -1.0", "^bad.toml: control_dt must be"),
        ("base = 'nomnal'", "^bad.toml: unknown scenario 'nomnal'; did you mean 'nominal'"),
        ("base = 'bad.toml'", "^bad.toml: base must be another scenario, but leads back to this file"),
        ("control_dt =", "^bad.toml is no TOML"),
        ("scenarios = ['nominal']", "^bad.toml is a suite: give it to --suite, or name one of its scenarios, bad.toml:NAME"),
    ],
)  # fmt: skip
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
    expected = scenarios.Scenario(
        **scenarios.conditions(scenarios.get("servo-surprise-arm").arm, "servo", "friction", 2)
    )
    assert scenario.friction == expected.friction
    assert scenario.actuator == expected.actuator
    assert scenario.parameter_error == expected.parameter_error
    assert scenario.control_dt == 0.005
