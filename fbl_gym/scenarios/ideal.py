"""The tier `ideal`: one kind of uncertainty in each family, on an arm that is ideal otherwise."""

import math
from typing import Any, NamedTuple

from fbl_gym.arm import ARMS, ArmParameters
from fbl_gym.checks import check_choice
from fbl_gym.scenarios.scenario import Scenario
from fbl_gym.uncertainty import (
    Actuator,
    Friction,
    Noise,
    ParameterError,
    Payload,
    PiecewiseConstantDisturbance,
)

SEVERITIES = (0, 1, 2, 3)

# Indexed by severity.
_RADII = (0.0, 0.25, 0.5, 1.0)
_NOISE = ((0.0, 0.0, 0.0), (1e-4, 1e-3, 1e-2), (1e-3, 1e-2, 1e-1), (5e-3, 5e-2, 5e-1))  # rad, rad/s, rad/s^2
_PAYLOADS = (0.0, 1 / 3, 2 / 3, 1.0)  # of m2
_FRICTION = (0.0, 10.0, 30.0, 60.0)  # N m at joint 1, a third of it at joint 2
_DISTURBANCE = (0.0, 30.0, 100.0, 200.0)  # likewise

# For the default motion with each parameter between half and double and the heaviest payload, the
# arms need 1,683 and 749, and 62,300 and 19,700 N m. Friction and disturbance add to this: at its
# worst corner, everything-3 needs some 836 N m at the second joint, more than its 800.
_TORQUE_LIMITS = {"table-1": (2000.0, 800.0), "section-2-2": (70000.0, 22000.0)}

_FAMILIES = {
    "nominal": "the nominal arm: nothing varies but the way-points",
    "mass-error": "masses off by a factor drawn from [1/(1+r), 1+r], each its own; r = 0, 0.25, 0.5, 1",
    "length-error": "lengths off by a factor drawn from [1/(1+r), 1+r], each its own; r = 0, 0.25, 0.5, 1",
    "mixed-error": "masses and lengths off, each by its own factor from [1/(1+r), 1+r]; r = 0, 0.25, 0.5, 1",
    "uniform-error": "masses and lengths off by one factor for all, drawn from [1/(1+r), 1+r]; r = 0, 0.25, 0.5, 1",
    "larger-error": "real masses and lengths larger than nominal, each by its own factor from [1, 1+r]; "
    "r = 0, 0.25, 0.5, 1",
    "smaller-error": "real masses and lengths smaller than nominal, each by its own factor from [1/(1+r), 1]; "
    "r = 0, 0.25, 0.5, 1",
    "payload": "0, 1/3, 2/3 or all of the second link's mass again, picked up at the tip at 3 s and dropped at 7 s",
    "noise": "white noise on position (0, 1e-4, 1e-3, 5e-3 rad), ten times that on velocity, "
    "a hundred times on acceleration",
    "stiction": "Coulomb friction and as much stiction again (0, 10, 30, 60 N m; a third of it on joint 2), "
    "v_s = 1e-3 (rad/s)^2",
    "disturbance": "piecewise-constant torque within 0, 30, 100, 200 N m (a third of it on joint 2), "
    "a new level every 0.5 s",
    "everything": "mixed error, payload, noise, stiction and disturbance at once",
}


def _options(name: str, severity: int, arm: ArmParameters) -> dict[str, Any]:
    """Return the options of a family as fields of `Scenario`."""
    if name == "nominal" or severity == 0:
        return {}
    radius = _RADII[severity]
    # Factors from [1, 1+r] or [1/(1+r), 1] have a fixed ratio in the middle and a radius about it.
    middle = math.sqrt(1.0 + radius)
    payload = Payload(mass=_PAYLOADS[severity] * arm.m2, pick_up=3.0, drop=7.0)
    noise = Noise(*_NOISE[severity])
    torque = (_FRICTION[severity], _FRICTION[severity] / 3)
    friction = Friction(coulomb=torque, stiction=torque, v_s=1e-3)
    level = _DISTURBANCE[severity]
    disturbance = PiecewiseConstantDisturbance(amplitude=(level, level / 3), period=0.5)
    families: dict[str, dict[str, Any]] = {
        "mass-error": {"parameter_error": ParameterError(radius=radius, parameters=("m1", "m2"))},
        "length-error": {"parameter_error": ParameterError(radius=radius, parameters=("L1", "L2"))},
        "mixed-error": {"parameter_error": ParameterError(radius=radius)},
        "uniform-error": {"parameter_error": ParameterError(radius=radius, sampling="together")},
        "larger-error": {"parameter_error": ParameterError(ratio=middle, radius=middle - 1.0)},
        "smaller-error": {"parameter_error": ParameterError(ratio=1.0 / middle, radius=middle - 1.0)},
        "payload": {"parameter_error": ParameterError(payload=payload)},
        "noise": {"noise": noise},
        "stiction": {"friction": friction},
        "disturbance": {"disturbance": disturbance},
        "everything": {
            "parameter_error": ParameterError(radius=radius, payload=payload),
            "noise": noise,
            "friction": friction,
            "disturbance": disturbance,
        },
    }
    return families[name]


def families() -> dict[str, str]:
    """Return the description of each family of the leaderboard, by name."""
    return dict(_FAMILIES)


def arms() -> tuple[str, ...]:
    """Return the names of the families' arms: "table-1" and "section-2-2" of the paper."""
    return tuple(ARMS)


def family(name: str, severity: int = 0, arm: str = "table-1") -> Scenario:
    """Return the scenario of a family, named such as "mass-error-2" or "section-2-2/mass-error-2".

    Args:
        name: one of `families()`.
        severity: 0 (the nominal arm) to 3.
        arm: one of `arms()`.
    """
    check_choice("family", name, _FAMILIES)
    if isinstance(severity, bool) or severity not in SEVERITIES:
        raise ValueError(f"severity must be one of {SEVERITIES}, got {severity!r}")
    check_choice("arm", arm, ARMS)
    severity = int(severity)
    return Scenario(
        name=_member(name, severity, arm),
        description=_FAMILIES[name],
        arm=ARMS[arm],
        actuator=Actuator(torque_limit=_TORQUE_LIMITS[arm]),
        **_options(name, severity, ARMS[arm]),
    )


def _member(name: str, severity: int, arm: str) -> str:
    """Return the name of a family's scenario."""
    member = name if name == "nominal" else f"{name}-{severity}"
    return member if arm == "table-1" else f"{arm}/{member}"


class Member(NamedTuple):
    """The place of a scenario in the families.

    Attributes:
        family: its family.
        severity: 0 to 3.
        arm: the name of its arm.
        tier: one of `scenarios.TIERS`.
    """

    family: str
    severity: int
    arm: str
    tier: str = "ideal"


MEMBERS = {
    _member(name, severity, arm): Member(name, severity, arm)
    for arm in ARMS
    for name in _FAMILIES
    for severity in (SEVERITIES if name != "nominal" else (0,))
}
"""Family, severity and arm of each named scenario."""
