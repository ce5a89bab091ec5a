"""An uncertain two-link arm for control and reinforcement learning.

Importing this package registers `fbl_gym/TwoLinkArm-v0` with Gymnasium;
`fbl_gym/TwoLinkArmTracking-v0`, the same with observations for learning agents; and
`fbl_gym/TwoLinkArmMuJoCo-v0`, the same with MuJoCo's physics.
"""

from gymnasium.envs.registration import register

from fbl_gym import references, scenarios
from fbl_gym.arm import SECTION_2_2, TABLE_1, ArmParameters
from fbl_gym.batch import Truth
from fbl_gym.env import TwoLinkArmEnv
from fbl_gym.events import DriveChange, Drop, FrictionChange, Knock, PickUp
from fbl_gym.interface import Constraints, Interface, Layout, Limits
from fbl_gym.joints import ElasticJoint
from fbl_gym.plants import MuJoCo
from fbl_gym.records import Distribution
from fbl_gym.references import (
    ArrayReference,
    FilteredSteps,
    FourierReference,
    MinimumJerk,
    SineReference,
    Steps,
)
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario
from fbl_gym.tracking import TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv
from fbl_gym.uncertainty import (
    Actuator,
    ArrayDisturbance,
    Encoder,
    Friction,
    Noise,
    ParameterError,
    Payload,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    SensorError,
    SineDisturbance,
)
from fbl_gym.vector_env import TwoLinkArmVectorEnv

__version__ = "0.1.0"

__all__ = [
    "SECTION_2_2",
    "TABLE_1",
    "Actuator",
    "ArmParameters",
    "ArrayDisturbance",
    "ArrayReference",
    "Constraints",
    "Distribution",
    "DriveChange",
    "Drop",
    "ElasticJoint",
    "Encoder",
    "FilteredSteps",
    "FourierReference",
    "Friction",
    "FrictionChange",
    "Interface",
    "Knock",
    "Layout",
    "Limits",
    "MinimumJerk",
    "MuJoCo",
    "Noise",
    "ParameterError",
    "Payload",
    "PickUp",
    "PiecewiseConstantDisturbance",
    "PulseDisturbance",
    "Reward",
    "Scenario",
    "SensorError",
    "SineDisturbance",
    "SineReference",
    "Steps",
    "Truth",
    "TwoLinkArmEnv",
    "TwoLinkArmTrackingEnv",
    "TwoLinkArmTrackingVectorEnv",
    "TwoLinkArmVectorEnv",
    "references",
    "scenarios",
]

_ENV, _VECTOR_ENV = "fbl_gym.env:TwoLinkArmEnv", "fbl_gym.vector_env:TwoLinkArmVectorEnv"
register(id="fbl_gym/TwoLinkArm-v0", entry_point=_ENV, vector_entry_point=_VECTOR_ENV)
register(id="fbl_gym/TwoLinkArmMuJoCo-v0", entry_point=_ENV, vector_entry_point=_VECTOR_ENV, kwargs={"plant": "mujoco"})
register(
    id="fbl_gym/TwoLinkArmTracking-v0",
    entry_point="fbl_gym.tracking:TwoLinkArmTrackingEnv",
    vector_entry_point="fbl_gym.tracking:TwoLinkArmTrackingVectorEnv",
)
