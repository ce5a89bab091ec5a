"""Pictures of the arm, and the window that shows them. Imported only when one is asked for.

`draw` is a pure function from a `Picture`, plain numbers, to a frame. A frame alone opens no window.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
import weakref
from dataclasses import dataclass

import numpy as np

from fbl_gym.arm import STANDARD_GRAVITY, ArmParameters, Array, joint_positions
from fbl_gym.batch import Truth
from fbl_gym.canvas import BLUE, GHOST, INK, ORANGE, PAPER, PURPLE, RULE, SKY, VERMILLION, Canvas, Frame, Point, pygame
from fbl_gym.checks import Pair
from fbl_gym.scenarios import Scenario

FULL_TURN = 1.5 * math.pi
"""The arc [rad] that stands for a joint's whole torque."""

TRAIL_SPAN, TRAIL_STEP = 1.5, 0.02
"""How long the tip's trace lasts, and how far apart its points are [s]."""

WINDOW_FPS = 50
"""The window shows so many pictures per simulated second, at most."""


@dataclass(frozen=True)
class Picture:
    """One instant of one arm, in plain numbers: all that a frame shows.

    Args:
        title, subtitle: above the arm, left.
        time: since the episode's start [s].
        lengths: true lengths of the links [m].
        position, reference: joint angles [rad].
        torque: applied to the joints [N m].
        push: what the disturbance adds to it, -tau_d of equation (1) [N m]; None: the scenario has none.
        full_torque: what the longest arc stands for [N m].
        payload: mass carried at the tip [kg].
        trail: where the tip was, oldest first, [k x 3] as (time [s], x, y [m]).
    """

    title: str
    subtitle: str
    time: float
    lengths: Pair
    position: Pair
    reference: Pair
    torque: Pair
    push: Pair | None
    full_torque: Pair
    payload: float
    trail: Array


def full_torque(scenario: Scenario) -> Pair:
    """The torque limits; of drives without, ten times what holds the nominal arm stretched out on Earth [N m]."""
    if scenario.actuator.torque_limit is not None:
        return scenario.actuator.torque_limit  # type: ignore[return-value]
    *_, p4, p5 = dataclasses.replace(scenario.arm, gravity=STANDARD_GRAVITY).lumped
    return 10.0 * float(p4 + p5), 10.0 * float(p5)


class Trail:
    """The tip's recent way, kept from one picture to the next. An earlier time than the last begins a new one."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float, float]] = []

    def extended(self, now: float, tip: Array) -> Array:
        """The trail up to and with `tip` [2] at the time `now`, [k x 3]."""
        points = [p for p in self._points if now - TRAIL_SPAN <= p[0] < now]
        if len(points) > 1 and points[-1][0] - points[-2][0] < 0.99 * TRAIL_STEP:
            points.pop()
        self._points = [*points, (now, float(tip[0]), float(tip[1]))]
        return np.array(self._points)


class View:
    """The pictures of one arm, from its truth, and the window that shows them.

    Args:
        scenario: what the arm lives in.
        size: of a frame, which is square [pixels].
    """

    def __init__(self, scenario: Scenario, size: int) -> None:
        self.scenario = scenario
        self.size = size
        self._full_torque = full_torque(scenario)
        self._trail = Trail()
        self._shown, self._due = math.inf, 0.0
        self._frame: Frame | None = None

    def picture(self, truth: Truth) -> Picture:
        """What is to be seen now, of the truth of a single arm; the trail remembers it."""
        q, r = _pair(truth.position), _pair(truth.reference)
        lengths, now = _pair(truth.lengths), float(truth.time)
        return Picture(
            title=self.scenario.name,
            subtitle="",
            time=now,
            lengths=lengths,
            position=q,
            reference=r,
            torque=_pair(truth.applied_torque),
            push=None if self.scenario.disturbance is None else _pair(-truth.disturbance),
            full_torque=self._full_torque,
            payload=float(truth.payload),
            trail=self._trail.extended(now, _joints(lengths, q)[2]),
        )

    def frame(self, truth: Truth) -> Frame:
        """The frame of this instant, [size x size x 3]."""
        return draw(self.picture(truth), self.size)

    def show(self, truth: Truth) -> None:
        """Show this instant in the window, no sooner than its time has come; in between, leave the window as it is."""
        picture = self.picture(truth)
        passed = picture.time - self._shown
        if 0.0 <= passed < 0.99 / WINDOW_FPS:
            return
        frame = draw(picture, self.size)
        now = time.perf_counter()
        due = self._due + passed
        if now < due < now + passed:
            time.sleep(due - now)
        else:  # a new episode, or late
            due = now
        self._shown, self._due = picture.time, due
        self._frame = frame
        _OPEN[self] = None
        _paint()

    def close(self) -> None:
        """Leave the window, if the arm stands in it; the last one closes it."""
        if self in _OPEN:
            del _OPEN[self]
            _paint()


_OPEN: weakref.WeakKeyDictionary[View, None] = weakref.WeakKeyDictionary()
"""The arms in the window, from left to right: pygame has one window for a process, so several stand side by side."""


def _paint() -> None:
    """Show every open view's last frame; without any, close the window."""
    views = list(_OPEN)
    if not views:
        pygame.display.quit()
        return
    size = sum(view.size for view in views), max(view.size for view in views)
    window = pygame.display.get_surface()
    if window is None or window.get_size() != size:
        pygame.display.init()
        pygame.display.set_caption("fbl-gym")
        window = pygame.display.set_mode(size)
        window.fill(PAPER)
    left = 0
    for view in views:
        assert view._frame is not None
        pygame.surfarray.blit_array(window.subsurface((left, 0, view.size, view.size)), view._frame.swapaxes(0, 1))
        left += view.size
    pygame.event.pump()
    pygame.display.flip()


def _pair(x: Array) -> Pair:
    """Of a diverged arm, what is no longer a number is drawn as zero."""
    first, second = np.nan_to_num(x, posinf=0.0, neginf=0.0).tolist()
    return first, second


def _joints(lengths: Pair, q: Pair) -> Array:
    return joint_positions(ArmParameters(L1=lengths[0], L2=lengths[1]), q)


# Where things lie, as fractions of the frame's size.

CENTRE = (0.5, 0.458)
REACH = 0.35
MARGIN = 0.035
TITLE, SUBTITLE, SCALE, TABLE = 0.045, 0.088, 0.785, 0.856
LETTERS = 0.034
WIDTHS = (0.04, 0.032, 0.02)
"""Of the links at base, elbow and tip."""


def project(points: Array, lengths: Pair, size: int) -> Array:
    """Where points [... x 2] in metres lie in a frame, [... x 2] in pixels from the upper left corner, y downwards."""
    scale = REACH * size / sum(lengths)
    return size * np.array(CENTRE) + scale * np.asarray(points) * (1.0, -1.0)


def draw(picture: Picture, size: int = 480) -> Frame:
    """The frame of a picture, [size x size x 3].

    The ring is how far the arm reaches; grey is where the reference wants it. Arcs at each joint, from its link on, are the
    torque applied and the push of the disturbance; their length grows with the square root of their share of the full torque.
    """
    canvas = Canvas(size, size)
    reach = functools.partial(project, lengths=picture.lengths, size=size)
    base, elbow, tip = _points(reach(_joints(picture.lengths, picture.position)))
    canvas.ring(base, REACH * size, 0.003 * size, RULE)
    canvas.line([base, (base[0], base[1] + 0.085 * size)], [0.06 * size] * 2, RULE)
    _draw_scale(canvas, picture.lengths, size)
    if len(picture.trail) > 1:
        age = (picture.time - picture.trail[:, 0]) / TRAIL_SPAN
        canvas.trail(_points(reach(picture.trail[:, 1:])), 1.0 - age, 0.006 * size, SKY)
    widths = [size * width for width in WIDTHS]
    canvas.line(_points(reach(_joints(picture.lengths, picture.reference))), widths, GHOST, 0.5)
    if picture.payload > 0.0:
        canvas.disc(tip, 0.03 * size, ORANGE)
    canvas.line([base, elbow, tip], widths, BLUE)
    _draw_torques(canvas, picture, (base, elbow), size)
    for joint, radius in ((base, 0.013), (elbow, 0.011), (tip, 0.009)):
        canvas.disc(joint, (radius + 0.004) * size, PAPER)
        canvas.disc(joint, radius * size, INK)
    _write_numbers(canvas, picture, size)
    return canvas.frame


def _draw_scale(canvas: Canvas, lengths: Pair, size: int) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, below the ring's right."""
    metre = REACH * size / sum(lengths)
    longest = 0.16 * size / metre
    decade = 10.0 ** math.floor(math.log10(longest))
    length = decade * max(n for n in (1, 2, 5) if n * decade <= longest)
    right, y, tick, thin = (1.0 - MARGIN) * size, SCALE * size, 0.008 * size, [0.004 * size] * 2
    left = right - length * metre
    canvas.line([(left, y), (right, y)], thin, GHOST)
    for x in (left, right):
        canvas.line([(x, y - tick), (x, y + tick)], thin, GHOST)
    canvas.write(f"{length:g} m", ((left + right) / 2, y - 0.026 * size), 0.9 * LETTERS * size, GHOST, 0.5)


def _draw_torques(canvas: Canvas, picture: Picture, joints: tuple[Point, Point], size: int) -> None:
    q1, q2 = picture.position
    push = picture.push or (0.0, 0.0)
    for i, (joint, angle) in enumerate(zip(joints, (q1, q1 + q2), strict=True)):
        for torque, radius, colour in ((picture.torque[i], 0.052, VERMILLION), (push[i], 0.076, PURPLE)):
            share = min(abs(torque) / picture.full_torque[i], 1.0)
            sweep = math.copysign(FULL_TURN * math.sqrt(share), torque)
            beside = math.copysign(0.6 * WIDTHS[0] / radius, torque)  # the link
            canvas.arrow(joint, radius * size, angle + beside, sweep, 0.007 * size, colour)


def _write_numbers(canvas: Canvas, picture: Picture, size: int) -> None:
    left, right, line = MARGIN * size, (1.0 - MARGIN) * size, LETTERS * size
    canvas.write(picture.title, (left, TITLE * size), 1.2 * line, INK)
    canvas.write(picture.subtitle, (left, SUBTITLE * size), line, INK)
    canvas.write(f"{picture.time:.2f} s", (right, TITLE * size), 1.2 * line, INK, 1.0)
    if picture.payload > 0.0:
        canvas.write(f"payload {picture.payload:.3g} kg", (right, SUBTITLE * size), line, INK, 1.0)
    error = [1e3 * (r - q) for r, q in zip(picture.reference, picture.position, strict=True)]
    rows = [("error [mrad]", error, GHOST), ("torque [N m]", picture.torque, VERMILLION)]
    if picture.push is not None:
        rows.append(("push [N m]", picture.push, PURPLE))
    columns = (0.7 * size, right)
    for i, x in enumerate(columns):
        canvas.write(f"joint {i + 1}", (x, TABLE * size), line, INK, 1.0)
    for i, (name, values, colour) in enumerate(rows, start=1):
        y = TABLE * size + 1.06 * i * line
        canvas.disc((left + 0.3 * line, y), 0.25 * line, colour)
        canvas.write(name, (left + line, y), line, INK)
        for value, x in zip(values, columns, strict=True):
            number = f"{value:+,.1f}" if abs(value) < 1e6 else f"{value:+.1e}"
            canvas.write(number.replace("-", "\N{MINUS SIGN}"), (x, y), line, INK, 1.0)


def _points(array: Array) -> list[Point]:
    return [(x, y) for x, y in array.tolist()]
