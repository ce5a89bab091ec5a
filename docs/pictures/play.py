"""Record play.gif: two laws under the same target, push, payload and weaker drive."""

import os
from pathlib import Path

os.environ["SDL_VIDEODRIVER"] = "dummy"  # no window opens

from benchmarks.cli.play import FPS, Game, pygame, record
from benchmarks.policies.spec import resolve
from fbl_gym import scenarios

ACTS = {
    0.6: (pygame.MOUSEBUTTONDOWN, {"pos": (330, 320)}),
    0.7: (pygame.MOUSEBUTTONUP, {}),
    2.0: (pygame.MOUSEBUTTONDOWN, {"pos": (300, 284)}),
    2.1: (pygame.MOUSEMOTION, {"pos": (360, 210)}),
    2.6: (pygame.MOUSEBUTTONUP, {}),
    4.0: (pygame.KEYDOWN, {"unicode": "p"}),
    5.2: (pygame.KEYDOWN, {"unicode": "b"}),
}
"""Events of mouse and keys by their times [s]."""


def frames(game):
    """Yield the frames of seven seconds."""
    for k in range(7 * FPS):
        if k / FPS in ACTS:
            kind, details = ACTS[k / FPS]
            game.handle(pygame.event.Event(kind, details))
        game.advance()
        yield game.frame()[::2, ::2]


scenario = scenarios.get("mixed-error-2").replace(duration=8.0)
game = Game([resolve("pid-flm"), resolve("computed-torque-dob")], scenario, seed=0)
record(frames(game), Path(__file__).with_name("play.gif"))
