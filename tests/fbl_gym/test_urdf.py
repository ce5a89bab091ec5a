"""An arm from a URDF file equals Pinocchio's and MuJoCo's of the same file; other files are refused by name."""

import mujoco
import numpy as np
import pytest

from fbl_gym import Scenario, TwoLinkArmEnv
from fbl_gym.model.arm import coriolis_matrix, gravity_torque, inertia_matrix, inverse_dynamics
from fbl_gym.model.urdf import load_urdf

pin = pytest.importorskip("pinocchio")  # Windows has none


def inertial(mass, at="0 0 0", moment=0.0):
    """Return an inertial element; a third moment is the sum of the others for any physical body."""
    moments = f'ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"'
    return f'<inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia {moments}/></inertial>'


def chain(
    axis2="0 1 0", elbow="0.4 0.05 0", tip="0.3 0 0", centre2="0.12 0.02 0", kind="revolute", extra="", base="0 0 1"
):
    """Return a vertical arm about y, stretched along x at zero, with a motor on link 1 and a tool on link 2."""
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    return f"""<robot name="arm"><link name="base"/>
    <link name="one">{inertial(3.0, "0.15 0 0", 0.02)}</link><link name="motor">{inertial(1.0, moment=0.001)}</link>
    <link name="two">{inertial(2.0, centre2, 0.01)}</link><link name="tool">{inertial(0.5, "0.02 0 0", 0.002)}</link>
    <joint name="shoulder" type="revolute"><parent link="base"/><child link="one"/><origin xyz="{base}"/>
      <axis xyz="0 1 0"/>{limit}</joint>
    <joint name="bolts" type="fixed"><parent link="one"/><child link="motor"/><origin xyz="0.3 0 0"/></joint>
    <joint name="elbow" type="{kind}"><parent link="one"/><child link="two"/><origin xyz="{elbow}"/>
      <axis xyz="{axis2}"/>{limit}</joint>
    <joint name="flange" type="fixed"><parent link="two"/><child link="tool"/><origin xyz="{tip}"/></joint>
    {extra}</robot>"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return str(path)

    return write


def test_the_dynamics_equals_pinocchios(file):
    """About y, positive angles turn the arm downwards: theta = -q."""
    path = file(chain())
    arm, model = load_urdf(path), pin.buildModelFromUrdf(path)
    data = model.createData()
    rng = np.random.default_rng(0)
    for q, v, a in rng.uniform(-3, 3, (50, 3, 2)):
        torque = pin.rnea(model, data, -q, -v, -a)
        np.testing.assert_allclose(inverse_dynamics(arm, q, v, a), -torque, rtol=1e-9, atol=1e-9)


def test_the_dynamics_equals_mujocos(file):
    path = file(chain())
    arm, model = load_urdf(path), mujoco.MjModel.from_xml_path(path)
    data, inertia = mujoco.MjData(model), np.zeros((2, 2))
    for q, v in np.random.default_rng(1).uniform(-3, 3, (50, 2, 2)):
        data.qpos[:], data.qvel[:] = -q, -v
        mujoco.mj_forward(model, data)
        for joint in range(2):
            mujoco.mj_mulM(model, data, inertia[joint], np.eye(2)[joint])
        np.testing.assert_allclose(inertia_matrix(arm, q), inertia, rtol=1e-9)
        np.testing.assert_allclose(coriolis_matrix(arm, q, v) @ v + gravity_torque(arm, q), -data.qfrc_bias, atol=1e-9)


def test_lengths_gravity_and_tilt(file):
    arm = load_urdf(file(chain(elbow="0.5 0.1 0")))
    assert (arm.L1, arm.L2, arm.gravity) == (pytest.approx(0.5), pytest.approx(0.3), pytest.approx(9.81))
    flat = chain(elbow="0.4 0 0", centre2="0.12 0 0.1").replace("0 1 0", "0 0 1")
    assert load_urdf(file(flat)).gravity == 0.0
    tilted = chain().replace('<origin xyz="0 0 1"/>', '<origin xyz="0 0 1" rpy="0.5 0 0"/>')
    assert load_urdf(file(tilted)).gravity == pytest.approx(9.81 * np.cos(0.5))
    again = load_urdf(file(chain(axis2="0 -1 0")))
    assert again == load_urdf(file(chain()))


def test_an_environment_takes_the_file(file):
    path = file(chain())
    env = TwoLinkArmEnv(arm=path)
    assert env.interface.nominal == load_urdf(path)
    scenario = Scenario(arm=path)
    assert Scenario.from_dict(scenario.to_dict()) == scenario  # without the file


BEHIND = """<link name="weight"/><joint name="back" type="fixed"><parent link="two"/><child link="weight"/>
    <origin xyz="-0.8 0 0"/></joint>"""


def test_of_several_frames_the_tip_is_named(file):
    """A frame behind the elbow, farther than the tip, was once taken as the tip."""
    path = file(chain(centre2="0.12 0 0", extra=BEHIND))
    with pytest.raises(ValueError, match=r"one frame at its tip, got tool, weight: name it, as in .*\.urdf:tool"):
        load_urdf(path)
    arm = load_urdf(f"{path}:tool")
    assert arm == load_urdf(file(chain(centre2="0.12 0 0")))
    assert Scenario(arm=f"{path}:tool").arm == arm
    with pytest.raises(ValueError, match=r"unknown tip in .* 'to'; did you mean 'tool'"):
        load_urdf(f"{path}:to")


THIRD = """<link name="hand"/><joint name="wrist" type="revolute"><parent link="two"/><child link="hand"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""


HEAVY = chain().replace('value="3.0"', 'value="1e300"').replace('iyy="0.02"', 'iyy="1e308"')
WEIGHTLESS = chain().replace(inertial(2.0, "0.12 0.02 0", 0.01), "").replace(inertial(0.5, "0.02 0 0", 0.002), "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (chain().replace('<joint name="shoulder"', "<joint"), "must be a URDF file: KeyError: 'name'"),
        (chain(extra=THIRD.replace('"two"', '"nothing"')), "the joints wrist hang on no link"),
        (chain(extra=THIRD), "two revolute joints.*revolute, revolute, revolute"),
        (chain(kind="prismatic"), "two revolute joints.*revolute, prismatic"),
        (chain(axis2="0 0 1"), "parallel axes"),
        (chain(axis2="0 0 0"), "axis of elbow must have a direction"),
        (HEAVY, "the arm must have inertia"),
        (chain(elbow="0 0.1 0"), "joints apart.*'shoulder' and 'elbow'"),
        (chain(tip="0 0 0"), "frame at its tip"),
        (chain(centre2="0.1 0 0.05"), "on the line.* beside it in link 2"),
        (WEIGHTLESS, "a mass"),
        (chain().replace('"one"/><child link="two"/>', '"base"/><child link="two"/>'), "a chain"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(file, text, message):
    with pytest.raises(ValueError, match=message):
        load_urdf(file(text))
