"""An uncertain two-link arm for control and reinforcement learning.

Importing this package registers `fbl_gym/TwoLinkArm-v0` with Gymnasium;
`fbl_gym/TwoLinkArmTracking-v0`, the same with observations for learning agents; and
`fbl_gym/TwoLinkArmMuJoCo-v0`, the same with MuJoCo's physics.
"""

import importlib
from typing import TYPE_CHECKING, Any

from fbl_gym.neighbours import IS_OVERVIEW, warn_of_shadows

__version__ = "0.1.0"

if not IS_OVERVIEW:
    warn_of_shadows()

    from gymnasium.envs.registration import register

    from fbl_gym import options, scenarios
    from fbl_gym.interface import Interface, Layout
    from fbl_gym.model.arm import SECTION_2_2, TABLE_1, ArmParameters
    from fbl_gym.options import *  # noqa: F403 - the records that `options.__all__` lists
    from fbl_gym.records.record import Distribution
    from fbl_gym.scenarios import Scenario

    __all__ = [
        "SECTION_2_2", "TABLE_1", "ArmParameters", "Distribution", "Interface", "Layout", "Scenario", "Truth",
        "TwoLinkArmEnv", "TwoLinkArmTrackingEnv", "TwoLinkArmTrackingVectorEnv", "TwoLinkArmVectorEnv", "scenarios",
    ]  # fmt: skip
    __all__ += options.__all__

    _ENV, _VECTOR_ENV = "fbl_gym.envs.env:TwoLinkArmEnv", "fbl_gym.envs.vector_env:TwoLinkArmVectorEnv"
    _TRACKING = "fbl_gym.envs.tracking:TwoLinkArmTracking"
    register("fbl_gym/TwoLinkArm-v0", _ENV, vector_entry_point=_VECTOR_ENV)
    register("fbl_gym/TwoLinkArmMuJoCo-v0", _ENV, vector_entry_point=_VECTOR_ENV, kwargs={"plant": "mujoco"})
    register("fbl_gym/TwoLinkArmTracking-v0", f"{_TRACKING}Env", vector_entry_point=f"{_TRACKING}VectorEnv")

if TYPE_CHECKING:
    from fbl_gym.envs.env import TwoLinkArmEnv
    from fbl_gym.envs.tracking import TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv
    from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
    from fbl_gym.kernel.batch import Truth
else:
    _WITH_NUMBA = {
        "TwoLinkArmEnv": "envs.env", "TwoLinkArmTrackingEnv": "envs.tracking", "TwoLinkArmTrackingVectorEnv": "envs.tracking",
        "TwoLinkArmVectorEnv": "envs.vector_env", "Truth": "kernel.batch",
    }  # fmt: skip

    def __getattr__(name: str) -> Any:
        """Import on demand: Numba takes longer to import than all else."""
        if name not in _WITH_NUMBA:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"fbl_gym.{_WITH_NUMBA[name]}"), name)
