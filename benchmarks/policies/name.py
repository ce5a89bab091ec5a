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
- "ppo-memory@2", a shipped agent of one training seed; "ppo-memory" is that with the smallest
  validation error, and on a board all of them (`benchmarks.run.suite.members`);
- "my_module:make_policy", a factory called with the interface, such as a subclass of `TorqueLaw`;
- "path/to/file.py" (its `make_policy`) or "path/to/file.py:attribute";
- "./path/to/run", a folder that `fbl-gym train` wrote;
- "path/to/model.zip", a model saved by stable-baselines3, after `external.trust`.

A registered name wins over a file or folder of the same name.
"""

import dataclasses
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.agents.agent import DESCRIPTION
from benchmarks.agents.policy import shipped
from controllers import registry
from controllers.gains import TUNINGS, read_gains, stored_gains
from controllers.registry import LawName
from fbl_gym.model.arm import ArmParameters


@dataclass(frozen=True)
class PolicyName:
    """The name of a policy, which `parse` reads from a text.

    Args:
        text: the whole text.
        form: "name" (registered, or unknown), "file", "module", "agent" (a folder), or "archive".
        source: the registered law or agent, the path, or the module.
        attribute: the factory in a file or module; empty: none is named.
        parts: with which a law is composed.
        tuned: one of `TUNINGS`, if a law has tuned gains.
        seed: training seed of a shipped agent; None: the best one.
        gains: at the end of the text: NAME=VALUE, a file, or a folder each.
    """

    text: str
    form: str
    source: str
    attribute: str = ""
    parts: tuple[str, ...] = ()
    tuned: str = ""
    seed: int | None = None
    gains: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str) -> "PolicyName":
        """Return the name that a text gives. Files tell an agent's folder from an archive's."""
        code, _, last = text.rpartition("@")
        if code and last not in TUNINGS and not last.isdigit() and not last.endswith((".py", ".zip")):
            inner = cls.parse(code)
            if inner.form in ("file", "module") or inner.source in registry.names():
                return dataclasses.replace(inner, text=text, gains=(*inner.gains, last))
        if last.isdigit() and code in shipped():
            return cls(text, "name", code, seed=int(last))
        law = LawName.parse(text)
        if law.law in registry.names():
            return cls(text, "name", law.law, parts=law.parts, tuned=law.tuned)
        composed = re.fullmatch(r"(.+\.py(?::\w+)?|[^:]+:\w+)((?:\+[\w-]+)+)", text)
        code, parts = (composed[1], tuple(composed[2][1:].split("+"))) if composed else (text, ())
        source, _, attribute = code.rpartition(":")  # a path may contain colons, as on Windows
        if not source or not attribute.isidentifier():
            source, attribute = code, ""
        if text.endswith(".zip"):
            return cls(text, "archive", text)
        if source.endswith(".py"):
            return cls(text, "file", source, attribute, parts)
        if ("/" in text or os.sep in text) and (Path(text) / DESCRIPTION).is_file():
            return cls(text, "agent", text)
        return cls(text, "module", source, attribute, parts) if ":" in text else cls(text, "name", text)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PolicyName":
        """Return the name of the plain data of `dataclasses.asdict`."""
        return cls(**{**data, "parts": tuple(data["parts"]), "gains": tuple(data["gains"])})

    @property
    def registered(self) -> str:
        """The name in the registry: LAW, LAW+PART, either with @tuned; empty: there is none."""
        return str(LawName(self.source, self.parts, self.tuned)) if self.form == "name" else ""

    @property
    def code(self) -> "PolicyName":
        """The name without the gains at its end."""
        ends = sum(len(gain) + 1 for gain in self.gains)
        return dataclasses.replace(self, text=self.text[: len(self.text) - ends], gains=())

    @property
    def law(self) -> str:
        """The text without gains, training seed and @tuned."""
        return self.code.text if self.form != "name" else "+".join((self.source, *self.parts))

    @property
    def gains_files(self) -> list[Path]:
        """The files among the gains."""
        return [stored_gains(self.code.text, gain).resolve() for gain in self.gains if "=" not in gain]

    def gains_of_other_arms(self, arm: ArmParameters) -> list[Path]:
        """Return the files of gains that are tuned for other arms than this one, as they state."""
        stated = {path: json.loads(path.read_text(encoding="utf-8")).get("arms") for path in self.gains_files}
        return [path for path, arms in stated.items() if arms and arm not in (ArmParameters(**each) for each in arms)]

    @property
    def tuned_files(self) -> dict[str, Path]:
        """The files of the gains of a tuned law, by the class of robots."""
        return LawName(self.source, self.parts, self.tuned).files if self.tuned else {}

    @property
    def given_gains(self) -> dict[str, Any]:
        """The gains at the end of the name, by name; files are read."""
        return read_gains(self.code.text, self.gains)
