"""The single environment, `fbl_gym/TwoLinkArm-v0`."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import error

from fbl_gym.envs.env_common import MAX_SEED, START, TaskProperties, as_actions, check_reset_options, check_seed
from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array

_LANE = np.zeros(1, dtype=np.int64)
_ARRAY, _empty = np.ndarray, np.empty  # a look-up in NumPy takes time at each step


class TwoLinkArmEnv(TaskProperties, gym.Env[Any, Any]):
    """An uncertain two-link arm that follows a reference.

    ## Description

    Two links turn in a vertical plane. A torque at each joint moves them. The arm obeys equations
    (1)-(4) of Wang, Wang and Brdys (Cogent Engineering 3:1173529, 2016),

        M(q) a + C(q, v) v + G(q) + F(v) + tau_d = tau

    with theta1 measured from the horizontal and theta2 from the first link. A policy knows the
    nominal model. The real arm may differ from it by each of the options below.

    ## Action space

    `Box([-1, -1], [1, 1], (2,), float32)`

    | index | name | unit | range |
    |---|---|---|---|
    | 0 | torque of joint 1 | of its limit, 2,000 N m by default | -1 to 1 |
    | 1 | torque of joint 2 | of its limit, 800 N m by default | -1 to 1 |

    With `action="torque"`, an action is the torque in N m. With `action="acceleration"`, it is an
    acceleration in rad/s^2 within +-100, which the nominal feedback linearisation mapping turns
    into a torque at the measured state. The torque is held for `control_dt`. An action of dtype
    float64 keeps its precision. A value outside the box acts as the nearest inside. NaN or infinity
    is an error, and the arm does not move.

    ## Observation space

    `Box((12,), float64)` with all sensors. `env.unwrapped.layout` gives the slices by name.

    | index | name | unit | range |
    |---|---|---|---|
    | 0, 1 | position, measured | rad | -8 pi to 8 pi |
    | 2, 3 | velocity, measured | rad/s | -200 to 200 |
    | 4, 5 | acceleration, measured at the end of the step | rad/s^2 | -1e5 to 1e5 |
    | 6, 7 | reference_position | rad | -8 pi to 8 pi |
    | 8, 9 | reference_velocity | rad/s | -200 to 200 |
    | 10, 11 | reference_acceleration | rad/s^2 | -1e5 to 1e5 |
    | next 2 k | previous_actions, the last first | as the action | as the action |
    | next 6 n | preview, only with `preview=n`: entries 6 to 11, n times | as above | as above |

    With an actuator delay, lag or rate limit, `previous_actions` are those on their way to the
    joints; with `past_actions=n`, they are at least n. `sensors=("position",)` leaves out the slots
    of the other sensors. Readings saturate at their range.

    ## Reward

    The reward is between 0 and 1, and 1 for perfect tracking without effort or chatter. The
    equation is in `fbl_gym.options.reward`. `reward={"tracking": "l1", ...}` changes its form,
    scales and weights.

    ## Start

    The arm starts on its reference, plus `initial_error` and `initial_velocity`, under the torque
    that holds the nominal arm still.

    ## Episode end

    * Truncation: after `duration`, 10 s by default.
    * Termination, with reward 0: a joint has turned more than 4 pi from its start, or is faster
      than 100 rad/s, or has been farther than `error` from its reference for `error_time`, if that
      is given (`limits`); or it violates one of the `constraints` with `violation="end"`. At the
      last step, an episode can be both terminated and truncated.

    ## Options

    * `scenario`: a name (`fbl_gym.scenarios.names()`), a `Scenario` or its dict; None: the nominal
      arm.
    * `**options`: fields of `Scenario` that replace the scenario's: `arm`, `parameter_error`,
      `noise`, `encoder`, `friction`, `disturbance`, `actuator`, `joint`, `link`, `datasheet`,
      `events`, `sensors`, `reference`, `control_dt`, `physics_dt`, `duration`, `initial_error`,
      `initial_velocity`, `limits`, `constraints`, `plant`, `drawn_per`. Each is a record or the
      plain data that makes one. Most numbers may be a `Distribution`, drawn per episode, or once
      for each seed with `drawn_per="seed"`. None switches an option off. `fbl-gym list
      options` prints their fields.
    * `action`: "normalized", "torque" or "acceleration".
    * `reward`: a `Reward` or a dict of its fields.
    * `preview`: number of coming samples of the reference in the observation.
    * `past_actions`: least number of previous actions in the observation. The reward has a price on
      the change of the torque, so it is a function of observation and action only with one or more.
    * `info`: True adds to each step's info `tracking_error` (real, [2] rad); `tracking_loss`,
      `effort_loss` and `chatter_loss`, whose sum is 1 less the reward unless the episode is
      terminated; and `saturation`, the share of the joints whose torque is at its limit. A step
      then takes some 40 microseconds more. They are NaN where a motion overflows.
      With `constraints`, each step's info has `cost`, with and without this option: 1.0 if the step
      ended beyond a bound, else 0.0.
    * `context`: True adds `context` to the info of `reset`, for teachers: the true numbers of the
      episode, which `context_names` names. They are masses [kg] and lengths [m] of the links, then
      all numbers that may vary, with times in physics steps, and 0 for no limit of the rate. The
      observation never has them.
    * `render_mode`: "human" shows a window in real time, "rgb_array" returns a frame for each
      `render()`. Both need pygame (`pip install 'fbl-gym[render]'`).
    * `render_size`: width and height of a frame [pixels], 480 by default.

    ## Determinism

    An episode is a function of (scenario, seed, actions). `reset(seed=s)` starts the first episode
    of seed s, `reset()` the next one of the same seed. Each random number comes from a named
    stream, so that an option does not change the random numbers of another.

    ## Another engine

    `fbl_gym/TwoLinkArmMuJoCo-v0` is this environment with `plant="mujoco"`: MuJoCo moves the arm,
    and everything else is the same. It needs the extra `mujoco`.

    ## Version history

    * v0: first release.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # noqa: RUF012 - as in Gymnasium

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode: the first of a seed, or the next one of the same seed.

        Args:
            seed: 0 to 2**64 - 1; None: the next episode of the last seed. The first `reset` without
                a seed draws one from the operating system's entropy.
            options: where this episode starts: "position" [2] rad, "velocity" [2] rad/s, and
                "reference", the way-points of a reference that has some [points x 2] rad; a
                single one [2] is a goal.

        Returns:
            The first observation, [size], and info, which is empty without the option `context`.
        """
        check_reset_options(options, START)
        seed = None if seed is None else check_seed(seed)
        self._batch.give(_LANE, self.starts_of(options))
        super().reset(seed=seed)
        if seed is not None or not self._begun:
            new_seed = self.np_random.integers(MAX_SEED, dtype=np.uint64) if seed is None else np.uint64(seed)
            self._batch.seed(_LANE, new_seed)
        else:
            self._batch.next_episode(_LANE)
        self._begun = True
        observation = np.empty(self._size)
        self._batch.reset(_LANE, observation)
        if self.render_mode == "human":
            self.render()
        return observation, {name: value[0] for name, value in self._context().items()}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for `control_dt`.

        Args:
            action: [2], in the action's unit.

        Returns:
            Observation [size], reward, terminated, truncated, and info, see the option `info`.

        Raises:
            ValueError: if the action has another shape or is not finite. The arm has not moved.
            gymnasium.error.ResetNeeded: before the first `reset` and after an episode's end.
        """
        if type(action) is not _ARRAY or action.shape != (2,):
            action = as_actions(action, (2,))
        action1, action2 = action.tolist()
        if type(action1) is not float:
            action1, action2 = as_actions(action, (2,)).tolist()
        observation = _empty(self._size)
        refused, reward, terminated, truncated = self._batch.step_one(action1, action2, observation)
        if refused >= 0:
            if refused == 0:
                raise ValueError(f"action must be finite, got {action!r}")
            raise error.ResetNeeded("the episode has ended, or none has begun: call reset() before step()")
        return observation, reward, terminated, truncated, self._report() if self._reports else {}

    def _report(self) -> dict[str, Any]:
        """Show the arm in the window, and return the step's info."""
        if self.render_mode == "human":
            self.render()
        measures = self._measures().items()
        return {name: value[0] if value.ndim > 1 else float(value[0]) for name, value in measures}

    @property
    def truth(self) -> Truth:
        """Return the true parameters and signals of this instant. A policy must not use them.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        self._expect_begun("reading truth")
        return self._batch.truth().of_lanes(0)

    def render(self) -> Any:
        """Return the frame of this instant, [size x size x 3].

        In mode "human", `reset` and `step` show it in the window, and this returns None.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
            gymnasium.error.DependencyNotInstalled: without pygame.
        """
        for view in self._shown_views():
            return view.show(self.truth) if self.render_mode == "human" else view.frame(self.truth)
        return None

    def close(self) -> None:
        """Close the window, if it is open."""
        for view in self._views:
            view.close()
        self._views = []
