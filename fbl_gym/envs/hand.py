"""A hand on a running arm: a target to follow, a push, a payload, a weak drive, noise."""

from collections.abc import Sequence

import numpy as np

from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.kernel.memory.layout import EVENT_ROWS, LANES, SETTINGS_SIZE
from fbl_gym.model.arm import ArmParameters, Array
from fbl_gym.options import Actuator, ArrayDisturbance, ArrayReference, DriveChange, Drop, Limits, PickUp
from fbl_gym.records.checks import Pair
from fbl_gym.scenarios import Scenario

#: Of the critically damped filter between target and reference [rad/s].
BANDWIDTH = 6.0

_COURSE = ("reference", "disturbance", "control_dt", "physics_dt", "duration", "drawn_per")
#: Places of the waiting events among the scenario's.
_PICK_UP, _DROP, _DRIVE = -3, -2, -1


def course(scenario: Scenario, seeds: Sequence[int]) -> Array:
    """Return what each seed's first episode asks of any arm, [4 x T + 1 x n x 2] for T steps.

    It is position, velocity and acceleration of the reference, and the disturbance [N m] that acted
    until the sample.
    """
    kept = {name: getattr(scenario, name) for name in _COURSE}
    heavy = ArmParameters(m1=1e6, m2=1e6)  # no disturbance moves it far
    limits = Limits(position=1e9, velocity=1e9)
    task = Scenario("course", arm=heavy, limits=limits, actuator=Actuator(None), **kept)
    env, samples = TwoLinkArmVectorEnv(len(seeds), task, action="torque"), []
    env.reset(seed=list(seeds))
    for _ in range(scenario.steps + 1):
        now = env.truth
        samples.append((now.reference, now.reference_velocity, now.reference_acceleration, now.disturbance))
        env.step(np.zeros((len(seeds), 2)))
    return np.stack(samples, axis=1)


def open_to_hand(scenario: Scenario, seed: int) -> Scenario:
    """Return a scenario on whose arm a `Hand` can act, for a seed.

    Reference and disturbance are those of the seed's first episode, in a table with a row for each
    control step. Events of a hand wait at the episode's end, which no event reaches.
    """
    q, v, a, torque = course(scenario, [seed])[:, :, 0]
    end, dt, start = scenario.duration, scenario.control_dt, {}
    if scenario.reference.kind == "steps":  # the arm starts a step away from the reference
        (env := TwoLinkArmEnv(scenario, action="torque")).reset(seed=seed)
        start = {"initial_error": tuple(env.truth.position - q[0])}
    return scenario.replace(
        **start,
        reference=ArrayReference(position=q[:-1], dt=dt, velocity=v[:-1], acceleration=a[:-1]),
        disturbance=ArrayDisturbance(torque=torque[1:], dt=dt),
        events=(*scenario.events, PickUp(end, mass=0.0), Drop(end), DriveChange(end, factor=1.0)),
    )


class Hand:
    """Acts on the arm of an environment, from its next control step on.

    Args:
        env: a single one, of a scenario from `open_to_hand`, before its first reset.
    """

    def __init__(self, env: TwoLinkArmEnv) -> None:
        self._batch, self._settings = env._batch, env._batch.settings
        self._tables = np.arange(SETTINGS_SIZE, int(self._settings["actions"]))
        self._first = self._batch.read(self._tables)
        self._noise = self._batch.index("noise_std")

    @property
    def _step(self) -> int:
        """Number of control steps since the episode's start."""
        return int(self._batch.field("step")[0])

    def let_go(self) -> None:
        """Give the next episode the scenario's own reference and disturbance again."""
        self._batch.write(self._tables, self._first)

    def aim(self, target: Pair) -> None:
        """Let the reference, and its preview, go on to a target [rad] on a smooth way."""
        index = int(self._settings["reference_table"]) + 6 * (self._step + 1)
        count = min(int(self._settings["preview"]) + 1, int(self._settings["reference_points"]) - self._step - 1)
        time = float(self._settings["control_dt"]) * np.arange(1, count + 1)[:, None]
        position, velocity = (self._batch.field(f"reference_{name}")[0] for name in ("position", "velocity"))
        gap = position - target
        rate, fade = velocity + BANDWIDTH * gap, np.exp(-BANDWIDTH * time)
        left = (gap + rate * time) * fade
        speed = rate * fade - BANDWIDTH * left
        samples = np.hstack([target + left, speed, -BANDWIDTH * (BANDWIDTH * left + 2.0 * speed)])
        self._batch.write(self._tables[index : index + samples.size], samples.ravel())

    def push(self, torque: Array) -> None:
        """Add a torque [2] N m to the joints during the next control step."""
        index = int(self._settings["disturbance_table"]) + 2 * self._step
        own = self._first[index : index + 2]
        self._batch.write(self._tables[index : index + 2], own - torque)

    def load(self, mass: float) -> None:
        """Put a mass at rest [kg] into the gripper."""
        self._happen(_PICK_UP, mass)

    def unload(self) -> None:
        """Release all payload."""
        self._happen(_DROP)

    def scale_drives(self, factor: Pair) -> None:
        """Multiply the torque of each drive by a factor from now on."""
        self._happen(_DRIVE, *factor)

    def make_noise(self, std: Pair) -> None:
        """Add noise to the readings, std of position and velocity [rad, rad/s]."""
        self._settings["noisy"], self._settings["has_noise"][:2] = True, 1
        own = self._batch.read(self._noise)
        self._batch.write(self._noise, np.hypot(own, np.repeat((*std, 0.0), 2)))

    def _happen(self, event: int, *size: float) -> None:
        row = int(self._settings["event_row"]) + EVENT_ROWS * (int(self._settings["events"]) + event)
        now = self._step * int(self._settings["substeps"])
        place = int(self._settings["blocks"]) + LANES * (row + np.arange(1 + len(size)))
        self._batch.write(place, np.array([now, *size]))
