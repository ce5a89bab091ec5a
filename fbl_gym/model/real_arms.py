"""Arms that stand in laboratories; `real_arms.toml` has their numbers, with sources."""

import tomllib
from pathlib import Path

from fbl_gym.model.arm import Links

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))

#: The arms of laboratories, by name.
REAL_ARMS = {name: Links(**links).arm for name, links in _TABLES.items()}
