"""The options: one record for each thing that may differ between two tasks.

The declaration of a field names its number in the kernel. Beside a record stand its checks, further
numbers of the kernel (`pack`), and what policies are told of it (`facts`). An option that is None
is off. A field of two numbers, one per joint, also takes a single number for both. Most numbers may
vary: each episode draws them from a `Distribution`.
"""

from fbl_gym.options.actuator import Actuator
from fbl_gym.options.datasheet import Datasheet
from fbl_gym.options.disturbance import (
    ArrayDisturbance,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    SineDisturbance,
)
from fbl_gym.options.events import EVENTS, DriveChange, Drop, Event, FrictionChange, Knock, PickUp
from fbl_gym.options.friction import Friction
from fbl_gym.options.joints import ElasticJoint
from fbl_gym.options.limits import Constraints, Limits
from fbl_gym.options.link import FlexibleLink
from fbl_gym.options.parameter_error import PARAMETERS, ParameterError, Payload
from fbl_gym.options.plants import WORLDS, MuJoCo
from fbl_gym.options.references import (
    ArrayReference,
    FilteredSteps,
    FourierReference,
    MinimumJerk,
    SineReference,
    Steps,
)
from fbl_gym.options.reward import Reward
from fbl_gym.options.sensors import SENSORS, Encoder, Noise, SensorError

__all__ = [
    "EVENTS", "PARAMETERS", "SENSORS", "WORLDS", "Actuator", "ArrayDisturbance", "ArrayReference", "Constraints", "Datasheet",
    "DriveChange", "Drop", "ElasticJoint", "Encoder", "Event", "FilteredSteps", "FlexibleLink", "FourierReference", "Friction",
    "FrictionChange", "Knock", "Limits", "MinimumJerk", "MuJoCo", "Noise", "ParameterError", "Payload", "PickUp",
    "PiecewiseConstantDisturbance", "PulseDisturbance", "Reward", "SensorError", "SineDisturbance", "SineReference",
    "Steps",
]  # fmt: skip
