"""An uncertain two-link arm for control and reinforcement learning.

Importing this package registers `fbl_gym/TwoLinkArm-v0` with Gymnasium;
`fbl_gym/TwoLinkArmTracking-v0`, the same with observations for learning agents; and
`fbl_gym/TwoLinkArmMuJoCo-v0`, the same with MuJoCo's physics.
"""

from fbl_gym.neighbours import IS_COMMAND, warn_of_hidden

# A command that is stopped during the imports below says so in one line.
# isort: split
from gymnasium.envs.registration import register

from fbl_gym import options, scenarios
from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.envs.tracking import TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.interface import Interface, Layout
from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import SECTION_2_2, TABLE_1, ArmParameters
from fbl_gym.options import *  # noqa: F403 - the records that `options.__all__` lists
from fbl_gym.records import Distribution
from fbl_gym.scenarios import Scenario

__version__ = "0.1.0"

__all__ = [
    "SECTION_2_2", "TABLE_1", "ArmParameters", "Distribution", "Interface", "Layout", "Scenario", "Truth", "TwoLinkArmEnv",
    "TwoLinkArmTrackingEnv", "TwoLinkArmTrackingVectorEnv", "TwoLinkArmVectorEnv", "scenarios",
]  # fmt: skip
__all__ += options.__all__

_ENV, _VECTOR_ENV = "fbl_gym.envs.env:TwoLinkArmEnv", "fbl_gym.envs.vector_env:TwoLinkArmVectorEnv"
register(id="fbl_gym/TwoLinkArm-v0", entry_point=_ENV, vector_entry_point=_VECTOR_ENV)
register(id="fbl_gym/TwoLinkArmMuJoCo-v0", entry_point=_ENV, vector_entry_point=_VECTOR_ENV, kwargs={"plant": "mujoco"})
register(
    id="fbl_gym/TwoLinkArmTracking-v0",
    entry_point="fbl_gym.envs.tracking:TwoLinkArmTrackingEnv",
    vector_entry_point="fbl_gym.envs.tracking:TwoLinkArmTrackingVectorEnv",
)

if not IS_COMMAND:
    warn_of_hidden()
