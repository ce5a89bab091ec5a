"""The gains at the end of a policy's name, as in "cascade-flm@K=30" or "cascade-flm@my_gains"."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from controllers.composition import PARTS
from fbl_gym.scenarios.classes import CLASSES

TUNINGS = ("tuned", *CLASSES)
"""Names of tuned gains: those for the class of the robot at hand, or for a given class."""


def parse_gain(text: str) -> tuple[str, Any]:
    """Return a gain and its value, of "kp=25" or, with one number for each joint, "kp=25,30"."""
    name, _, value = text.partition("=")
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if not name or len(numbers) not in (1, 2):
        raise ValueError(f"must be such as kp=25, or kp=25,30 for the two joints, got {text!r}")
    return name, numbers[0] if len(numbers) == 1 else np.array(numbers)


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

    A number is the training seed of a shipped agent.
    """
    gains: dict[str, Any] = {}
    for text in given:
        before = with_fewer_parts(text)[-1]
        if before != text and not Path(text).exists():
            raise ValueError(f"the parts of a law come before its gains: {law}{text.removeprefix(before)}@{before}")
        if "=" in text:
            gains.update([parse_gain(text)])
            continue
        if text.isdigit():
            gains["seed"] = int(text)
            continue
        path = stored_gains(law, text)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
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
