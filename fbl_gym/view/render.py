"""The view of an arm: its pictures over an episode, and the window that shows them.

Imported when a picture is first needed. A frame alone opens no window.
"""

import math

import numpy as np

from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair
from fbl_gym.scenarios import Scenario
from fbl_gym.view.picture import Frame, Picture, draw, pygame

WINDOW_FPS = 50
"""Largest number of pictures in the window per simulated second; pygame has one per process."""

_CLOCK = pygame.time.Clock()
"""Paces the window."""


class View:
    """The pictures of one arm, `size` pixels wide and high, and the window, which shows one arm."""

    def __init__(self, scenario: Scenario, size: int) -> None:
        self.scenario, self.size = scenario, size
        self._last_time = math.inf

    def picture(self, truth: Truth) -> Picture:
        """Return the picture of an instant."""
        lengths, q, r, torque = map(pair, (truth.lengths, truth.position, truth.reference, truth.applied_torque))
        disturbance = None if self.scenario.disturbance is None else pair(-truth.disturbance)
        return Picture(
            title=self.scenario.name, time=float(truth.time), lengths=lengths, position=q, reference=r,
            bend=pair(truth.bend), torque=torque, disturbance=disturbance, payload=float(truth.payload),
        )  # fmt: skip

    def frame(self, truth: Truth) -> Frame:
        """Return the frame of an instant, [size x size x 3]."""
        return draw(self.picture(truth), self.size)

    def show(self, truth: Truth) -> None:
        """Show an instant in the window, in real time and at most `WINDOW_FPS` times per second."""
        picture = self.picture(truth)
        passed = picture.time - self._last_time
        if 0.0 <= passed < 0.99 / WINDOW_FPS:
            return
        frame = draw(picture, self.size)
        _CLOCK.tick(1.0 / passed if 0.0 < passed < math.inf else 0.0)  # a new episode waits for nothing
        self._last_time = picture.time
        window = pygame.display.get_surface()
        if window is None or window.get_size() != (self.size, self.size):
            pygame.display.init()
            pygame.display.set_caption("fbl-gym")
            window = pygame.display.set_mode((self.size, self.size))
        pygame.surfarray.blit_array(window, frame.swapaxes(0, 1))
        pygame.event.pump()
        pygame.display.flip()

    def close(self) -> None:
        """Close the window, if this arm has been shown in it."""
        if self._last_time < math.inf:
            pygame.display.quit()


def pair(x: Array) -> Pair:
    """Return two floats, with zero for the infinite or undefined values of a diverged arm."""
    first, second = np.nan_to_num(x, posinf=0.0, neginf=0.0).tolist()
    return first, second
