"""A robot's observation and torque command, by the code that computes those of the environments."""

import dataclasses

import numpy as np

from fbl_gym.envs.env_common import configure
from fbl_gym.kernel.batch import ArmBatch
from fbl_gym.kernel.memory.layout import VARIED
from fbl_gym.model.arm import Array
from fbl_gym.options import SENSORS, ArrayReference, Reward
from fbl_gym.scenarios import Scenario

_LANE = np.zeros(1, dtype=np.int64)
_KEPT = ("actuator", "sensors", "limits", "control_dt", "physics_dt", "duration", "arm")


class Robot(ArmBatch):
    """A batch of one arm whose motion is given, step by step.

    The kernel computes the velocity, if the encoder of the scenario does, keeps previous actions
    and limits torques. Rounding, noise, age and loss of the readings are those of the robot.

    Args:
        scenario: the task.
        preview: number of coming samples of the reference in the observation.

    Attributes:
        interface: of the scenario, for policies.
        needs: the signals that `observe` takes, out of position, velocity and acceleration.
    """

    def __init__(self, scenario: Scenario, preview: int) -> None:
        action = "torque" if scenario.actuator.torque_limit is None else "normalized"
        task = {"action": action, "reward": Reward(), "preview": preview}
        self.interface = configure(scenario, {}, **task)[1].interface
        encoder = scenario.encoder and dataclasses.replace(scenario.encoder, counts=None, latency=0, dropout=0.0)
        computed = encoder is not None and encoder.difference is not None
        self.needs = tuple(name for name in scenario.sensors if not (name == "velocity" and computed))
        # The arm starts at an error from a reference of zeros, which is its first position.
        kept = {name: getattr(scenario, name) for name in _KEPT}
        calm = Scenario("robot", encoder=encoder, reference=ArrayReference(((0.0, 0.0),) * 2), **kept)
        program = configure(calm, {}, **task)[1]
        program.settings["external_physics"] = True
        super().__init__(program, 1)
        self._inputs = self.index(*self.needs, *(f"reference_{name}" for name in SENSORS))
        layout = self.interface.layout
        self._ahead = layout["preview"] if preview else slice(0)
        self._bounds = [bound[self._ahead] for bound in layout.bounds]

    def start(self, motion: Array) -> None:
        """Start a run at rest, or at the measured velocity, under the torque that holds still.

        Args:
            motion: as for `observe`.
        """
        at = dict(zip(self.needs, motion.reshape(-1, 2), strict=True))
        varied = self.settings["varied"].view(VARIED)[0]
        varied["initial_error"], varied["initial_velocity"] = at["position"], at.get("velocity", 0.0)
        self.reset(_LANE, np.empty(self.interface.layout.size))

    def observe(self, motion: Array, reference: Array) -> Array:
        """Return the observation [1 x size] of the present control step.

        Args:
            motion: the signals that the robot `needs`, [2 x number] rad, rad/s, rad/s^2.
            reference: position, velocity and acceleration now and at the coming samples of the
                preview, [6 x (1 + preview)] rad, rad/s, rad/s^2.
        """
        observation = np.empty((1, self.interface.layout.size))
        self.write(self._inputs, np.concatenate([motion, reference[:6]]))
        self.sense(observation)
        if len(reference) > 6:
            observation[0, self._ahead] = np.clip(reference[6:], *self._bounds)
        return observation

    def command(self, action: Array) -> Array:
        """Return the torque [2] N m of a finite action [2], and go on to the next control step."""
        self.pass_step(action)
        return self.field("command")[0]
