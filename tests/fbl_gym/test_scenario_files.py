"""A scenario in a TOML file changes a base, and an error names the file and the key."""

import warnings

import gymnasium as gym
import pytest

from benchmarks.run.suite import load
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
    assert names == ["arm", "noise-1", "third", "third"]
    assert scenarios.get(f"{folder}/suite.toml:third").duration == 2.0  # the first of this name
    assert scenarios.get(f"{folder}/suite.toml:noise-1") == scenarios.get("noise-1")


def test_a_world_moves_the_arm_of_a_file(folder):
    (folder / "rigid.toml").write_text('base = "noise-1"')
    assert scenarios.get(f"{folder}/rigid.toml@mujoco").plant is not None


@pytest.mark.parametrize(("text", "message"), [
    ("noise.positon = 1.0", "^bad.toml: unknown field of noise 'positon'; did you mean 'position'"),
    ("nois = 1.0", "^bad.toml: unknown field of scenario 'nois'; did you mean 'noise'"),
    ("control_dt = -1.0", "^bad.toml: control_dt must be"),
    ("base = 'nomnal'", "^bad.toml: unknown scenario 'nomnal'; did you mean 'nominal'"),
    ("control_dt =", "^bad.toml is no TOML"),
    ("scenarios = ['nominal']", "^bad.toml is a suite: give it to --suite, or name one of its scenarios, bad.toml:NAME"),
    ('base = "child.toml"', r"(bad|child).toml: base must be another scenario, but leads back"),
])  # fmt: skip
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


@pytest.mark.parametrize(("arm", "doubt"), [
    ("centre = [4.5, 0.5]", "the centre of mass of link 1 is 4.5 link lengths from its joint"),
    ("centre = [-0.3, 1.1]", ""),  # a counterweight, and a centre just beyond the end
    ("inertia = [0.1, 2.0]", "the inertia of link 2 is 2 times its mass times its length squared"),
    ("L1 = 350.0", "link 1 is 350 m long"),
])  # fmt: skip
def test_a_number_that_looks_like_a_mistake_of_units_warns(tmp_path, arm, doubt):
    (tmp_path / "far.toml").write_text(f'base = "nominal"\n[arm]\n{arm}\n')
    with warnings.catch_warnings(record=True, action="always") as caught:
        scenarios.get(str(tmp_path / "far.toml"))
    assert [f"far.toml: {doubt}" in str(warning.message) for warning in caught] == [True] * bool(doubt)
