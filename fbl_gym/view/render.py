"""The view of an arm: its pictures over an episode, and the window that shows them.

Imported when a picture is first needed. A frame alone opens no window.
"""

import math

from fbl_gym.kernel.batch import Truth
from fbl_gym.scenarios import Scenario
from fbl_gym.view.picture import Frame, draw, pygame

#: Largest number of pictures in the window per simulated second; pygame has one per process.
WINDOW_FPS = 50

#: Paces the window.
_CLOCK = pygame.time.Clock()


class View:
    """The pictures of one arm, `size` pixels wide and high, and the window, which shows one arm."""

    def __init__(self, scenario: Scenario, size: int) -> None:
        self.scenario, self.size = scenario, size
        self._last_time = math.inf

    def frame(self, truth: Truth, title: str | None = None) -> Frame:
        """Return the frame of an instant, [size x size x 3], below a title.

        Without a title, it is the scenario's name.
        """
        disturbed = self.scenario.disturbance is not None
        return draw(truth, self.scenario.name if title is None else title, self.size, disturbed)

    def show(self, truth: Truth) -> None:
        """Show an instant in the window, in real time and at most `WINDOW_FPS` times per second."""
        passed = float(truth.time) - self._last_time
        if 0.0 < passed < 0.99 / WINDOW_FPS:
            return
        frame = self.frame(truth)
        _CLOCK.tick(1.0 / passed if 0.0 < passed < math.inf else 0.0)  # a new episode waits for nothing
        self._last_time = float(truth.time)
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
