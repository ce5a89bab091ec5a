"""Classes of stable-baselines3 and sb3-contrib, by algorithm or by archive; imported on use."""

import importlib
import json
import pickle
import re
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.text import reason_of, refusing
from controllers.base import Policy
from fbl_gym.envs.error_scales import WIDEST, ErrorScales
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array, gravity_torque

MOTION = ("position", "velocity")  # the sensors that a model of the error coordinates observes

_SB3, _CONTRIB = "stable_baselines3", "sb3_contrib"

# Algorithms that `fbl-gym train` takes from SB3, with the package of their class.
ALGORITHMS = {"sb3-ppo": _SB3, "sac": _SB3, "td3": _SB3, "tqc": _CONTRIB, "crossq": _CONTRIB}


_NO_ARCHIVE = "must be an archive that stable-baselines3's save wrote"


def find_class(algorithm: str, package: str = "", user: str | Path = "") -> Any:
    """Return the class of an algorithm, whose name is in lower case.

    Args:
        algorithm: one of `ALGORITHMS`, or any of the package.
        package: of the class; empty: that of `ALGORITHMS`.
        user: what needs the class, for errors; empty: the algorithm.
    """
    package, user = package or ALGORITHMS[algorithm], user or algorithm
    algorithm = algorithm.removeprefix("sb3-")
    try:
        return {name.lower(): value for name, value in vars(importlib.import_module(package)).items()}[algorithm]
    except ModuleNotFoundError as problem:
        install = "sbx-rl" if package == "sbx" else "'fbl-gym[rl]'"
        raise ValueError(f"{user} needs {problem.name}, which is not installed: pip install {install}") from problem
    except KeyError:
        raise ValueError(f"{user} needs {algorithm} of {package}, which has no such algorithm") from None


def load_zip(path: str | Path, interface: Interface, trust: bool = False) -> Policy:
    """Return an archive of SB3's `save` as a policy.

    The model must be trained on the observations and actions of `fbl_gym/TwoLinkArm-v0` or
    `fbl_gym/TwoLinkArmTracking-v0`, the latter also in stacks of Gymnasium's
    `FrameStackObservation` or SB3's `VecFrameStack`. With `preview=n`, the interface must have
    the same. Observations are scaled by the `statistics` of SB3's `VecNormalize`, if there are
    some. Loading runs the pickled code in both files: `trust` says that you trust their source.
    """
    if not trust:
        raise ValueError(f"loading {str(path)!r} runs the code in it: give trust=True if you trust it, got {trust!r}")
    algorithm = _class_of(path)
    try:
        model = algorithm.load(path, device="cpu")
    except ModuleNotFoundError as problem:
        raise ValueError(f"{path} needs the module {problem.name}, which is not installed") from problem
    except Exception as problem:  # of SB3, torch, zipfile, pickle or the archive's code
        raise ValueError(f"{path} {_NO_ARCHIVE}: {reason_of(problem)}") from None
    for saved in statistics(Path(path)):
        with refusing(f"{saved} must be a file that VecNormalize's save wrote"):  # errors of pickle, or the file's code
            model = NormalizedModel(model, pickle.loads(saved.read_bytes()))
    if (tracked := _tracked(model, interface)) is not None:
        return TrackingModel(model, interface, *tracked)
    seen = "TwoLinkArmTracking-v0 (with history or stacked frames, not both) or TwoLinkArm-v0, with the same preview"
    _check_space(model, interface, "observation_space", seen)
    _check_space(model, interface, "action_space", f'action="{interface.action}"')
    return model


def archive_factory(path: Path) -> Callable[..., Any]:
    """Return the factory of the model in an archive whose source is trusted."""

    def factory(interface: Interface) -> Policy:
        return load_zip(path, interface, trust=True)

    vars(factory).update(kind="learned", needs=MOTION, packages=("torch",), data_files=(path, *statistics(path)))
    return factory


def statistics(path: Path) -> list[Path]:
    """Return the file of `VecNormalize` that belongs to an archive, or an empty list.

    The nearest counts: that of the same checkpoint (SB3's `CheckpointCallback`), `vecnormalize.pkl`
    in the folder of the archive's name (rl_zoo3), and `vecnormalize.pkl` beside the archive.
    """
    checkpoint = re.sub(r"(\d+_steps)$", r"vecnormalize_\1.pkl", path.stem)  # else the stem, which is no such file
    names = (checkpoint, f"{path.stem}/vecnormalize.pkl", "vecnormalize.pkl")
    return [file for file in map(path.parent.joinpath, names) if file.is_file()][:1]


class NormalizedModel:
    """A model behind SB3's `VecNormalize`, whose statistics are of an observation or of a frame."""

    def __init__(self, model: Any, normalize: Any) -> None:
        self.observation_space, self.action_space = model.observation_space, model.action_space
        self._model, self._normalize = model, normalize.normalize_obs
        self._frame = np.shape(normalize.obs_rms.mean) if normalize.norm_obs else model.observation_space.shape
        if np.prod(model.observation_space.shape) % np.prod(self._frame):
            right = model.observation_space.shape
            raise ValueError(f"its statistics must have the observation's shape {right}, got {self._frame}")

    def predict(self, observation: Array, *arguments: Any, **named: Any) -> tuple[Array, Any]:
        """Return the action and the next state of the model."""
        frames = np.reshape(observation, (-1, *self._frame))
        empty = (frames == 0.0).reshape(len(frames), -1).all(axis=1)  # VecFrameStack begins with zeros
        frames = np.where(empty.reshape(-1, *[1] * len(self._frame)), 0.0, self._normalize(frames))
        return self._model.predict(frames.reshape(np.shape(observation)), *arguments, **named)


class TrackingModel:
    """A model of `fbl_gym/TwoLinkArmTracking-v0` as a policy of `fbl_gym/TwoLinkArm-v0`.

    It works with every arm, drive and sensor that has a position, since it remembers its previous
    actions and its stack of frames by itself. Its state is these actions [n x 2 k], these frames
    [n x frames x size], and the model's own state.
    """

    def __init__(self, model: Any, interface: Interface, errors: ErrorScales, past_actions: int) -> None:
        self._model, self._interface, self._errors, self._past_actions = model, interface, errors, past_actions
        self._shape = model.observation_space.shape
        self._padding = np.float32(len(self._shape) == 2)  # VecFrameStack, of one axis, starts from zeros

    def predict(
        self, observation: Array, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, Any]:
        """Return the action and the next state, as `controllers.base.Policy.predict`."""
        batch = np.atleast_2d(np.asarray(observation, dtype=float))
        past, frames, inner = (0.0, 0.0, None) if state is None else state
        begins = state is None or (False if episode_start is None else episode_start)
        starts = np.broadcast_to(begins, len(batch))[:, None]
        past = np.where(starts, self._first_actions(batch), past)
        errors = np.concatenate([self._errors(batch), past], axis=-1).astype(np.float32)[:, None]
        first = np.repeat(self._padding * errors, np.prod(self._shape) // errors.shape[-1], axis=1)
        frames = np.concatenate([np.where(starts[..., None], first, frames)[:, 1:], errors], axis=1)
        action, inner = self._model.predict(frames.reshape(-1, *self._shape), inner, episode_start, deterministic)
        past = np.concatenate([action, past], axis=-1)[:, : past.shape[1]]
        return (action if np.ndim(observation) == 2 else action[0]), (past, frames, inner)

    def _first_actions(self, observation: Array) -> Array:
        """Return the action that holds the nominal arm still, as often as it is observed."""
        position = observation[:, self._interface.layout["position"]]
        torque = gravity_torque(self._interface.nominal, position)
        action = self._interface.action_from_torque(torque, position, np.zeros_like(position))
        return np.tile(action, self._past_actions)


def _tracked(model: Any, interface: Interface) -> tuple[ErrorScales, int] | None:
    """Return a model's error coordinates and number of previous actions; None: it has others.

    The bounds of its observations state the options of `TwoLinkArmTrackingEnv`.
    """
    high = np.asarray(getattr(model.observation_space, "high", ()))
    scales = partial(ErrorScales, interface, (*MOTION, "preview"))
    for drive in (False, True) if interface.action == "normalized" else ():
        bounds = scales(drive=drive).space.high
        frames = max(1, int(np.sum(high != 1.0)) // int(np.sum(bounds != 1.0)))
        past_actions = max(0, high.size // frames - len(bounds)) // 2
        for place in (2, 2 * frames):  # of the velocity: VecFrameStack repeats each bound, though it joins frames
            ends = high.ravel()[0 : place + 1 : place]
            fine = None if np.all(ends == bounds[0]) else WIDEST / np.sinh(np.clip(ends, 0.1, 99.0), dtype=float)
            errors = scales(fine=fine, drive=drive)
            frame = np.append(errors.space.high, np.ones(2 * past_actions, np.float32))
            stacks = np.tile(frame, (frames, 1)), np.tile(frame, frames), np.repeat(frame, frames)
            if any(np.array_equal(high, stack) for stack in stacks):
                _check_space(model, interface, "action_space", 'action="normalized"')
                return errors, past_actions
    return None


def _class_of(path: str | Path) -> Any:
    """Return the class that wrote an archive, without running the archive's code."""
    with refusing(f"{path} {_NO_ARCHIVE}"), zipfile.ZipFile(path) as archive:  # errors of zipfile, zlib or json
        data = json.loads(archive.read("data"))
        module = str(data["policy_class"]["__module__"])
    # SAC's network is of stable_baselines3.sac.policies; PPO, A2C and TRPO share another module.
    parts = module.split(".")
    package, folder = parts[0], parts[-2:][0]
    if "cg_max_steps" in data:
        package, folder = _CONTRIB, "trpo"
    elif "clip_range" in data and package != _CONTRIB:  # perhaps with a network from outside SB3
        package, folder = "sbx" if package == "sbx" else _SB3, "ppo"
    if package not in (_SB3, _CONTRIB, "sbx"):
        raise ValueError(f"{path} must be of stable-baselines3, sb3-contrib or sbx, got a network of {module}")
    return find_class({"common": "a2c", "recurrent": "recurrentppo"}.get(folder, folder), package, path)


def _check_space(model: Any, interface: Interface, name: str, advice: str) -> None:
    """Refuse a model with other observations or actions; their precision may differ."""
    given, want = getattr(model, name), getattr(interface, name)
    if given.shape != want.shape or not np.allclose((given.low, given.high), (want.low, want.high), rtol=1e-5):
        raise ValueError(f"the model's {name} must be {_words(want)}, got {_words(given)}: train it with {advice}")


def _words(space: Any) -> str:
    """Return the shape and the different bounds of a box as text, such as "(2,) of -1 to 1"."""
    ends = [f"{low:.6g} to {high:.6g}" for low, high in zip(space.low.ravel(), space.high.ravel(), strict=True)]
    return f"{space.shape} of {', '.join(dict.fromkeys(ends))}"
