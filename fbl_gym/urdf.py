"""An arm from a URDF file: a chain of two revolute joints with parallel axes.

Bodies that fixed joints connect count as one. The dynamics depends on distances in the plane of
motion alone, so offsets along the axes are harmless. Angles are this package's: theta1 from the
horizontal, theta2 = 0 where the tip lies on the line through both joints, whatever zero the file
has. Torque limits, friction and meshes of the file are not read.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fbl_gym.arm import STANDARD_GRAVITY, ArmParameters, Array

_ON_LINE = 1e-6  # largest distance from a line, as a fraction of the link's length


def load_urdf(path: str, gravity: float = STANDARD_GRAVITY) -> ArmParameters:
    """Return the arm of a URDF file.

    The file's z axis points upwards. Vertical axes of the joints make a horizontal arm, which
    gravity does not move.

    Args:
        path: of the file. The second link needs a frame at its tip: a link on a fixed joint.
        gravity: acceleration of gravity [m/s^2].

    Raises:
        ImportError: yourdfpy is not installed.
        ValueError: the file does not describe a planar arm of two links.
    """
    try:
        import yourdfpy
    except ImportError as problem:
        raise ImportError(f"arm={path!r} needs yourdfpy: pip install 'fbl-gym[urdf]'") from problem
    try:
        robot = yourdfpy.URDF.load(path, build_scene_graph=False, load_meshes=False, load_collision_meshes=False).robot
        poses, bodies = _bodies(robot)
    except Exception as problem:  # yourdfpy and lxml raise anything for a malformed file
        raise ValueError(f"{path} must be a URDF file: {type(problem).__name__}: {problem}") from None
    turning = [joint for joint in robot.joints if joint.type != "fixed"]
    kinds = [joint.type for joint in turning]
    if len(kinds) != 2 or not {*kinds} <= {"revolute", "continuous"}:
        raise ValueError(f"{path} must have two revolute joints, and fixed ones; got {', '.join(kinds) or 'none'}")
    inner, outer = sorted(turning, key=lambda joint: bodies[joint.child])
    if (bodies[inner.child], bodies[outer.child]) != (1, 2):
        raise ValueError(f"{path} must be a chain, got both joints {inner.name!r} and {outer.name!r} on one body")
    axes = [poses[joint.child][:3, :3] @ (joint.axis / np.linalg.norm(joint.axis)) for joint in (inner, outer)]
    if np.linalg.norm(np.cross(*axes)) > _ON_LINE:
        raise ValueError(f"{path} must have parallel axes, got {axes[0].round(6)} and {axes[1].round(6)}")
    axis = axes[0]

    def flat(point: Array) -> Array:
        """Return a vector's part in the plane of motion."""
        return point - axis * (axis @ point)

    shoulder, elbow = (poses[joint.child][:3, 3] for joint in (inner, outer))
    tips = [flat(poses[link][:3, 3] - elbow) for link, body in bodies.items() if body == 2]
    arms = (flat(elbow - shoulder), max(tips, key=lambda tip: float(np.linalg.norm(tip))))
    lengths = [float(np.linalg.norm(arm)) for arm in arms]
    if lengths[0] < _ON_LINE:
        raise ValueError(f"{path} must have its joints apart, got {inner.name!r} and {outer.name!r} on one axis")
    if lengths[1] < _ON_LINE:
        raise ValueError(f"{path} must have a frame at its tip: a link on a fixed joint beyond {outer.name!r}")
    links = []
    for body, (joint, arm, reach) in enumerate(zip((shoulder, elbow), arms, lengths, strict=True), start=1):
        mass, centre, inertia = _merge([link for link in robot.links if bodies[link.name] == body], poses, axis, flat)
        if mass <= 0.0:
            raise ValueError(f"{path} must give link {body} a mass (an <inertial> element), got {mass:g} kg")
        along = float((centre - flat(joint)) @ arm) / reach
        beside = float(np.linalg.norm(centre - flat(joint) - along * arm / reach))
        if beside > _ON_LINE * reach:
            raise ValueError(
                f"{path} must have each centre of mass on the line from joint to joint (or tip), "
                f"got {beside:g} m beside it in link {body}"
            )
        links.append((mass, reach, along, inertia))
    upright = float(np.linalg.norm(np.cross(axis, (0.0, 0.0, 1.0))))
    gravity = gravity * upright if upright > _ON_LINE else 0.0
    columns = zip(*links, strict=True)
    return ArmParameters.from_links(*columns, gravity=gravity)  # type: ignore[arg-type, misc]


def _bodies(robot: Any) -> tuple[dict[str, Array], dict[str, int]]:
    """Return each link's pose at zero angles, and the number of turning joints before it."""
    children = {joint.child for joint in robot.joints}
    poses = {link.name: np.eye(4) for link in robot.links if link.name not in children}
    bodies = dict.fromkeys(poses, 0)
    waiting = list(robot.joints)
    while waiting:
        joint = next((joint for joint in waiting if joint.parent in poses), None)
        if joint is None:
            raise ValueError(f"the joints {', '.join(sorted(joint.name for joint in waiting))} hang on no link")
        waiting.remove(joint)
        origin = np.eye(4) if joint.origin is None else joint.origin
        poses[joint.child] = poses[joint.parent] @ origin
        bodies[joint.child] = bodies[joint.parent] + (joint.type != "fixed")
    return poses, bodies


def _merge(links: list[Any], poses: dict[str, Array], axis: Array, flat: Any) -> tuple[float, Array, float]:
    """Return mass, centre in the plane of motion and inertia about it of links that move as one."""
    parts = []
    for link in links:
        if link.inertial is not None and link.inertial.mass:
            pose = poses[link.name] @ (np.eye(4) if link.inertial.origin is None else link.inertial.origin)
            direction = pose[:3, :3].T @ axis
            parts.append((link.inertial.mass, flat(pose[:3, 3]), direction @ link.inertial.inertia @ direction))
    mass = float(sum(m for m, _, _ in parts))
    centre = sum((m * place for m, place, _ in parts), np.zeros(3)) / (mass or 1.0)
    return mass, centre, float(sum(own + m * ((place - centre) ** 2).sum() for m, place, own in parts))
