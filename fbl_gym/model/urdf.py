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

from fbl_gym.checks import check_choice
from fbl_gym.model.arm import STANDARD_GRAVITY, ArmParameters, Array
from fbl_gym.reading import read_bytes

_ON_LINE = 1e-6  # largest distance from a line, as a fraction of the link's length


class _Joint(NamedTuple):
    """A joint: name, type, the links that it connects, axis, and pose in the first one [4 x 4]."""

    name: str
    type: str
    parent: str
    child: str
    axis: Array
    origin: Array


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
        robot = ElementTree.fromstring(read_bytes(file + ".urdf" if named else path))
        links = {link.attrib["name"]: link for link in robot.findall("link")}
        joints = [_read_joint(joint) for joint in robot.findall("joint")]
        poses, bodies = _bodies(links, joints)
        masses = {name: _read_mass(link, poses[name]) for name, link in links.items()}
    except (OSError, ElementTree.ParseError, KeyError, ValueError) as problem:
        raise ValueError(f"{path} must be a URDF file: {type(problem).__name__}: {problem}") from None
    turning = [joint for joint in joints if joint.type != "fixed"]
    kinds = [joint.type for joint in turning]
    if len(kinds) != 2 or not {*kinds} <= {"revolute", "continuous"}:
        raise ValueError(f"{path} must have two revolute joints, and fixed ones; got {', '.join(kinds) or 'none'}")
    inner, outer = sorted(turning, key=lambda joint: bodies[joint.child])
    if (bodies[inner.child], bodies[outer.child]) != (1, 2):
        raise ValueError(f"{path} must be a chain, got both joints {inner.name!r} and {outer.name!r} on one body")
    axes = [poses[joint.child][:3, :3] @ (joint.axis / np.linalg.norm(joint.axis)) for joint in (inner, outer)]
    if np.linalg.norm(np.cross(axes[0], axes[1])) > _ON_LINE:
        raise ValueError(f"{path} must have parallel axes, got {axes[0].round(6)} and {axes[1].round(6)}")
    axis = axes[0]

    def flat(point: Array) -> Array:
        """Return a vector's part in the plane of motion."""
        return point - axis * (axis @ point)

    shoulder, elbow = (poses[joint.child][:3, 3] for joint in (inner, outer))
    frames = {link: flat(poses[link][:3, 3] - elbow) for link, body in bodies.items() if body == 2}
    frames = {link: frame for link, frame in frames.items() if np.linalg.norm(frame) > _ON_LINE}
    if not frames:
        raise ValueError(f"{path} must have a frame at its tip: a link on a fixed joint beyond {outer.name!r}")
    if named:
        frames = {check_choice(f"tip in {path}", tip, frames): frames[tip]}
    arms = (flat(elbow - shoulder), *frames.values())
    if max(np.linalg.norm(frame - arms[1]) for frame in arms[1:]) > _ON_LINE:
        raise ValueError(
            f"{path} must have one frame at its tip, got {', '.join(frames)}: name it, as in {path}:{min(frames)}"
        )
    lengths = [float(np.linalg.norm(arm)) for arm in arms[:2]]
    if lengths[0] < _ON_LINE:
        raise ValueError(f"{path} must have its joints apart, got {inner.name!r} and {outer.name!r} on one axis")
    merged = []
    for body, (joint, arm, reach) in enumerate(zip((shoulder, elbow), arms[:2], lengths, strict=True), start=1):
        parts = [masses[name] for name in links if bodies[name] == body]
        mass = float(sum(part[0] for part in parts))
        if mass <= 0.0:
            raise ValueError(f"{path} must give link {body} a mass (an <inertial> element), got {mass:g} kg")
        centre = flat(np.sum([share * point for share, point, _ in parts], axis=0) / mass)
        inertia = sum(axis @ own @ axis + share * np.sum((flat(point) - centre) ** 2) for share, point, own in parts)
        along = float((centre - flat(joint)) @ arm) / reach
        beside = float(np.linalg.norm(centre - flat(joint) - along * arm / reach))
        if beside > _ON_LINE * reach:
            raise ValueError(
                f"{path} must have each centre of mass on the line from joint to joint (or tip), "
                f"got {beside:g} m beside it in link {body}"
            )
        merged.append((mass, reach, along, float(inertia)))
    upright = float(np.linalg.norm(np.cross(axis, (0.0, 0.0, 1.0))))
    gravity = gravity * upright if upright > _ON_LINE else 0.0
    columns = zip(*merged, strict=True)
    return ArmParameters.from_links(*columns, gravity=gravity)  # type: ignore[arg-type, misc]


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


def _read_joint(joint: Element) -> _Joint:
    name, kind = joint.attrib["name"], joint.attrib["type"]
    parent, child = (_child(joint, end).attrib["link"] for end in ("parent", "child"))
    axis = _read_vector(joint.find("axis"), "xyz", "1 0 0")
    if not np.linalg.norm(axis) > 0.0:
        raise ValueError(f"axis of {name} must have a direction, got {axis}")
    return _Joint(name, kind, parent, child, axis, _read_pose(joint))


def _read_mass(link: Element, pose: Array) -> tuple[float, Array, Array]:
    """Return a link's mass [kg], centre [3] and inertia about it [3 x 3], from the link's pose."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    moments = {name: float(value) for name, value in _child(inertial, "inertia").attrib.items()}
    matrix = [[moments.get("i" + "".join(sorted(row + column)), 0.0) for column in "xyz"] for row in "xyz"]
    pose = pose @ _read_pose(inertial)
    turn = pose[:3, :3]
    return float(_child(inertial, "mass").attrib["value"]), pose[:3, 3], turn @ np.array(matrix) @ turn.T


def _bodies(links: Iterable[str], joints: list[_Joint]) -> tuple[dict[str, Array], dict[str, int]]:
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
