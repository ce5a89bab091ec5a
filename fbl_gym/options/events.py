"""Events: changes of the real arm at a time, for measuring recovery.

A policy is not told of them. Times count to the nearest physics step.
"""

from collections.abc import Mapping
from typing import Any, TypeAlias

from fbl_gym.records.record import Number, Numbers, Option, build_kind, declared, number, pair, steps


class _Event(Option):
    """Base of the events.

    Args:
        time: of the event.
    """

    time: Number = number(unit="s", varies=True, low=0, scale=steps)


class PickUp(_Event, kind="pick-up"):
    """A grasp: a point mass at rest joins the tip, on top of any other payload.

    The grasp is inelastic. The arm shares its momentum, M_after v_after = M_before v_before, and
    loses energy. Offset and radius of `parameter_error.payload` are those of that payload alone.

    Args:
        mass: of the payload.
    """

    mass: Number = number(unit="kg", varies=True, low=0)


class Drop(_Event, kind="drop"):
    """The release of all payload. Velocities stay."""


class FrictionChange(_Event, kind="friction"):
    """All parts of the friction, that under load too, times a factor from now on.

    Args:
        factor: on the friction before.
    """

    factor: Numbers = pair(varies=True, low=0)

    def check(self, scenario: Any) -> None:
        """Refuse the change of a friction that is not given."""
        if scenario.friction is None:
            raise ValueError("events change friction, but friction is None: give the friction that they change")


class DriveChange(_Event, kind="drive"):
    """Torque of the drives times a factor from now on, such as 0.5 where half of it is lost.

    The torque ripple is part of a drive's torque: the factor multiplies it too.

    Args:
        factor: on the torque before; 0: the drive has failed and gives none, no ripple either.
    """

    factor: Numbers = pair(varies=True, low=0)

    def pack(self, packer: Any) -> None:
        """Write that the torque varies."""
        packer.settings["torque_varies"] = True


class Knock(_Event, kind="knock"):
    """A blow: velocities jump by M^-1 impulse. With elastic joints it meets the links.

    Args:
        impulse: on the joints.
    """

    impulse: Numbers = pair(unit="N m s", varies=True)


Event: TypeAlias = PickUp | Drop | FrictionChange | DriveChange | Knock
#: The kinds of events, in the order of their numbers in the kernel.
EVENTS = (PickUp, Drop, FrictionChange, DriveChange, Knock)


def _check_events(name: str, value: Any) -> tuple[Event, ...]:
    """Return events from records or plain data; None: no event."""
    if value is None:
        return ()
    if isinstance(value, str | Mapping) or not hasattr(value, "__iter__"):
        raise ValueError(f"{name} must be a list of events, such as [{{'kind': 'drop', 'time': 3.0}}], got {value!r}")
    return tuple(build_kind(f"{name}[{i}]", event, EVENTS) for i, event in enumerate(value))


def events() -> Any:
    """Declare a list of events."""
    kinds = ", ".join(f'"{event.kind}"' for event in EVENTS)
    return declared((), _check_events, f"a list of dicts with a kind of {kinds}", classes=EVENTS)
