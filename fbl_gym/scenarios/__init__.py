"""Scenarios by name: the paper's figures, laboratories' arms and the tiers of the leaderboards.

`get(name)` returns a scenario of the paper (`paper-3a` to `paper-10`), of a laboratory's arm
(`dfki-c1`, `dfki-a0`, `cicese`) or of a tier (`nominal`, `everything-3`, `servo-delay-2`,
`direct-surprise-knock`, `geared-practice-friction-1`). `Scenario` describes any other task, which
may stand in a TOML file (`files.py`): `get("my_arm.toml")`.
"""

from fbl_gym.options import WORLDS
from fbl_gym.scenarios.class_families import conditions
from fbl_gym.scenarios.class_tiers import held_out_reason
from fbl_gym.scenarios.files import as_scenario, get, names
from fbl_gym.scenarios.scenario import Scenario
from fbl_gym.scenarios.tiers import SEVERITIES, TIERS, Member, families, in_tier, member
from fbl_gym.scenarios.worlds import in_world

__all__ = [
    "SEVERITIES", "TIERS", "WORLDS", "Member", "Scenario", "as_scenario", "conditions", "families", "get",
    "held_out_reason", "in_tier", "in_world", "member", "names",
]  # fmt: skip
