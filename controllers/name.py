"""The name of a policy: its text, parsed once into a record.

The text is one of:

- a registered name, such as "cascade-flm", or an entry point `fbl_gym.policies` of an installed
  package;
- "cascade-flm@servo", with the gains for a class of robots, or "cascade-flm@tuned", with those for
  the class of the robot at hand;
- "cascade-flm+kalman+predictor" or "my_law.py+barrier", a law composed with parts, also with
  "@tuned";
- a law with gains at the end, after its parts: "cascade-flm@K=30", "my_law.py@K=30,20@F=10",
  "cascade-flm@tuned@K=0.5x" for half the tuned or default gain, or those of a file:
  "pid-flm@my_gains.json", or "pid-flm@my_arm", which is my_arm/pid-flm.json;
- "ppo-blend@2", a shipped agent of one training seed; "ppo-blend" is that with the smallest
  validation error, and on a board all of them (`benchmarks.run.expansion.members`);
- "my_module:make_policy", a factory called with the interface, such as a subclass of `TorqueLaw`;
- "path/to/file.py" (its `make_policy`) or "path/to/file.py:attribute";
- "./path/to/run", a folder that `fbl-gym train` wrote;
- "path/to/model.zip", a model saved by stable-baselines3.

The form follows from the text alone: no file is looked for, and a bare name is always a registered
one.
"""

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.parts import PARTS
from fbl_gym.model.arm import ArmParameters
from fbl_gym.reading import read_bytes
from fbl_gym.scenarios.classes import CLASSES

#: Folder of tuned gains: `fbl-gym tune POLICY --class CLASS --ship` writes CLASS/POLICY.json.
TUNED = Path(__file__).with_name("tuned")

#: Names of tuned gains: those for the class of the robot at hand, or for a given class.
TUNINGS = ("tuned", *CLASSES)

#: The forms of a name, each with the text of its code; the first that fits counts.
FORMS = {
    "archive": r"(?P<source>.+\.zip)",
    "file": r"(?P<source>.+\.py)(?::(?P<attribute>\w+))?",
    "name": r"(?P<source>[^@+:/\\]+)",
    "module": r"(?P<source>[^:]+):(?P<attribute>[^\W\d]\w*)",
    "folder": r"(?P<source>.*[/\\].*)",
}

_ENDS = r"(?P<parts>(?:\+[\w-]+)*)(?P<gains>(?:@.*)?)"


@dataclass(frozen=True)
class PolicyName:
    """The name of a policy, which `parse` reads from a text and `str` writes.

    Args:
        form: one of `FORMS`.
        source: the registered name, the path, or the module.
        attribute: the factory in a file or module; empty: none is named.
        parts: with which a law is composed.
        tuned: one of `TUNINGS`, if a law has tuned gains.
        seed: training seed of a shipped agent; None: the best one.
        gains: at the end of the text: NAME=VALUE, a file, or a folder each.
        origin: the file that names the policy; empty: a person did.
        trusted: True if its code may run, though it is an archive or a file names it.
    """

    form: str
    source: str
    attribute: str = ""
    parts: tuple[str, ...] = ()
    tuned: str = ""
    seed: int | None = None
    gains: tuple[str, ...] = ()
    origin: str = field(default="", compare=False)
    trusted: bool = field(default=False, compare=False)

    @classmethod
    def parse(cls, text: str, origin: str = "", trusted: bool = False) -> "PolicyName":
        """Return the name that a text gives."""
        matches = ((form, re.fullmatch(code + _ENDS, text, re.DOTALL)) for form, code in FORMS.items())
        form, match = next((each for each in matches if each[1]), ("name", None))
        found = defaultdict(str, match.groupdict("") if match else {"source": text})
        gains = found["gains"].split("@")[1:]
        tuned = gains.pop(0) if gains and gains[0] in TUNINGS else ""
        seed = int(gains.pop(0)) if form == "name" and gains and gains[0].isdecimal() else None
        parts = tuple(found["parts"].split("+")[1:])
        return cls(form, found["source"], found["attribute"], parts, tuned, seed, tuple(gains), origin, trusted)

    def __str__(self) -> str:
        """Return the whole text."""
        seed = () if self.seed is None else (str(self.seed),)
        return "@".join((self.law, *filter(None, (self.tuned,)), *seed, *self.gains))

    @property
    def law(self) -> str:
        """The text without gains, training seed and @tuned."""
        return "+".join((f"{self.source}:{self.attribute}".removesuffix(":"), *self.parts))

    @property
    def code(self) -> "PolicyName":
        """The name without the gains at its end."""
        return replace(self, gains=())

    @property
    def tuned_files(self) -> dict[str, Path]:
        """The files of the gains of a tuned law, by the class of robots."""
        classes = CLASSES if self.tuned == "tuned" else filter(None, (self.tuned,))
        files = {robot: stored_gains(self.law, TUNED / robot) for robot in classes}
        return {robot: file for robot, file in files.items() if file.is_file()}

    def robot_of(self, robot: str) -> str:
        """Return the class whose tuned gains a robot of a class gets; "": the first with gains."""
        return robot or next(iter(self.tuned_files), "") if self.tuned == "tuned" else self.tuned

    @property
    def gains_files(self) -> list[Path]:
        """The files among the gains."""
        return [stored_gains(self.law, gain).resolve() for gain in self.gains if "=" not in gain]

    def gains_of_other_arms(self, arm: ArmParameters) -> list[Path]:
        """Return the files of gains that are tuned for other arms than this one, as they state."""
        stated = {path: json.loads(read_bytes(path)).get("arms") for path in self.gains_files}
        return [path for path, arms in stated.items() if arms and arm not in (ArmParameters(**each) for each in arms)]

    @property
    def given_gains(self) -> dict[str, Any]:
        """The gains at the end of the name, by name, with the training seed; files are read.

        The last value counts. A `Multiple` is of the value before it; the first value may be one,
        which `registry.make` resolves.
        """
        gains: dict[str, Any] = {} if self.seed is None else {"seed": self.seed}
        for text in self.gains:
            before = with_fewer_parts(text)[-1]
            if before != text and not Path(text).exists():
                end = text.removeprefix(before)
                raise ValueError(f"the parts of a law come before its gains: {self.law}{end}@{before}")
            if "=" in text:
                name, value = parse_gain(text)
                gains[name] = value.of(name, gains[name]) if name in gains and isinstance(value, Multiple) else value
            else:
                gains |= _read_gains(self.law, stored_gains(self.law, text))
        return gains


class Multiple(str):
    """A multiple of the gain that a law would else have, such as "0.5x" or, per joint, "0.5,2x"."""

    def of(self, name: str, gain: Any) -> Any:
        """Return the multiple of a gain; raise a `ValueError` unless that is a number or two."""
        if isinstance(gain, Multiple):
            both = np.ravel(_numbers(self.removesuffix("x")) * np.array(_numbers(gain.removesuffix("x"))))
            return Multiple(",".join(map(str, both.tolist())) + "x")
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


def _read_gains(law: str, path: Path) -> dict[str, Any]:
    try:
        data = json.loads(read_bytes(path))
        given = data.get("gains", data).items()
        values = {name: np.array(value) if isinstance(value, list) else float(value) for name, value in given}
    except FileNotFoundError:
        raise ValueError(f"gains of {law}: there is no file {path}; `fbl-gym tune` writes one") from None
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
        raise ValueError(f'{path} must be JSON with numbers, such as {{"kp": 25}}: {problem}') from None
    expect_law(law, path, data)
    return values


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
