"""An arm from a file of a robot, URDF or MuJoCo's XML: two revolute joints with parallel axes.

Bodies that fixed joints connect count as one. The dynamics depends on distances in the plane of
motion alone, so offsets along the axes are harmless. Angles are this package's: theta1 from the
horizontal, theta2 = 0 where the second centre of mass lies on the line through both joints,
whatever zeros the file has.
"""

import re
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np

from fbl_gym.model.arm import STANDARD_GRAVITY, ArmParameters, Array, inverse_dynamics
from fbl_gym.model.bodies import Joint, Mass, Robot
from fbl_gym.model.mjcf import read_mjcf
from fbl_gym.reading import read_bytes
from fbl_gym.records.checks import Pair, check_number, check_pair, unknown
from fbl_gym.records.record import merged

#: The text that stands for an arm of a file; names follow it after a colon, separated by commas.
FILE = re.compile(r"(?P<path>.*?\.(?:urdf|xacro|xml|mjcf)(?:\.xacro)?)(?::(?P<names>.*))?$", re.IGNORECASE)

#: What may stand before the declaration, against the standard: blanks and whole comments.
_BEFORE = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:\s|<!--(?:(?!-->).)*-->)*(?=<\?xml)", re.DOTALL)

#: Angles, and distances by the link's length, that are rounding errors.
_NOTHING = 1e-9

#: Largest angle between axes, or of link 1's moment of mass beside its line, to neglect [rad].
_TOLERANCE = 0.01


class RobotFileWarning(UserWarning):
    """Statement on what was read from the file of a robot, and what was neglected."""


class RobotFile(NamedTuple):
    """An arm as a file has it.

    Attributes:
        path: of the file, with its joints, for warnings.
        arm: its links.
        limit: largest torque of each drive [2] N m, 0 of a passive joint; None: not in the file.
        viscous: friction of each joint [2] N m s/rad; None: not in the file.
        coulomb: friction of each joint [2] N m; None: not in the file.
        sign: direction of this package's angles in those of the file [2].
        zero: this package's angles at the file's zeros [2] rad.
        guess: how to give the length of link 2 in place of a guess; empty: it is none.
        doubts: what was neglected or guessed, one sentence each.
        notes: what else was read, or is not.
    """

    path: str
    arm: ArmParameters
    limit: tuple[float | None, ...]
    viscous: tuple[float | None, ...]
    coulomb: tuple[float | None, ...]
    sign: Pair
    zero: Pair
    guess: str
    doubts: list[str]
    notes: list[str]

    def options(self, given: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arm, drives and friction of a scenario, changed by some given options.

        A warning says what was read. What the file has not, is as in the base, a scenario's data.
        """
        drive = base["actuator"]["torque_limit"] or (1e30, 1e30)
        limit = [other if x is None else x for x, other in zip(self.limit, drive, strict=True)]
        numbers = {"viscous": self.viscous, "coulomb": self.coulomb}
        friction = {name: [x or 0.0 for x in pair] for name, pair in numbers.items() if pair != (None, None)}
        warnings.warn(f"{self.path}: {'; '.join(self.notes + self.doubts)}", RobotFileWarning, stacklevel=3)
        error = given.get("parameter_error")
        payload = error.get("payload") if isinstance(error, Mapping) else getattr(error, "payload", None)
        if self.guess and (payload is not None or "pick-up" in str(given.get("events"))):
            raise ValueError(f"a payload needs the tip: give the length of link 2, as in {self.guess}")
        read = {"actuator": {"torque_limit": limit} if self.limit != (None, None) else {}, "friction": friction}
        read = {name: merged({} if name in given else base[name], value) for name, value in read.items() if value}
        return merged(read, {**given, "arm": self})


@np.errstate(over="ignore", invalid="ignore")  # the arm refuses numbers that are not finite
def read_robot(path: str) -> RobotFile:
    """Return the arm of a URDF file, or of MuJoCo's XML.

    The z axis of a URDF file points upwards. Vertical axes of the joints make a horizontal arm,
    which gravity does not move.

    Args:
        path: of the file. Names may follow it, as in FILE.urdf:SHOULDER,ELBOW,TIP: two joints,
            where the file has more (the others are held at 0), and the link at the tip, or the
            length of the second link in m, where the file has no or several frames there.

    Raises:
        ValueError: the file does not describe a planar arm of two links.
    """
    match = FILE.match(path)
    file, names = match.groups("") if match else (path, "")
    try:
        return _arm(_read(file), file, [name.strip() for name in names.split(",") if name.strip()])
    except (OSError, LookupError, expat.ExpatError) as problem:
        raise ValueError(f"{file} must be a URDF file: {type(problem).__name__}: {problem}") from None
    except ValueError as problem:
        raise ValueError(f"{file}: {problem}") from None


def _arm(robot: Robot, file: str, names: list[str]) -> RobotFile:
    """Return the arm that some names choose: of a tip, or of two joints and perhaps a tip."""
    joints, tip = (names[:2], names[2:]) if len(names) > 1 else ([], names)
    if len(tip) > 1 or (joints and joints[0] == joints[1]):
        raise ValueError(f"the names must be two joints and a tip, as in {file}:SHOULDER,ELBOW,TIP, got {names}")
    for name in joints:
        if name not in robot.joints:
            raise unknown("joint", name, robot.joints)
    found = {name: robot.joints[name] for name in joints or robot.joints}
    good = [joint for joint in found.values() if isinstance(joint, Joint)]
    if not len(good) == len(found) == 2:
        got = ", ".join(f"{name} ({joint})" if isinstance(joint, str) else name for name, joint in found.items())
        raise ValueError(
            f"there must be two revolute joints, got {got or 'none'}: of more joints, choose two, as in "
            f"{file}:SHOULDER,ELBOW, and the others are held at 0"
        )
    inner, outer = good
    bodies: dict[str | None, int] = {None: 0}
    for link, parent in robot.parents.items():
        bodies[link] = bodies[parent] + (inner.link == link) + (outer.link == link)
    if bodies[inner.link] > bodies[outer.link]:
        inner, outer = outer, inner
    if bodies[outer.link] != 2:
        raise ValueError(f"the joints must be a chain, got {inner.name!r} and {outer.name!r} on one body")
    return _planar(robot, inner, outer, bodies, tip, f"{file}:{','.join([*joints, ''])}")


def _planar(
    robot: Robot, inner: Joint, outer: Joint, bodies: dict[str | None, int], names: list[str], stem: str
) -> RobotFile:
    """Return the arm of two joints and their bodies; complex numbers are vectors in its plane.

    `names` has the tip, if it is named. A tip follows `stem`, the file and its joints.
    """
    doubts = [*dict.fromkeys((*inner.doubts, *outer.doubts))]
    for name, joint in robot.joints.items():
        if joint in (f"a mimic of {inner.name}", f"a mimic of {outer.name}"):
            doubts.append(f"{name}, {joint}, is held at 0")
    axis, second = (joint.axis / np.linalg.norm(joint.axis) for joint in (inner, outer))
    sign, tilt = (1.0 if axis @ second > 0 else -1.0), float(np.linalg.norm(np.cross(axis, second)))
    if tilt > _TOLERANCE:
        raise ValueError(f"the joints must have parallel axes, got {axis.round(6)} and {second.round(6)}")
    if tilt > _NOTHING:
        doubts.append(f"the angle of {tilt:.2g} rad between the axes is neglected")
    plane, acceleration = _plane(axis, robot.up, doubts)

    def body(number: int, joint: Joint) -> tuple[float, complex, float]:
        """Return mass, centre of mass from the joint and inertia about the joint."""
        parts = [robot.mass(link) for link in robot.parents if bodies[link] == number]
        mass = float(sum(part.mass for part in parts))
        if mass <= 0.0:
            raise ValueError(f"link {number} must have a mass (an <inertial> element), got {mass:g} kg")
        at = [complex(plane @ (part.centre - joint.place)) for part in parts]
        about = (axis @ part.inertia @ axis + part.mass * abs(z) * abs(z) for part, z in zip(parts, at, strict=True))
        return mass, sum(part.mass * z for part, z in zip(parts, at, strict=True)) / mass, float(sum(about))

    (m1, centre1, about1), (m2, centre2, about2) = body(1, inner), body(2, outer)
    line = complex(plane @ (outer.place - inner.place))
    if abs(line) < _NOTHING:
        raise ValueError(f"the joints must lie apart, got {inner.name!r} and {outer.name!r} on one axis")
    offset = centre1 * abs(line) / line  # along the line, and beside it
    beside = abs(offset.imag)
    turned = m1 * beside / (m1 * abs(offset) + m2 * abs(line))  # about the angle of the moment beside the line
    if acceleration > 0 and turned > _TOLERANCE:
        raise ValueError(
            f"the centre of mass of link 1 must lie on the line through both joints, got {beside:.3g} m beside it"
        )
    if acceleration > 0 and turned > _NOTHING:
        torque = m1 * beside * acceleration
        doubts.append(f"the centre of mass of link 1 is {beside:.2g} m beside its line: {torque:.2g} N m are neglected")
    places = (
        (name, complex(plane @ (at - outer.place))) for name, (link, at) in robot.frames.items() if bodies[link] == 2
    )
    tip, guess = _tip(names, {name: at for name, at in places if abs(at) > 1e-6}, centre2, doubts, stem)
    # A centre of mass beside the line to the tip is another zero of theta2.
    distance = abs(centre2) if (centre2 / tip).real >= 0 else -abs(centre2)
    towards = centre2 / distance if abs(centre2) > _NOTHING * abs(tip) else tip
    if (swung := abs(np.angle(tip / towards))) > _NOTHING:
        doubts.append(f"theta2 = 0 has the centre of mass of link 2 on the line, and the tip {swung:.2g} rad beside it")
    zero = float(np.angle(line)), float(np.angle(towards / line))
    own = (about1 - m1 * offset.real**2, about1), (about2 - m2 * distance**2, about2)
    inertia1, inertia2 = (moment * (abs(moment) > 1e-12 * about) for moment, about in own)  # rounding may be negative
    arm = ArmParameters.from_links(
        (m1, m2), (abs(line), abs(tip)), (offset.real, distance), (inertia1, inertia2), (inner.rotor, outer.rotor), acceleration
    )  # fmt: skip
    _, viscous, coulomb, velocity = zip(inner.numbers, outer.numbers, strict=True)
    limit = _limit(inner, outer, doubts)
    notes = [f"theta1 = q1 {zero[0]:+.5g} and theta2 = {'-' * (sign < 0)}q2 {zero[1]:+.5g} rad for the file's q1, q2"]
    for name, given in (("torque limits (effort)", limit), ("damping", viscous), ("friction", coulomb)):
        check_pair(name, [x or 0.0 for x in given], low=0.0)
        notes.append(f"{name}: {', '.join('none' if x is None else f'{x:g}' for x in given)}")
    if any(velocity):
        notes.append("the limits of the velocity are not used: `constraints.velocity` has such bounds")
    doubts += _differences(robot, (inner.name, outer.name), arm, sign, zero, [x or 0.0 for x in viscous])
    return RobotFile(stem.rstrip(":,"), arm, limit, viscous, coulomb, (1.0, sign), zero, guess, doubts, notes)


def _differences(
    robot: Robot, names: tuple[str, str], arm: ArmParameters, sign: float, zero: Pair, viscous: list[float]
) -> list[str]:
    """Return how far the arm's torques in random motions are from those of the file's program."""
    if robot.torques is None:
        return []
    motions = np.random.default_rng(0).uniform(-3.0, 3.0, (8, 3, 2))  # q, its velocity and acceleration
    angles, *rates = (motions * (1.0, sign)).swapaxes(0, 1)
    ours = inverse_dynamics(arm, angles + zero, *rates) * (1.0, sign) + viscous * motions[:, 1]
    theirs = robot.torques(names, motions)
    if (far := np.abs(ours - theirs).max() / np.abs(theirs).max()) <= 1e-6:
        return []
    return [
        f"torques of random motions differ from MuJoCo's by up to {100 * far:.3g} %: the file has more than is read, "
        "such as springs or dampers of tendons, damping that is not linear, or a fluid"
    ]


def _plane(axis: Array, up: Array, doubts: list[str]) -> tuple[Array, float]:
    """Return the plane of motion, x + i y of a place [3], and gravity in it [m/s^2].

    y points upwards, and positive angles turn as joint 1 does.
    """
    size = max(float(np.linalg.norm(up)), _NOTHING)
    y = (up - axis * (axis @ up)) / size
    upright = float(np.linalg.norm(y))
    if _NOTHING < upright < _TOLERANCE:
        doubts.append(f"gravity is neglected, since the axes are {upright:.2g} rad from the vertical")
    if upright < _TOLERANCE:  # any y will do
        upright, y = 0.0, np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    y /= np.linalg.norm(y)
    return np.cross(y, axis) + 1j * y, upright * size


def _limit(inner: Joint, outer: Joint, doubts: list[str]) -> tuple[float | None, ...]:
    """Return the largest torques of two joints, 0 without a drive; None: not in the file."""
    limit = inner.numbers[0], outer.numbers[0]
    limit = limit if any(limit) else (None, None)
    if inner.driven == outer.driven:  # with a drive at neither, those of the file are of other joints
        return limit
    doubts.append(f"nothing drives {(inner if outer.driven else outer).name}: its torque limit is 0")
    return limit[0] if inner.driven else 0.0, limit[1] if outer.driven else 0.0


def _tip(
    names: list[str], frames: dict[str, complex], centre: complex, doubts: list[str], stem: str
) -> tuple[complex, str]:
    """Return the tip from the second joint, and how to give its length if it is a guess."""
    for name in names:
        if re.fullmatch(r"\d+\.?\d*|\.\d+", name):
            length = check_number("length of link 2", float(name), above=0)
            return length * (centre / abs(centre) if centre else 1.0), ""
        if name not in frames:
            raise unknown("tip (a frame of link 2, off its joint)", name, frames)
        return frames[name], ""
    ahead = {name: at for name, at in frames.items() if (at * centre.conjugate()).real >= 0} or frames
    if ahead:
        farthest, *others = sorted(ahead, key=lambda name: -abs(ahead[name]))
        if others := [name for name in others if abs(ahead[name] - ahead[farthest]) > 1e-6]:
            doubts.append(
                f"the tip is taken to be {farthest}, the farthest frame: name another, as in {stem}{others[0]}"
            )
        return ahead[farthest], ""
    guess = f"{stem}0.3, in m"
    if abs(centre) < 1e-6:
        raise ValueError(
            f"link 2 must have a frame at its tip, a link on a fixed joint, or be given its length, as in {guess}"
        )
    doubts.append(
        f"no frame at the tip: the length of link 2 is taken to be {2 * abs(centre):.4g} m, twice the distance of its "
        f"centre of mass; pictures and payloads need the real one, as in {guess}"
    )
    return 2.0 * centre, guess


# The robot of a file.


def _read(path: str) -> Robot:
    text = read_bytes(path)
    # Without namespaces, whose prefixes may be undeclared.
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.Parse(_BEFORE.sub(b"", text), True)
    root = builder.close()
    if root.tag == "mujoco":
        return read_mjcf(path)
    if root.tag != "robot":
        raise ValueError(f"the root must be <robot>, or <mujoco>, got <{root.tag}>")
    if any(re.match("xacro:(?!property$|arg$)", element.tag) for element in root.iter()):  # those two do nothing alone
        raise ValueError(f"it has macros of xacro, expand them first: xacro {path} > arm.urdf, or pip install xacrodoc")
    return _read_urdf(root)


def _read_urdf(root: Element) -> Robot:
    links, waiting = _named(root, "link"), _named(root, "joint")
    driven = {joint.get("name") for joint in root.findall("transmission/joint")} or set(waiting)
    ends: dict[str, tuple[str, str]] = {}
    below: set[str] = set()
    for name, joint in waiting.items():
        of = f"joint {name!r}"
        parent, child = (_attribute(_child(joint, end, of), "link", of) for end in ("parent", "child"))
        if parent == "world":
            links.setdefault(parent, Element("link", name=parent))  # by convention, it needs no declaration
        for link in (parent, child):
            if link not in links:
                raise unknown(f"link of {of}", link, links)
        if child in below:
            raise ValueError(f"link {child!r} must be the child of one joint, got a second one, {name!r}")
        ends[name] = parent, child
        below.add(child)
    parents: dict[str, str | None] = {name: None for name in links if name not in below}
    poses, joints = {name: np.eye(4) for name in parents}, {}
    while waiting:
        if not (ready := [name for name in waiting if ends[name][0] in poses]):
            raise ValueError(f"the joints {', '.join(sorted(waiting))} must hang on the base, got a circle")
        name = ready[0]
        joint, (parent, child) = waiting.pop(name), ends[name]
        parents[child], poses[child] = parent, poses[parent] @ _read_pose(joint, f"joint {name!r}")
        if (kind := _attribute(joint, "type", f"joint {name!r}")) != "fixed":
            joints[name] = _read_joint(joint, kind, child, poses[child], name in driven)
    frames = {name: (name, pose[:3, 3]) for name, pose in poses.items()}
    up = np.array([0.0, 0.0, STANDARD_GRAVITY])
    return Robot(parents, joints, frames, lambda name: _read_mass(links[name], poses[name]), up)


def _named(root: Element, tag: str) -> dict[str, Element]:
    """Return the elements of a tag by name."""
    elements: dict[str, Element] = {}
    for element in root.findall(tag):
        name = _attribute(element, "name", f"each {tag}")
        if elements.setdefault(name, element) is not element:
            raise ValueError(f"{tag}s must have different names, got {name!r} twice")
    return elements


def _read_joint(joint: Element, kind: str, link: str, pose: Array, driven: bool) -> Joint | str:
    """Return a joint, or why it is no joint of an arm."""
    if kind not in ("revolute", "continuous"):
        return kind
    if (mimic := joint.find("mimic")) is not None:
        return f"a mimic of {mimic.get('joint')}"
    of = f"joint {joint.attrib['name']!r}"
    axis = _read_vector(joint.find("axis"), "xyz", "1 0 0", f"axis of {of}")
    if not np.linalg.norm(axis) > 0.0:
        raise ValueError(f"axis of {of} must have a direction, got {axis}")
    texts = {key: value for tag in ("limit", "dynamics") for each in joint.findall(tag) for key, value in each.items()}
    names = ("effort", "damping", "friction", "velocity")
    effort, *numbers = (_number(f"{key} of {of}", texts[key]) if key in texts else None for key in names)
    effort = effort if effort is not None and 0.0 <= effort < np.inf else None  # -1 stands for none, too
    return Joint(joint.attrib["name"], link, pose[:3, :3] @ axis, pose[:3, 3], (effort, *numbers), driven=driven)


def _read_mass(link: Element, pose: Array) -> Mass:
    inertial, of = link.find("inertial"), f"link {link.get('name')!r}"
    if inertial is None:
        return Mass(0.0, np.zeros(3), np.zeros((3, 3)))
    inertia, mass = (_child(inertial, name, of) for name in ("inertia", "mass"))
    moments = {name: _number(f"{name} of {of}", value) for name, value in inertia.attrib.items()}
    matrix = [[moments.get("i" + "".join(sorted(row + column)), 0.0) for column in "xyz"] for row in "xyz"]
    pose = pose @ _read_pose(inertial, of)
    turn = pose[:3, :3]
    return Mass(_number(f"mass of {of}", _attribute(mass, "value", of)), pose[:3, 3], turn @ np.array(matrix) @ turn.T)


def _number(name: str, text: str) -> float:
    """Return the number of an attribute."""
    try:
        return float(text)
    except ValueError:
        hint = ": expand the macros of xacro first" if "$" in text else ""
        raise ValueError(f"{name} must be a number, got {text!r}{hint}") from None


def _read_vector(element: Element | None, key: str, default: str, name: str) -> Array:
    """Return the three numbers of an attribute."""
    text = default if element is None else element.get(key, default)
    vector = np.array([_number(f"{key} of {name}", each) for each in text.split()])
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{key} of {name} must be three numbers, got {text!r}")
    return vector


def _read_pose(element: Element, of: str) -> Array:
    """Return the pose of an element's `origin` [4 x 4]: turned about x, y, z in turn, moved."""
    from scipy.spatial.transform import Rotation  # few programs need it, and it takes long to import

    origin, pose = element.find("origin"), np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", _read_vector(origin, "rpy", "0 0 0", of)).as_matrix()
    pose[:3, 3] = _read_vector(origin, "xyz", "0 0 0", of)
    return pose


def _child(element: Element, name: str, of: str) -> Element:
    """Return a child element that must be there."""
    child = element.find(name)
    if child is None:
        raise ValueError(f"{of} must have a <{name}>")
    return child


def _attribute(element: Element, name: str, of: str) -> str:
    """Return an attribute that must be there."""
    if name not in element.attrib:
        raise ValueError(f"{of} must have a {name!r} in its <{element.tag}>, got {element.attrib}")
    return element.attrib[name]
