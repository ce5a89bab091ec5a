"""The gains at the end of a policy's name, as in "cascade-flm@K=30" or "cascade-flm@my_gains"."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from controllers.composition import PARTS
from fbl_gym.reading import read_bytes
from fbl_gym.scenarios.classes import CLASSES

TUNINGS = ("tuned", *CLASSES)
"""Names of tuned gains: those for the class of the robot at hand, or for a given class."""


class Multiple(str):
    """A multiple of the gain that a law would else have, such as "0.5x" or, per joint, "0.5,2x"."""

    def of(self, name: str, gain: Any) -> Any:
        """Return the multiple of a gain; raise a `ValueError` unless that is a number or two."""
        if not isinstance(gain, int | float | tuple | np.ndarray):
            raise ValueError(f"{name} must be a number, since there is no tuned or default one, got {self}")
        return _numbers(self.removesuffix("x")) * np.array(gain)


def parse_gain(text: str) -> tuple[str, Any]:
    """Return a gain and its value, of "kp=25", "kp=25,30" for the two joints, or "kp=0.5x"."""
    name, _, value = text.partition("=")
    try:
        numbers = _numbers(value.removesuffix("x"))
    except ValueError:
        name = ""
    if not name:
        forms = "kp=25, kp=25,30 for the two joints, or kp=0.5x for half the tuned or default gain"
        raise ValueError(f"must be such as {forms}, got {text!r}")
    return name, Multiple(value) if value.endswith("x") else numbers


def _numbers(text: str) -> Any:
    """Return one number or, of "25,30", two."""
    first, *second = map(float, text.split(",", 1))
    return np.array([first, *second]) if second else first


def gains_file(law: str, path: str | Path) -> Path:
    """Return the file with the gains of a law: a .json file itself, or LAW.json in a folder."""
    name = re.sub(r"[^\w.+-]+", "_", Path(law).name) + ".json"
    return Path(path) if str(path).endswith(".json") else Path(path) / name


def with_fewer_parts(law: str) -> list[str]:
    """Return the name of a law with all its parts, then with one less at a time, last with none."""
    names = [law]
    while names[-1].rpartition("+")[2] in PARTS and "+" in names[-1]:
        names.append(names[-1].rpartition("+")[0])
    return names


def stored_gains(law: str, path: str | Path) -> Path:
    """Return the file as `gains_file`; where a folder has none for LAW+PART, that of LAW."""
    files = [gains_file(name, path) for name in with_fewer_parts(law)]
    return next((file for file in files if file.is_file()), files[0])


def read_gains(law: str, given: tuple[str, ...]) -> dict[str, Any]:
    """Return the gains of a law, of NAME=VALUE, a file or a folder each; the last value counts.

    A number is the training seed of a shipped agent. A `Multiple` is of the value before it; the
    first value may be one, which `registry.make` resolves.
    """
    gains: dict[str, Any] = {}
    for text in given:
        before = with_fewer_parts(text)[-1]
        if before != text and not Path(text).exists():
            raise ValueError(f"the parts of a law come before its gains: {law}{text.removeprefix(before)}@{before}")
        if "=" in text:
            name, value = parse_gain(text)
            gains[name] = value.of(name, gains[name]) if name in gains and isinstance(value, Multiple) else value
            continue
        if text.isdigit():
            gains["seed"] = int(text)
            continue
        path = stored_gains(law, text)
        try:
            data = json.loads(read_bytes(path))
            values = {
                name: np.array(value) if isinstance(value, list) else float(value)
                for name, value in data.get("gains", data).items()
            }
        except FileNotFoundError:
            raise ValueError(f"gains of {law}: there is no file {path}; `fbl-gym tune` writes one") from None
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
            raise ValueError(f'{path} must be JSON with numbers, such as {{"kp": 25}}: {problem}') from None
        expect_law(law, path, data)
        gains |= values
    return gains


def expect_law(law: str, path: Path, data: Mapping[str, Any]) -> None:
    """Refuse the gains of a file that names another law.

    A law in a file is the same law where one of both paths ends with the other. The gains of a law
    are also those of the law with parts, whose gains are then the defaults.
    """
    tuned = data.get("policy", law)
    if not any(_is_same(str(tuned), name) for name in with_fewer_parts(law)):
        raise ValueError(f"{path} has the gains of {tuned}, not of {law}: name another file or folder")


def _is_same(law: str, other: str) -> bool:
    """Return True if one of two paths ends with the other."""
    parts = zip(*(reversed([x for x in Path(name).parts if x != ".."]) for name in (law, other)), strict=False)
    return all(one == two for one, two in parts)


def split_gains(text: str) -> tuple[str, tuple[str, ...]]:
    """Return a policy's name without the gains at its end, and the text of each of these."""
    name, *gains = re.split(f"@(?!(?:{'|'.join(TUNINGS)})(?:@|$))", text)
    return name, tuple(gains)
