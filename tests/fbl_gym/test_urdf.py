"""An arm from a URDF file equals Pinocchio's and MuJoCo's of the same file; other files are refused by name."""

import re
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fbl_gym import Scenario, TwoLinkArmEnv
from fbl_gym.model.arm import inverse_dynamics
from fbl_gym.model.urdf import RobotFileWarning, read_robot
from fbl_gym.scenarios import as_scenario

pin = pytest.importorskip("pinocchio")  # Windows has none


CHAIN, MUJOCOS = (Path(__file__).with_name(name) for name in ("arm.urdf", "arm.xml"))
ROBOTS = tomllib.loads(Path(__file__).with_name("robots.toml").read_text(encoding="utf-8"))
PARTS = {"axis2": "0 1 0", "elbow": "0.4 0.05 0", "tip": "0.3 0 0", "centre2": "0.12 0.02 0", "base": "0 0 1"}


def chain(kind="revolute", extra="", **parts):
    """Return a vertical arm about y, stretched along x at zero, with a motor on link 1 and a tool on link 2."""
    return CHAIN.read_text().format(kind=kind, extra=extra, **PARTS | parts)


def mjcf(drives='<motor joint="elbow" ctrlrange="-9 9"/>', **parts):
    """Return a MuJoCo file of two joints about y."""
    return ROBOTS["mjcf"].format(drives=drives, **dict.fromkeys(("option", "free", "joint", "more"), "") | parts)


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return str(path)

    return write


def assert_equal_to(path, torque_of, tolerance=1e-9):
    """Compare torques, in the file's angles, at random states with those of another program's model."""
    robot, rng = read_robot(path), np.random.default_rng(0)
    sign, zero = np.array(robot.sign), np.array(robot.zero)
    for q, v, a in rng.uniform(-3, 3, (50, 3, 2)):
        torque = sign * inverse_dynamics(robot.arm, sign * q + zero, sign * v, sign * a)
        np.testing.assert_allclose(torque, torque_of(q, v, a), rtol=tolerance, atol=tolerance * 10)


def pinocchios(text):
    model = pin.buildModelFromXML(text.replace('xmlns="https://drake.mit.edu"', ""))
    data = model.createData()
    return lambda q, v, a: pin.rnea(model, data, pin.integrate(model, pin.neutral(model), q), v, a)


def mujocos(path):
    model = mujoco.MjModel.from_xml_path(path)
    model.dof_damping[:], model.dof_frictionloss[:] = 0.0, 0.0
    data = mujoco.MjData(model)

    def torque(q, v, a):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    return torque


def fixed(child, xyz, more=""):
    return f'''<link name="{child}"/><joint name="to {child}" type="fixed"><parent link="two"/><child link="{child}"/>
        <origin xyz="{xyz}"/>{more}</joint>'''


BEHIND = fixed("weight", "-0.8 0 0")
HOLD = """<link name="world"/><joint name="hold" type="fixed"><parent link="world"/><child link="base"/></joint>"""
NO_TIP = chain().replace('<origin xyz="0.3 0 0"/></joint>\n    </robot>', "</joint></robot>")


@pytest.mark.parametrize(("text", "tolerance", "doubts"), [
    (chain(), 1e-9, ""),
    (chain(axis2="0 -2 0", kind="continuous", base='0 0 1" rpy="0.5 0.2 -0.7'), 1e-9, ""),
    (chain().replace("0 1 0", "0 0 1"), 1e-9, "the tip 0.1 rad beside it"),
    (chain(extra=fixed("camera", "0.1 0 0", '<axis xyz="0 0 0"/>')), 1e-9, "tool, the farthest frame: name another, as in"),
    (NO_TIP, 1e-9, "no frame at the tip: the length of link 2 is taken to be 0.2 m"),
    (chain(extra=HOLD).replace("<robot", '<robot xmlns="https://drake.mit.edu"'), 1e-9, ""),
    (chain(centre2="0.12 0.02 0.03"), 1e-9, "tip 0.15 rad"),
    (chain(extra=BEHIND), 1e-9, ""),
    (chain().replace('<link name="base"/>', '<link name="base"><inertial/></link><xacro:property name="a"/>'), 1e-9, ""),
    (chain().replace("<robot", "<!-- <?xml --><robot"), 1e-9, ""),
    (chain(elbow='0.4 0.05 0" rpy="0 3.14 0'), 1e-9, ""),
    (chain(elbow="0.4 0.05 2e-6"), 1e-4, "link 1 is 9.4e-07 m beside its line: 3.7e-05 N m are neglected"),
    (chain(elbow='0.4 0.05 0" rpy="3.14 0 0'), 1e-2, "0.0016 rad between the axes is neglected"),
    (chain(base='0 0 1" rpy="1.57 0 0'), 3e-2, "gravity is neglected, since the axes are 0.0008 rad"),
])  # fmt: skip
def test_the_dynamics_equals_pinocchios(file, text, tolerance, doubts):
    """To rounding, or within what the file's reader says that it neglected."""
    found = "; ".join(read_robot(path := file(text)).doubts)
    assert (doubts in found, doubts == "") == (True, found == "")
    assert_equal_to(path, pinocchios(text), tolerance)


def test_the_dynamics_equals_mujocos(file):
    path = file(chain())
    assert_equal_to(path, mujocos(path))
    assert_equal_to(str(MUJOCOS), mujocos(str(MUJOCOS)))
    robot = read_robot(str(MUJOCOS))
    assert (robot.limit, robot.viscous, robot.arm.rotor) == ((0.0, 2.0), (0.05, 0.0), (0.2, 0.0))
    assert (robot.arm.L2, robot.arm.gravity) == (pytest.approx(1.0), pytest.approx(9.8))
    assert robot.doubts == ["nothing drives shoulder: its torque limit is 0"]


@pytest.mark.parametrize(("parts", "expected", "doubt"), ROBOTS["mujoco"])
def test_drives_and_joints_of_mujocos_files(parts, expected, doubt, file):
    for name in ("armature", "damping"):  # of drives, in newer versions
        if f"{name}=" in parts.get("drives", "") and not hasattr(mujoco.MjModel, f"actuator_{name}"):
            pytest.skip(f"this MuJoCo has no {name} of drives")
    robot = read_robot(file(mjcf(**parts)) + ":shoulder,elbow")
    found = {"limit": robot.limit[1], "viscous": robot.viscous[1], "rotor": robot.arm.rotor[1], "zero": robot.zero[1]}
    assert found == pytest.approx({"limit": None, "viscous": None, "rotor": 0.0, "zero": 0.0} | expected)
    assert (robot.limit[0], robot.coulomb, robot.arm.gravity) == (7.0, (None, None), 0.0)
    doubts = [text for text in robot.doubts if text != "the spring of elbow is neglected"]
    assert len(doubts) == len(robot.doubts) - 1
    assert doubt in "; ".join(doubts)
    assert doubt or not doubts


def test_lengths_gravity_and_tilt(file):
    flat = chain(elbow="0.4 0 0", centre2="0.12 0 0.1").replace("0 1 0", "0 0 1")
    tilted, turned = chain(base='0 0 1" rpy="0.5 0 0'), chain(axis2="0 -1 0")
    texts = chain(elbow="0.5 0.1 0"), flat, tilted, turned, chain()
    arm, flat, tilted, turned, plain = (read_robot(file(text)).arm for text in texts)
    assert (arm.L1, arm.L2, arm.gravity) == (pytest.approx(0.5), pytest.approx(0.3), pytest.approx(9.81))
    assert (flat.gravity, tilted.gravity, turned) == (0.0, pytest.approx(9.81 * np.cos(0.5)), plain)


DRIVEN = chain().replace('effort="1"', 'effort="12"').replace("</limit>", "")
PENDUBOT = DRIVEN.replace("</robot>", '<transmission><joint name="shoulder"/></transmission></robot>')
FRICTION = DRIVEN.replace('velocity="1"/>', 'velocity="1"/><dynamics damping="0.001" friction="0.16"/>')


OTHERS = PENDUBOT.replace('joint name="shoulder"/></t', 'joint name="hand"/></t')
NO_LIMIT = PENDUBOT.replace('effort="12"', 'effort="-1"')
DRIVES = [(DRIVEN, (12.0, 12.0), None), (PENDUBOT, (12.0, 0.0), None), (FRICTION, (12.0, 12.0), (0.16, 0.001)),
          (OTHERS, (12.0, 12.0), None), (NO_LIMIT, (2000.0, 0.0), None)]  # fmt: skip


@pytest.mark.parametrize(("text", "limit", "friction"), DRIVES)
def test_an_environment_takes_arm_drives_and_friction_and_says_so(file, text, limit, friction):
    path = file(text)
    message = f"(?s)theta1 = .*effort.*: ({limit[0]:g}|none), {limit[1]:g}.*the velocity are not"
    message += "(?s:.*nothing drives elbow: its torque limit is 0)" if limit[1] == 0.0 else ""
    for make in (lambda arm: TwoLinkArmEnv(arm=arm).scenario, Scenario, lambda arm: as_scenario({"arm": arm})):
        with pytest.warns(RobotFileWarning, match=message):
            scenario = make(arm=path)
        read = scenario.friction and (scenario.friction.coulomb[0], scenario.friction.viscous[1])
        assert (scenario.arm, scenario.actuator.torque_limit, read) == (read_robot(path).arm, limit, friction)
    assert Scenario.from_dict(scenario.to_dict()) == scenario  # without the file
    with pytest.warns(RobotFileWarning):
        given = TwoLinkArmEnv("dfki-c1", arm=path, actuator={"torque_limit": 5.0, "gain": 0.9}, friction=None).scenario
    assert (given.actuator.torque_limit, given.actuator.gain, given.friction) == ((5.0, 5.0), (0.9, 0.9), None)


def test_names_choose_joints_and_tip(file):
    path = file(chain(extra=THIRD + BEHIND))
    for names, message in ROBOTS["names"]:
        with pytest.raises(ValueError, match=message):
            read_robot(f"{path}{names}")
    arms = [read_robot(f"{path}:shoulder,elbow,{tip}").arm for tip in ("tool", "0.5")]
    assert (arms[0], arms[1].L2) == (read_robot(file(chain())).arm, 0.5)
    two = file(chain(extra=BEHIND))
    assert [read_robot(f"{two}:{tip}").arm for tip in ("tool", "0.5")] == arms
    with pytest.raises(ValueError, match=r"payload needs the tip.*urdf:shoulder,e"), pytest.warns(RobotFileWarning):
        Scenario(arm=file(NO_TIP) + ":shoulder,elbow", parameter_error={"payload": 1.0})
    wrist = THIRD.replace('"hand"', '"wrist"').replace("<axis", '<origin xyz="0.1 0 0"/><mimic joint="elbow"/><axis')
    path = Path(file(chain(extra=wrist))).rename(path.replace(".urdf", ".URDF"))
    robot = read_robot(f"{path}:shoulder,elbow,wrist")  # a link and a joint, held at 0
    assert (robot.arm.L2, robot.doubts[0]) == (pytest.approx(0.1), "wrist, a mimic of elbow, is held at 0")


THIRD = """<link name="hand"/><joint name="wrist" type="revolute"><parent link="two"/><child link="hand"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""


HEAVY = chain().replace('value="3.0"', 'value="1e300"').replace('iyy="0.02"', 'iyy="1e308"')
WEIGHTLESS = re.sub(r'(?<=name="t)(wo|ool)"><inertial>.*?</inertial>', r'\1">', chain())


@pytest.mark.parametrize(("text", "message"), [
    *[(chain(**parts).replace(old, new), message) for parts, old, new, message in ROBOTS["refused"]],
    *[(chain(extra=THIRD.replace(old, new)), message) for old, new, message in ROBOTS["refused third"]],
    (chain().replace("<robot", "<sdf").replace("</robot", "</sdf"), "the root must be <robot>, or <mujoco>, got <sdf>"),
    (HEAVY, "the arm must have inertia"),
    (WEIGHTLESS, "a mass"),
    (mjcf(more=f"<equality>{ROBOTS['tie']}</equality>"), "shoulder and elbow must move freely, but an <equality>"),
])  # fmt: skip
def test_a_file_that_does_not_fit_is_refused(file, text, message):
    with pytest.raises(ValueError, match=message):
        read_robot(file(text))
