"""The tier `ideal`: one kind of uncertainty in each family, on an arm that is ideal otherwise."""

import functools
import math
from typing import Any

from fbl_gym.model.arm import TABLE_1, ArmParameters
from fbl_gym.records.record import merged
from fbl_gym.scenarios.families import Family, Tier

# For the default motion with each parameter between half and double and the heaviest payload, the
# arm needs 1,683 and 749 N m. Friction and disturbance add to this: at its worst corner,
# everything-3 needs some 836 N m at the second joint, more than its 800.
_TORQUE_LIMIT = (2000.0, 800.0)

_RADII = {"r": (0.25, 0.5, 1.0)}
_OWN = "each by its own factor from"


def _error(**fields: Any) -> dict[str, Any]:
    return {"parameter_error": fields}


_FAMILIES = {
    "mass-error": Family(
        f"masses off, {_OWN} [1/(1+r), 1+r]; r = 0, {{r}}", lambda r: _error(radius=r, parameters=("m1", "m2")), _RADII
    ),
    "length-error": Family(
        f"lengths off, {_OWN} [1/(1+r), 1+r]; r = 0, {{r}}", lambda r: _error(radius=r, parameters=("L1", "L2")), _RADII
    ),
    "mixed-error": Family(
        f"masses and lengths off, {_OWN} [1/(1+r), 1+r]; r = 0, {{r}}", lambda r: _error(radius=r), _RADII
    ),
    "uniform-error": Family(
        "masses and lengths off by one factor for all, drawn from [1/(1+r), 1+r]; r = 0, {r}",
        lambda r: _error(radius=r, sampling="together"), _RADII,
    ),
    "larger-error": Family(
        f"real masses and lengths larger than nominal, {_OWN} [1, 1+r]; r = 0, {{r}}",
        lambda r: _error(ratio=math.sqrt(1.0 + r), radius=math.sqrt(1.0 + r) - 1.0), _RADII,
    ),
    "smaller-error": Family(
        f"real masses and lengths smaller than nominal, {_OWN} [1/(1+r), 1]; r = 0, {{r}}",
        lambda r: _error(ratio=1.0 / math.sqrt(1.0 + r), radius=math.sqrt(1.0 + r) - 1.0), _RADII,
    ),
    "payload": Family(
        "a payload of 0, {share} times the second link's mass, picked up at the tip at 3 s and dropped at 7 s",
        lambda share: _error(payload={"mass": share * TABLE_1.m2, "pick_up": 3.0, "drop": 7.0}),
        {"share": (1 / 3, 2 / 3, 1.0)},
    ),
    "noise": Family(
        "white noise on position (0, {sigma} rad), ten times that on velocity, a hundred times on acceleration",
        lambda sigma: {"noise": {"position": sigma, "velocity": 10 * sigma, "acceleration": 100 * sigma}},
        {"sigma": (1e-4, 1e-3, 5e-3)},
    ),
    "stiction": Family(
        "Coulomb friction and as much stiction again (0, {dry} N m; a third of it on joint 2), v_s = 1e-3 (rad/s)^2",
        lambda dry: {"friction": {"coulomb": (dry, dry / 3), "stiction": (dry, dry / 3), "v_s": 1e-3}},
        {"dry": (10.0, 30.0, 60.0)},
    ),
    "disturbance": Family(
        "piecewise-constant torque within 0, {size} N m (a third of it on joint 2), a new level every 0.5 s",
        lambda size: {"disturbance": {"kind": "piecewise-constant", "amplitude": (size, size / 3), "period": 0.5}},
        {"size": (30.0, 100.0, 200.0)},
    ),
}  # fmt: skip
_EVERYTHING = ("mixed-error", "payload", "noise", "stiction", "disturbance")


def families() -> dict[str, str]:
    """Return the description of each family of the tier, by name."""
    return {
        "nominal": "the nominal arm: nothing varies but the way-points",
        **{name: family.description for name, family in _FAMILIES.items()},
        "everything": "mixed error, payload, noise, stiction and disturbance at once",
    }


def _options(family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    names = _EVERYTHING if family == "everything" else (family,)
    pushed = [_FAMILIES[name].at(severity) for name in names] if severity > 0 else []
    limit = {"torque_limit": _TORQUE_LIMIT}
    usual = {"arm": arm or TABLE_1, "description": families()[family], "actuator": limit}
    return functools.reduce(merged, pushed, usual)


TIER = Tier(
    "the paper's assumptions: no delay, no lag, exact sensors; one kind of uncertainty in each family",
    ("nominal",), (*_FAMILIES, "everything"), (0, 1, 2, 3), _options,
)  # fmt: skip
