"""Films of policies side by side, for a notebook or a file."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.rollout import make_env
from fbl_gym import Scenario
from fbl_gym.scenarios import as_scenario


def frames(policy: PolicySpec, scenario: Scenario, seed: int, fps: int, size: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames of an episode; an arm that diverged stays where it was."""
    from fbl_gym.view.render import View

    env, over = make_env(policy, scenario, None), False
    actor, state, view = policy.make(env), None, View(scenario.replace(name=policy.name), size)
    observation, _ = env.reset(seed=seed)
    for k in range(scenario.steps):
        if k % max(1, round(1.0 / fps / scenario.control_dt)) == 0:
            yield view.frame(env.truth)
        if not over:
            action, state = actor.predict(observation, state, deterministic=True)
            observation, _, over, _, _ = env.step(action)


def animate(
    policies: str | Sequence[str], scenario: Scenario | str | Path = "nominal", *, seed: int = 0, fps: int = 20,
    size: int = 360, trust: bool = False,
) -> Any:  # fmt: skip
    """Return an episode of policies side by side as a Matplotlib animation, which a notebook shows.

    Its `save("film.gif")` writes a file. It needs the extra `render`.

    Args:
        policies: one name, or several, as for `fbl-gym evaluate`.
        scenario: its name, its file, or a `Scenario`.
        seed: of the episode.
        fps: frames per second.
        size: width and height of an arm's picture [pixels].
        trust: True lets the code of a saved model run.
    """
    from matplotlib.animation import ArtistAnimation  # an animation alone needs it
    from matplotlib.figure import Figure

    names, task = [policies] if isinstance(policies, str) else policies, as_scenario(scenario)
    films = [frames(resolve(name, trust=trust), task, seed, fps, size) for name in names]
    figure = Figure(figsize=(len(films) * size / 100, size / 100), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    pictures = [[axes.imshow(np.hstack(row), animated=True)] for row in zip(*films, strict=True)]

    film: Any = ArtistAnimation(figure, pictures, interval=1000 / fps)
    film._repr_html_ = film.to_jshtml  # a notebook shows it without a setting
    return film
