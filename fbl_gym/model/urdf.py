"""An arm from a URDF file: a chain of two revolute joints with parallel axes.

Bodies that fixed joints connect count as one. The dynamics depends on distances in the plane of
motion alone, so offsets along the axes are harmless. Angles are this package's: theta1 from the
horizontal, theta2 = 0 where the tip lies on the line through both joints, whatever zero the file
has. Torque limits, friction and meshes of the file are not read.
"""

from collections.abc import Iterable
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from fbl_gym.model.arm import STANDARD_GRAVITY, ArmParameters, Array
from fbl_gym.reading import read_bytes
from fbl_gym.records.checks import check_choice

_ON_LINE = 1e-6  # largest distance from a line, as a fraction of the link's length


class _Joint(NamedTuple):
    """A joint: name, type, the links that it connects, axis, and pose in the first one [4 x 4]."""

    name: str
    type: str
    parent: str
    child: str
    axis: Array
    origin: Array


class _Mass(NamedTuple):
    """A link's mass [kg], its centre [3] and its inertia about it [3 x 3]."""

    mass: float
    centre: Array
    inertia: Array


class _Robot(NamedTuple):
    """A file's content, at zero angles.

    Attributes:
        path: of the file, for errors.
        joints: all, in the file's order.
        poses: of each link [4 x 4].
        bodies: number of turning joints before each link, so the base is 0.
        masses: of each link.
    """

    path: str
    joints: list[_Joint]
    poses: dict[str, Array]
    bodies: dict[str, int]
    masses: dict[str, _Mass]

    def position(self, link: str) -> Array:
        """Return the position of a link's frame [3]."""
        return self.poses[link][:3, 3]


@np.errstate(over="ignore", invalid="ignore")  # the arm refuses numbers that are not finite
def load_urdf(path: str, gravity: float = STANDARD_GRAVITY) -> ArmParameters:
    """Return the arm of a URDF file.

    The file's z axis points upwards. Vertical axes of the joints make a horizontal arm, which
    gravity does not move.

    Args:
        path: of the file. The second link needs a frame at its tip: a link on a fixed joint. Where
            it has several frames, FILE.urdf:LINK names the one at the tip.
        gravity: acceleration of gravity [m/s^2].

    Raises:
        ValueError: the file does not describe a planar arm of two links.
    """
    file, named, tip = path.partition(".urdf:")
    try:
        robot = _read_robot(path, read_bytes(file + ".urdf" if named else path))
    except (OSError, ElementTree.ParseError, KeyError, ValueError) as problem:
        raise ValueError(f"{path} must be a URDF file: {type(problem).__name__}: {problem}") from None
    inner, outer = _turning_joints(robot)
    axis = _common_axis(robot, inner, outer)
    shoulder, elbow = robot.position(inner.child), robot.position(outer.child)
    end = robot.position(_tip(robot, outer, axis, tip))
    if np.linalg.norm(_in_plane(axis, elbow - shoulder)) < _ON_LINE:
        raise ValueError(f"{path} must have its joints apart, got {inner.name!r} and {outer.name!r} on one axis")
    links = _link(robot, 1, axis, shoulder, elbow), _link(robot, 2, axis, elbow, end)
    upright = float(np.linalg.norm(np.cross(axis, (0.0, 0.0, 1.0))))
    gravity = gravity * upright if upright > _ON_LINE else 0.0
    return ArmParameters.from_links(*zip(*links, strict=True), gravity=gravity)  # type: ignore[arg-type, misc]


# The arm of a robot.


def _turning_joints(robot: _Robot) -> tuple[_Joint, _Joint]:
    """Return the joints of the first and the second link."""
    turning = [joint for joint in robot.joints if joint.type != "fixed"]
    kinds = [joint.type for joint in turning]
    if len(kinds) != 2 or not {*kinds} <= {"revolute", "continuous"}:
        raise ValueError(
            f"{robot.path} must have two revolute joints, and fixed ones; got {', '.join(kinds) or 'none'}"
        )
    inner, outer = sorted(turning, key=lambda joint: robot.bodies[joint.child])
    if robot.bodies[outer.child] != 2:
        raise ValueError(f"{robot.path} must be a chain, got both joints {inner.name!r} and {outer.name!r} on one body")
    return inner, outer


def _common_axis(robot: _Robot, *joints: _Joint) -> Array:
    """Return the direction of the joints' parallel axes [3]."""
    first, second = (robot.poses[joint.child][:3, :3] @ (joint.axis / np.linalg.norm(joint.axis)) for joint in joints)
    if np.linalg.norm(np.cross(first, second)) > _ON_LINE:
        raise ValueError(f"{robot.path} must have parallel axes, got {first.round(6)} and {second.round(6)}")
    return first


def _in_plane(axis: Array, vector: Array) -> Array:
    """Return a vector's part in the plane of motion."""
    return vector - axis * (axis @ vector)


def _tip(robot: _Robot, outer: _Joint, axis: Array, name: str) -> str:
    """Return the link at the tip: that of a name, or the only one off the second joint's axis."""
    elbow = robot.position(outer.child)
    frames = {
        link: frame
        for link, body in robot.bodies.items()
        if body == 2 and np.linalg.norm(frame := _in_plane(axis, robot.position(link) - elbow)) > _ON_LINE
    }
    if not frames:
        raise ValueError(f"{robot.path} must have a frame at its tip: a link on a fixed joint beyond {outer.name!r}")
    if name:
        return check_choice(f"tip in {robot.path}", name, frames)
    first, *others = frames
    if any(np.linalg.norm(frames[link] - frames[first]) > _ON_LINE for link in others):
        raise ValueError(
            f"{robot.path} must have one frame at its tip, got {', '.join(frames)}: name it, as in "
            f"{robot.path}:{min(frames)}"
        )
    return first


def _link(robot: _Robot, body: int, axis: Array, start: Array, end: Array) -> tuple[float, float, float, float]:
    """Return mass, length, centre and inertia of a body, from its joint to the next or the tip."""
    parts = [part for link, part in robot.masses.items() if robot.bodies[link] == body]
    mass = float(sum(part.mass for part in parts))
    if mass <= 0.0:
        raise ValueError(f"{robot.path} must give link {body} a mass (an <inertial> element), got {mass:g} kg")
    line, joint = _in_plane(axis, end - start), _in_plane(axis, start)
    length = float(np.linalg.norm(line))
    centre = _in_plane(axis, np.sum([part.mass * part.centre for part in parts], axis=0) / mass)
    along = float((centre - joint) @ line) / length
    beside = float(np.linalg.norm(centre - joint - along * line / length))
    if beside > _ON_LINE * length:
        raise ValueError(
            f"{robot.path} must have each centre of mass on the line from joint to joint (or tip), "
            f"got {beside:g} m beside it in link {body}"
        )
    inertia = sum(
        axis @ part.inertia @ axis + part.mass * np.sum((_in_plane(axis, part.centre) - centre) ** 2) for part in parts
    )
    return mass, length, along, float(inertia)


# The robot of a file.


def _read_robot(path: str, text: bytes) -> _Robot:
    root = ElementTree.fromstring(text)
    links = {link.attrib["name"]: link for link in root.findall("link")}
    joints = [_read_joint(joint) for joint in root.findall("joint")]
    poses, bodies = _place(links, joints)
    return _Robot(path, joints, poses, bodies, {name: _read_mass(link, poses[name]) for name, link in links.items()})


def _place(links: Iterable[str], joints: list[_Joint]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return each link's pose at zero angles, and the number of turning joints before it."""
    children = {joint.child for joint in joints}
    poses = {name: np.eye(4) for name in links if name not in children}
    bodies = dict.fromkeys(poses, 0)
    waiting = list(joints)
    while waiting:
        joint = next((joint for joint in waiting if joint.parent in poses), None)
        if joint is None:
            raise ValueError(f"the joints {', '.join(sorted(joint.name for joint in waiting))} hang on no link")
        waiting.remove(joint)
        poses[joint.child] = poses[joint.parent] @ joint.origin
        bodies[joint.child] = bodies[joint.parent] + (joint.type != "fixed")
    return poses, bodies


def _read_joint(joint: Element) -> _Joint:
    name, kind = joint.attrib["name"], joint.attrib["type"]
    parent, child = (_child(joint, end).attrib["link"] for end in ("parent", "child"))
    axis = _read_vector(joint.find("axis"), "xyz", "1 0 0")
    if not np.linalg.norm(axis) > 0.0:
        raise ValueError(f"axis of {name} must have a direction, got {axis}")
    return _Joint(name, kind, parent, child, axis, _read_pose(joint))


def _read_mass(link: Element, pose: Array) -> _Mass:
    inertial = link.find("inertial")
    if inertial is None:
        return _Mass(0.0, np.zeros(3), np.zeros((3, 3)))
    moments = {name: float(value) for name, value in _child(inertial, "inertia").attrib.items()}
    matrix = [[moments.get("i" + "".join(sorted(row + column)), 0.0) for column in "xyz"] for row in "xyz"]
    pose = pose @ _read_pose(inertial)
    turn = pose[:3, :3]
    return _Mass(float(_child(inertial, "mass").attrib["value"]), pose[:3, 3], turn @ np.array(matrix) @ turn.T)


def _read_vector(element: Element | None, name: str, default: str) -> Array:
    """Return the three numbers of an attribute."""
    text = default if element is None else element.get(name, default)
    vector = np.array(text.split(), dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} must be three numbers, got {text!r}")
    return vector


def _read_pose(element: Element) -> Array:
    """Return the pose of an element's `origin` [4 x 4]: turned about x, y, z in turn, moved."""
    from scipy.spatial.transform import Rotation  # few programs need it, and it takes long to import

    origin, pose = element.find("origin"), np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", _read_vector(origin, "rpy", "0 0 0")).as_matrix()
    pose[:3, 3] = _read_vector(origin, "xyz", "0 0 0")
    return pose


def _child(element: Element, name: str) -> Element:
    """Return a child element that must be there."""
    child = element.find(name)
    if child is None:
        raise KeyError(f"{name} of <{element.tag} name={element.get('name')!r}>")
    return child
