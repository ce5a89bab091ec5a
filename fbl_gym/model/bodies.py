"""Links, joints and frames of a robot, as its file has them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from fbl_gym.model.arm import Array


class Joint(NamedTuple):
    """A turning joint at zero angles: the link that it turns, axis and place in the base's frame.

    `numbers` are effort [N m], damping [N m s/rad], friction [N m] and velocity [rad/s]; None: not
    in the file. `doubts` say what was neglected or guessed. `rotor` is in kg m^2. `driven` is False
    if the file has drives, and none is of this joint.
    """

    name: str
    link: str
    axis: Array
    place: Array
    numbers: tuple[float | None, ...]
    doubts: tuple[str, ...] = ()
    rotor: float = 0.0
    driven: bool = True


class Mass(NamedTuple):
    """A link's mass [kg], its centre [3] and its inertia about it [3 x 3], in the base's frame."""

    mass: float
    centre: Array
    inertia: Array


class Robot(NamedTuple):
    """A file's content, at zero angles.

    Attributes:
        parents: the parent of each link, from the base on; None: it has none.
        joints: that turn or slide, by name; None: it cannot be one of an arm's, and why.
        frames: link and position [3] of each named frame.
        mass: returns that of a link.
        up: against gravity [3] m/s^2.
        torques: returns those at two joints [n x 2] N m that motions [n x 3 x 2] of their angles,
            velocities and accelerations need, by another program; None: there is none.
    """

    parents: dict[str, str | None]
    joints: dict[str, Joint | str]
    frames: dict[str, tuple[str, Array]]
    mass: Callable[[str], Mass]
    up: Array
    torques: Callable[[Sequence[str], Array], Array] | None = None
