"""The tier `ideal`: one kind of uncertainty in each family, on an arm that is ideal otherwise."""

import math
from typing import Any

from fbl_gym.model.arm import TABLE_1
from fbl_gym.options import Actuator
from fbl_gym.scenarios.families import Family, Member, combined
from fbl_gym.scenarios.scenario import Scenario

SEVERITIES = (0, 1, 2, 3)

# For the default motion with each parameter between half and double and the heaviest payload, the
# arm needs 1,683 and 749 N m. Friction and disturbance add to this: at its worst corner,
# everything-3 needs some 836 N m at the second joint, more than its 800.
_TORQUE_LIMIT = (2000.0, 800.0)

_RADII = ((0.25, 0.5, 1.0),)
_OWN = "each by its own factor from"


def _error(**fields: Any) -> dict[str, Any]:
    return {"parameter_error": fields}


_FAMILIES = {
    "nominal": Family("the nominal arm: nothing varies but the way-points", (), lambda _: {}),
    "mass-error": Family(
        f"masses off, {_OWN} [1/(1+r), 1+r]; r = 0, {{}}", _RADII,
        lambda _, r: _error(radius=r, parameters=("m1", "m2")),
    ),
    "length-error": Family(
        f"lengths off, {_OWN} [1/(1+r), 1+r]; r = 0, {{}}", _RADII,
        lambda _, r: _error(radius=r, parameters=("L1", "L2")),
    ),
    "mixed-error": Family(
        f"masses and lengths off, {_OWN} [1/(1+r), 1+r]; r = 0, {{}}", _RADII, lambda _, r: _error(radius=r),
    ),
    "uniform-error": Family(
        "masses and lengths off by one factor for all, drawn from [1/(1+r), 1+r]; r = 0, {}", _RADII,
        lambda _, r: _error(radius=r, sampling="together"),
    ),
    "larger-error": Family(
        f"real masses and lengths larger than nominal, {_OWN} [1, 1+r]; r = 0, {{}}", _RADII,
        lambda _, r: _error(ratio=math.sqrt(1.0 + r), radius=math.sqrt(1.0 + r) - 1.0),
    ),
    "smaller-error": Family(
        f"real masses and lengths smaller than nominal, {_OWN} [1/(1+r), 1]; r = 0, {{}}", _RADII,
        lambda _, r: _error(ratio=1.0 / math.sqrt(1.0 + r), radius=math.sqrt(1.0 + r) - 1.0),
    ),
    "payload": Family(
        "a payload of 0, {} times the second link's mass, picked up at the tip at 3 s and dropped at 7 s",
        ((1 / 3, 2 / 3, 1.0),), lambda arm, share: _error(payload={"mass": share * arm.m2, "pick_up": 3.0, "drop": 7.0}),
    ),
    "noise": Family(
        "white noise on position (0, {} rad), ten times that on velocity, a hundred times on acceleration",
        ((1e-4, 1e-3, 5e-3),),
        lambda _, sigma: {"noise": {"position": sigma, "velocity": 10 * sigma, "acceleration": 100 * sigma}},
    ),
    "stiction": Family(
        "Coulomb friction and as much stiction again (0, {} N m; a third of it on joint 2), v_s = 1e-3 (rad/s)^2",
        ((10.0, 30.0, 60.0),),
        lambda _, dry: {"friction": {"coulomb": (dry, dry / 3), "stiction": (dry, dry / 3), "v_s": 1e-3}},
    ),
    "disturbance": Family(
        "piecewise-constant torque within 0, {} N m (a third of it on joint 2), a new level every 0.5 s",
        ((30.0, 100.0, 200.0),),
        lambda _, size: {"disturbance": {"kind": "piecewise-constant", "amplitude": (size, size / 3), "period": 0.5}},
    ),
    "everything": Family("mixed error, payload, noise, stiction and disturbance at once", (), lambda _: {}),
}  # fmt: skip
_EVERYTHING = ("mixed-error", "payload", "noise", "stiction", "disturbance")


def families() -> dict[str, str]:
    """Return the description of each family of the leaderboard, by name."""
    return {name: family.description for name, family in _FAMILIES.items()}


MEMBERS = {
    "nominal": Member("nominal", 0),
    **{f"{name}-{k}": Member(name, k) for name in _FAMILIES if name != "nominal" for k in SEVERITIES},
}
"""Family and severity of each named scenario."""


def get(name: str) -> Scenario:
    """Return the scenario of a name, one of `MEMBERS`."""
    family, severity, _ = MEMBERS[name]
    families = _EVERYTHING if family == "everything" else (family,)
    return Scenario(
        name=name,
        description=_FAMILIES[family].description,
        actuator=Actuator(torque_limit=_TORQUE_LIMIT),
        **(combined(_FAMILIES, families, severity, TABLE_1) if severity > 0 else {}),
    )
