"""Classes of stable-baselines3 and sb3-contrib, by algorithm or by archive; imported on use."""

from __future__ import annotations

import importlib
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from controllers.policy import Policy
from fbl_gym.arm import Array, gravity_torque
from fbl_gym.checks import check_choice
from fbl_gym.interface import Interface
from fbl_gym.wrappers import ErrorScales

MOTION = ("position", "velocity")
"""The sensors that a model of the error coordinates observes."""

ALGORITHMS = {
    "ppo": "stable_baselines3:PPO",
    "sac": "stable_baselines3:SAC",
    "td3": "stable_baselines3:TD3",
    "tqc": "sb3_contrib:TQC",
    "crossq": "sb3_contrib:CrossQ",
}
"""Algorithms that `fbl-gym train` knows, with the place of their class."""

_BY_NETWORK = {
    "stable_baselines3.sac.policies": "stable_baselines3:SAC",
    "stable_baselines3.td3.policies": "stable_baselines3:TD3",  # loads archives of DDPG too
    "sb3_contrib.tqc.policies": "sb3_contrib:TQC",
    "sb3_contrib.crossq.policies": "sb3_contrib:CrossQ",
    "sb3_contrib.ars.policies": "sb3_contrib:ARS",
    "sb3_contrib.common.recurrent.policies": "sb3_contrib:RecurrentPPO",
    **{f"sbx.{name.lower()}.policies": f"sbx:{name}" for name in ("PPO", "SAC", "TD3", "DDPG", "TQC", "CrossQ")},
}
"""The class that loads an archive, by the module of the archive's network."""

_SHARED_NETWORK = "stable_baselines3.common.policies"
"""Module of the network that PPO, A2C and TRPO share."""

_BY_SETTING = {"clip_range": "stable_baselines3:PPO", "cg_max_steps": "sb3_contrib:TRPO"}
"""The class that loads an archive with the shared network, by a setting that no other has."""


def find_class(algorithm: str) -> Any:
    """Return the class of one of `ALGORITHMS`."""
    return _import(algorithm, ALGORITHMS[check_choice("algorithm", algorithm, ALGORITHMS)])


def _import(user: str, place: str) -> Any:
    module, name = place.split(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as problem:
        package = "sbx-rl" if module == "sbx" else "'fbl-gym[rl]'"
        raise ValueError(f"{user} needs {problem.name}, which is not installed: pip install {package}") from problem


def load_zip(path: str | Path, interface: Interface, trust: bool = False) -> Policy:
    """Return an archive of SB3's `save` as a policy.

    The model must be trained on the observations and actions of `fbl_gym/TwoLinkArmTracking-v0` or
    `fbl_gym/TwoLinkArm-v0`. Loading it runs the pickled code in it: `trust` says that you trust its
    source.
    """
    if not trust:
        raise ValueError(
            f"loading {str(path)!r} runs the code in it: give trust=True if you trust its source, got {trust!r}"
        )
    algorithm = _class_of(path)
    try:
        model = algorithm.load(path, device="cpu")
    except ModuleNotFoundError as problem:
        raise ValueError(f"{path} needs the module {problem.name}, which is not installed") from problem
    except Exception as problem:  # of SB3, torch, zipfile, pickle or the archive's code
        raise ValueError(
            f"{path} must be an archive that stable-baselines3's save wrote ({type(problem).__name__}: {problem})"
        ) from None
    if (past_actions := _tracked(model, interface)) is not None:
        return TrackingModel(model, interface, past_actions)
    _check_spaces(model, interface)
    return model


class TrackingModel:
    """A model of `fbl_gym/TwoLinkArmTracking-v0` as a policy of `fbl_gym/TwoLinkArm-v0`.

    It works with every arm, drive and sensor that has a position, since it remembers its previous
    actions by itself. Its state is these actions [n x 2 k], and the model's own state.
    """

    def __init__(self, model: Any, interface: Interface, past_actions: int) -> None:
        self._model, self._interface, self._past_actions = model, interface, past_actions
        self._errors = ErrorScales(interface, MOTION)

    def predict(
        self, observation: Array, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, Any]:
        """Return the action and the next state, as `controllers.policy.Policy.predict`."""
        batch = np.atleast_2d(np.asarray(observation, dtype=float))
        past, inner = (self._first_actions(batch), None) if state is None else state
        if state is not None and episode_start is not None:
            starts = np.broadcast_to(np.asarray(episode_start, dtype=bool), len(batch))
            past = np.where(starts[:, None], self._first_actions(batch), past)
        errors = np.concatenate([self._errors(batch), past], axis=-1).astype(np.float32)
        action, inner = self._model.predict(errors, inner, episode_start, deterministic)
        past = np.concatenate([action, past], axis=-1)[:, : past.shape[1]]
        return (action if np.ndim(observation) == 2 else action[0]), (past, inner)

    def _first_actions(self, observation: Array) -> Array:
        """Return the action that holds the nominal arm still, as often as it is observed."""
        position = observation[:, self._interface.layout["position"]]
        torque = gravity_torque(self._interface.nominal, position)
        action = self._interface.action_from_torque(torque, position, np.zeros_like(position))
        return np.tile(action, self._past_actions)


def _tracked(model: Any, interface: Interface) -> int | None:
    """Return the number of previous actions in a model's error coordinates; None: it has others."""
    bound = np.ravel(getattr(model.observation_space, "high", ()))
    errors = ErrorScales(interface, MOTION).space.high
    past_actions, odd = divmod(len(bound) - len(errors), 2)
    expected = np.append(errors, np.ones(max(2 * past_actions, 0)))
    if odd or interface.action != "normalized" or not np.array_equal(bound, expected):
        return None
    _check_space(model, interface, "action_space", 'action="normalized"')
    return past_actions


def _class_of(path: str | Path) -> Any:
    """Return the class that wrote an archive, without running the archive's code."""
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
        module = str(data["policy_class"]["__module__"])
    except (zipfile.BadZipFile, zlib.error, LookupError, OSError, RuntimeError, TypeError, ValueError) as problem:
        raise ValueError(f"{path} must be an archive that stable-baselines3's save wrote ({problem})") from None
    if module == _SHARED_NETWORK:
        place = next((place for key, place in _BY_SETTING.items() if key in data), "stable_baselines3:A2C")
    elif module in _BY_NETWORK:
        place = _BY_NETWORK[module]
    elif "clip_range" in data and not module.startswith("sb3_contrib."):
        place = "stable_baselines3:PPO"  # with a network from outside SB3
    else:
        known = ", ".join(sorted({place.partition(":")[2] for place in _BY_NETWORK.values()} | {"PPO", "A2C", "TRPO"}))
        raise ValueError(f"{path} must hold a model of one of {known}, got one whose network is of {module}")
    return _import(str(path), place)


def _check_spaces(model: Any, interface: Interface) -> None:
    """Refuse a model with other observations or actions; their precision may differ."""
    observations = "the observations of fbl_gym/TwoLinkArmTracking-v0 or fbl_gym/TwoLinkArm-v0, without other wrappers"
    _check_space(model, interface, "observation_space", observations)
    _check_space(model, interface, "action_space", f'action="{interface.action}"')


def _check_space(model: Any, interface: Interface, name: str, advice: str) -> None:
    given, expected = getattr(model, name), getattr(interface, name)
    if given.shape != expected.shape:
        raise ValueError(
            f"the model's {name} must have the environment's shape {expected.shape}, got {given.shape}: "
            f"train it with {advice}"
        )
    if not all(np.allclose(getattr(given, end), getattr(expected, end), rtol=1e-5) for end in ("low", "high")):
        raise ValueError(
            f"the model's {name} must have the environment's bounds, {_bounds(expected)}, got {_bounds(given)}: "
            f"train it with {advice}"
        )


def _bounds(space: Any) -> str:
    """Return the different bounds of a box as text, such as "-2000 to 2000, -800 to 800"."""
    ends = [f"{low:.6g} to {high:.6g}" for low, high in zip(space.low.ravel(), space.high.ravel(), strict=True)]
    return ", ".join(dict.fromkeys(ends))
