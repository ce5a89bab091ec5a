"""The command `fbl-gym play`: a window on running arms, on which mouse and keys act."""

import argparse
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cli.common import write
from benchmarks.files import replacing
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.rollout import make_env
from fbl_gym import Scenario, scenarios
from fbl_gym.envs.hand import Hand, open_to_hand
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair, check_number, check_whole
from fbl_gym.view import picture
from fbl_gym.view.picture import BLUE, INK, PAPER, RULE, VERMILLION, Frame, pair, pygame
from fbl_gym.view.render import View

#: Width of a picture; heights of a strip with a signal and of a line of text; margin [pixels].
SIZE, STRIP, LINE, PAD = 480, 90, 20, 17

#: Pictures per second.
FPS = 20

#: Pictures whose error and torque the strips show.
SHOWN = 5 * FPS

#: Duration of an episode, if none is given [s].
ROUND = 60.0

#: Standard deviation of the noise that a key adds to position [rad] and velocity [rad/s].
NOISE = (2e-3, 2e-2)

HELP = "drag: target   drag a link: push   p: payload   d: drop   b: weaker drive 2   n: noise   r: again   q: quit"


def run(arguments: argparse.Namespace) -> int:
    """Show the window until it is closed or the time is up."""
    scenario = scenarios.get(arguments.scenario)
    seconds = ROUND if arguments.seconds is None else check_number("--seconds", arguments.seconds, above=0)
    steps = max(1, round(seconds / scenario.control_dt))
    scenario = scenario.replace(duration=steps * scenario.control_dt)
    game = Game([*map(resolve, arguments.policies)], scenario, check_whole("--seed", arguments.seed))
    frames = loop(game, once=arguments.seconds is not None)
    write(arguments.record, "film", partial(record, frames))
    deque(frames, maxlen=0)  # those that no film has taken
    return 0


def loop(game: "Game", once: bool) -> Iterator[Frame]:
    """Show a game in a window in real time, and yield its frames."""
    pygame.display.init()
    pygame.display.set_caption("fbl-gym play")
    window, clock = pygame.display.set_mode(game.size), pygame.time.Clock()
    try:
        while all(map(game.handle, pygame.event.get())) and not (once and game.over):
            if game.over:
                game.start()
            game.advance()
            frame = game.frame()
            pygame.surfarray.blit_array(window, frame.swapaxes(0, 1))
            pygame.display.flip()
            yield frame
            clock.tick(FPS)
    finally:
        pygame.display.quit()


def record(frames: Iterable[Frame], path: Path) -> None:
    """Write frames to a GIF, with a palette for each."""
    from PIL import Image  # a film alone needs it

    images = (Image.fromarray(frame).quantize(64, dither=Image.Dither.NONE) for frame in frames)
    first = next(images)
    with replacing(path) as beside:
        first.save(beside, save_all=True, append_images=images, duration=1000 // FPS, loop=0)


class Arm:
    """An arm at a place of the window, the laws that can move it, and its last signals."""

    def __init__(self, scenario: Scenario, laws: Sequence[PolicySpec], law: int) -> None:
        self.env = make_env(max(laws, key=lambda each: each.preview), scenario, None)
        self.actors = [each.make(self.env) for each in laws]
        self.hand, self.view, self.law, self.left = Hand(self.env), View(scenario, SIZE), law, SIZE * law

    def start(self, seed: int) -> None:
        """Start the first episode of a seed."""
        self.hand.let_go()
        self.observation, _ = self.env.reset(seed=seed)
        self.state, self.diverged, self.over = None, False, False
        self.signals: deque[Array] = deque(maxlen=SHOWN)  # error [mrad] and torque [N m], [2 x 2] each
        self.lengths: Pair = tuple(self.env.truth.lengths.tolist())

    def advance(self, steps: int, target: Pair | None, push: Array) -> None:
        """Advance by control steps, towards a target [rad] and under a push [2] N m."""
        for _ in range(steps):
            if not self.over:
                self.hand.push(push)
                if target is not None:
                    self.hand.aim(target)
                action, self.state = self.actors[self.law].predict(self.observation, self.state, deterministic=True)
                self.observation, _, self.diverged, truncated, _ = self.env.step(action)
                self.over = self.diverged or truncated
        truth = self.env.truth
        self.signals.append(np.nan_to_num([1e3 * (truth.reference - truth.position), truth.applied_torque]))

    def joints(self) -> Array:
        """Return base, elbow and tip, [3 x 2] m."""
        truth = self.env.truth
        return picture.chain(self.lengths, pair(truth.position), pair(truth.bend))[::2]

    def angles(self, point: Array) -> Pair:
        """Return the joint angles near the reference whose tip is nearest to a point [2] m."""
        (length1, length2), reference = self.lengths, self.env.truth.reference
        cosine = (float(point @ point) - length1**2 - length2**2) / (2.0 * length1 * length2)
        q2 = math.copysign(math.acos(min(max(cosine, -1.0), 1.0)), reference[1])
        q1 = math.atan2(point[1], point[0]) - math.atan2(length2 * math.sin(q2), length1 + length2 * math.cos(q2))
        return q1 + 2.0 * math.pi * round((reference[0] - q1) / (2.0 * math.pi)), q2


class Game:
    """One or two arms of the same seed, and a hand that does the same to both.

    Args:
        laws: the first two move an arm each.
        scenario: of both arms.
        seed: of the episode.
    """

    def __init__(self, laws: Sequence[PolicySpec], scenario: Scenario, seed: int) -> None:
        self.laws, self.seed, self.steps = laws, seed, max(1, round(1 / FPS / scenario.control_dt))
        opened, nominal = open_to_hand(scenario, seed), scenario.arm
        self.arms = [Arm(opened, laws, law) for law in range(min(len(laws), 2))]
        self.size = (SIZE * len(self.arms), SIZE + 2 * STRIP + 2 * LINE)
        self.mass, self.reach = 0.1 * (nominal.m1 + nominal.m2), nominal.L1 + nominal.L2
        limit = np.max(scenario.actuator.torque_limit or 0.0) or 100.0 * self.mass * self.reach
        self.stiffness = float(limit) / self.reach**2  # of the spring between mouse and link [N/m]
        self.start()

    def start(self) -> None:
        """Start the episode again, as it was."""
        self.arm, self.mouse = self.arms[0], (0, 0)  # the arm under the mouse
        self.aims = False
        self.target: Pair | None = None
        self.grip: tuple[int, float] | None = None
        for arm in self.arms:
            arm.start(self.seed)

    @property
    def over(self) -> bool:
        """True at the end of the episode, or when all arms have diverged."""
        return all(arm.over for arm in self.arms)

    def handle(self, event: Any) -> bool:
        """Do what mouse and keys say; return False to end."""
        if event.type in (pygame.MOUSEBUTTONDOWN, pygame.MOUSEMOTION):
            self.mouse = event.pos
            if not self.aims and self.grip is None:
                self.arm = self.arms[min(int(event.pos[0]) // SIZE, len(self.arms) - 1)]
        if event.type == pygame.MOUSEBUTTONDOWN and event.pos[1] < SIZE:
            self.grip = self.grasp()
            self.aims = self.grip is None
        if event.type == pygame.MOUSEBUTTONUP:
            self.aims, self.grip = False, None
        if self.aims:
            self.target = self.arm.angles(self.point())
        return self.press(event.unicode) if event.type == pygame.KEYDOWN else event.type != pygame.QUIT

    def press(self, key: str) -> bool:
        """Do what a key says; return False to end."""
        if key.isdecimal() and 0 < int(key) <= len(self.laws):
            self.arm.law, self.arm.state = int(key) - 1, None
        if key == "r":
            self.start()
        acts: dict[str, Callable[[Hand], None]] = {
            "p": partial(Hand.load, mass=self.mass),
            "d": Hand.unload,
            "b": partial(Hand.scale_drives, factor=(1.0, 0.5)),
            "n": partial(Hand.make_noise, std=NOISE),
        }
        for arm in self.arms if key in acts else ():
            acts[key](arm.hand)
        return key not in ("q", "\x1b")

    def point(self) -> Array:
        """Return the place of the mouse, [2] m from the arm's base."""
        return picture.unproject((self.mouse[0] - self.arm.left, self.mouse[1]), self.arm.lengths, SIZE)

    def grasp(self) -> tuple[int, float] | None:
        """Return the link under the mouse and the share of its length there, if there is one."""
        joints, point = self.arm.joints(), self.point()
        for link in (1, 0):
            along = joints[link + 1] - joints[link]
            share = min(max(float((point - joints[link]) @ along / (along @ along)), 0.0), 1.0)
            if np.linalg.norm(point - joints[link] - share * along) < 0.06 * self.reach:
                return link, share
        return None

    def gripped(self, link: int, share: float) -> tuple[Array, Array]:
        """Return the point that the mouse has gripped [2] m, and the push there [2] N m."""
        joints = self.arm.joints()
        at = joints[link] + share * (joints[link + 1] - joints[link])
        force, levers = self.stiffness * (self.point() - at), at - joints[:2]
        return at, (levers[:, 0] * force[1] - levers[:, 1] * force[0]) * (1.0, link)

    def advance(self) -> None:
        """Let the time of a picture pass; the push is held."""
        push = np.zeros(2) if self.grip is None else self.gripped(*self.grip)[1]
        for arm in self.arms:
            arm.advance(self.steps, self.target, push)

    def frame(self) -> Frame:
        """Return what the window shows, [height x width x 3]."""
        canvas = pygame.Surface(self.size, depth=32)
        canvas.fill(PAPER)
        for arm in self.arms:
            shown = arm.view.frame(arm.env.truth, self.laws[arm.law].name)
            canvas.blit(pygame.surfarray.make_surface(shown.swapaxes(0, 1)), (arm.left, 0))
            if arm.diverged:
                picture.write(canvas, "diverged", (arm.left + PAD, 45), LINE, VERMILLION)
        if self.grip is not None:
            x, y = picture.project(self.gripped(*self.grip)[0], self.arm.lengths, SIZE).tolist()
            pygame.draw.line(canvas, VERMILLION, (self.arm.left + x, y), self.mouse, 3)
        for row, name in enumerate(("error [mrad]", "torque [N m]")):
            self.draw_strip(canvas, row, name)
        laws = "   ".join(f"{i}: {law.name}" for i, law in enumerate(self.laws[:9], 1))
        for line, text in enumerate((HELP, laws)):
            picture.write(canvas, text, (PAD, self.size[1] - LINE * (1.5 - line)), 0.8 * LINE, INK)
        return np.ascontiguousarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))

    def draw_strip(self, canvas: pygame.Surface, row: int, name: str) -> None:
        """Draw a signal of the last seconds below each arm, on one scale."""
        top, middle = SIZE + (row + 0.06) * STRIP, SIZE + (row + 0.5) * STRIP
        most = max((float(np.abs(signal[row]).max()) for arm in self.arms for signal in arm.signals), default=0.0)
        for arm in self.arms:
            left, right = arm.left + PAD, arm.left + SIZE - PAD
            pygame.draw.line(canvas, RULE, (left, middle), (right, middle))
            picture.write(canvas, f"{name}, within {most:,.1f}", (left, top), 0.7 * LINE, INK)
            places = np.linspace(right, left, SHOWN)[len(arm.signals) - 1 :: -1]
            for joint, colour in enumerate((BLUE, VERMILLION)):
                heights = [middle - 0.36 * STRIP * signal[row, joint] / (most or 1.0) for signal in arm.signals]
                if len(heights) > 1:
                    pygame.draw.aalines(canvas, colour, False, [*zip(places.tolist(), heights, strict=True)])
                picture.write(canvas, f"joint {joint + 1}", (right - 60 * (1 - joint), top), 0.7 * LINE, colour, 1.0)
