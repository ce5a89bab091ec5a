"""A picture of the arm: `draw` turns an instant into a frame with pygame, without a display.

Shapes are drawn larger than the frame and averaged, so that edges are smooth.
"""

import functools
import math
import os
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array
from fbl_gym.model.chain import HINGE
from fbl_gym.records.checks import Pair

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame prints a greeting
try:
    import pygame
except ImportError as problem:
    raise DependencyNotInstalled("drawing needs pygame: pip install 'fbl-gym[render]'") from problem

Frame: TypeAlias = NDArray[np.uint8]
Point: TypeAlias = tuple[float, float]
Colour: TypeAlias = tuple[int, int, int]

# Okabe and Ito, "Color Universal Design" (2008): distinguishable with any colour vision.
BLUE, ORANGE = (0, 114, 178), (230, 159, 0)
VERMILLION = (213, 94, 0)
PAPER, RULE, GHOST, INK = (252, 252, 250), (224, 224, 220), (168, 168, 164), (44, 44, 44)
PALE = (210, 210, 207)

# Positions and lengths, as fractions of the frame's size.
CENTRE = (0.5, 0.458)
REACH = 0.35
MARGIN = 0.035
TITLE, SECOND, TABLE = 0.045, 0.088, 0.856
LETTERS = 0.034
#: Widths of the links at base, hinge, elbow, hinge and tip.
WIDTHS = (0.04, 0.0388, 0.032, 0.0302, 0.02)

#: Mass of the payload's disc by its area, at the scale of the arm [kg/m^2].
PLATE = 150.0

#: A canvas has this many times the frame's pixels in each direction.
FINER = 3


def project(points: Array, lengths: Pair, size: int) -> Array:
    """Return the pixels of points [... x 2] m, from the frame's upper left corner, y downwards."""
    scale = REACH * size / sum(lengths)
    return size * np.array(CENTRE) + scale * np.asarray(points) * (1.0, -1.0)


def unproject(pixel: Point, lengths: Pair, size: int) -> Array:
    """Return the point [2] m of a pixel of a frame: the inverse of `project`."""
    scale = REACH * size / sum(lengths)
    return (np.array(pixel) - size * np.array(CENTRE)) * (1.0, -1.0) / scale


def chain(lengths: Pair, q: Pair, bend: Pair) -> Array:
    """Return the positions of base, hinge, elbow, hinge and tip, [5 x 2] m."""
    angles = np.cumsum([q[0], bend[0], q[1], bend[1]])
    parts = np.outer(lengths, (HINGE, 1.0 - HINGE)).ravel()
    return np.cumsum([[0.0, 0.0], *(parts * (np.cos(angles), np.sin(angles))).T], axis=0)


def draw(truth: Truth, title: str, size: int = 480, disturbed: bool = False) -> Frame:
    """Return the frame of an instant of one arm, [size x size x 3].

    It shows the arm in blue, the reference in grey, the payload, and the errors and torques of both
    joints as numbers, below a title; with `disturbed` also the disturbance, -tau_d of equation (1).
    """
    size = FINER * size
    lengths, position, bend, reference = map(pair, (truth.lengths, truth.position, truth.bend, truth.reference))
    canvas = pygame.Surface((size, size), depth=32)
    canvas.fill(PAPER)
    links = project(chain(lengths, position, bend), lengths, size).tolist()
    base, _, elbow, _, tip = links
    pygame.draw.circle(canvas, RULE, base, (REACH + 0.0015) * size, round(0.003 * size))
    for width, colour in ((0.06, GHOST), (0.053, PAPER)):  # the mount: an outline, where the reference is an area
        _line(canvas, [base, (base[0], base[1] + 0.085 * size)], [width * size] * 2, colour)
    widths = [size * width for width in WIDTHS]
    _line(canvas, project(chain(lengths, reference, (0.0, 0.0)), lengths, size).tolist(), widths, PALE)
    if truth.payload > 0.0:
        scale = REACH / sum(lengths)
        area = 0.013**2 + scale**2 * float(truth.payload) / (math.pi * PLATE)  # around the tip's own disc
        pygame.draw.circle(canvas, ORANGE, tip, math.sqrt(area) * size)
    _line(canvas, links, widths, BLUE)
    for joint, radius in ((base, 0.013), (elbow, 0.011), (tip, 0.009)):
        pygame.draw.circle(canvas, PAPER, joint, (radius + 0.004) * size)
        pygame.draw.circle(canvas, INK, joint, radius * size)
    left, right, line = MARGIN * size, (1.0 - MARGIN) * size, LETTERS * size
    write(canvas, title, (left, TITLE * size), 1.2 * line, INK)
    write(canvas, f"{truth.time:.2f} s", (right, TITLE * size), 1.2 * line, INK, 1.0)
    if truth.payload > 0.0:
        write(canvas, f"payload {truth.payload:.3g} kg", (right, SECOND * size), line, INK, 1.0)
    rows = [("error [mrad]", 1e3 * np.subtract(reference, position)), ("torque [N m]", pair(truth.applied_torque))]
    rows += [("disturbance [N m]", pair(-truth.disturbance))] if disturbed else []
    columns = (0.7 * size, right)
    for joint, x in enumerate(columns, start=1):
        write(canvas, f"joint {joint}", (x, TABLE * size), line, INK, 1.0)
    for row, (name, values) in enumerate(rows, start=1):
        y = TABLE * size + 1.06 * row * line
        write(canvas, name, (left, y), line, INK)
        for value, x in zip(values, columns, strict=True):
            number = f"{value + 0.0:+,.1f}" if abs(value) < 1e6 else f"{value:+.1e}"
            write(canvas, number.replace("-", "\N{MINUS SIGN}"), (x, y), line, INK, 1.0)
    smooth = pygame.transform.smoothscale(canvas, (size // FINER, size // FINER))
    return np.ascontiguousarray(pygame.surfarray.array3d(smooth).swapaxes(0, 1))


def pair(x: Array) -> Pair:
    """Return two floats, with zero for the infinite or undefined values of a diverged arm."""
    first, second = np.nan_to_num(x, posinf=0.0, neginf=0.0).tolist()
    return first, second


def _line(canvas: pygame.Surface, points: Sequence[Point], widths: Sequence[float], colour: Colour) -> None:
    """Draw a line through points, with its width at each, and round ends."""
    for (x0, y0), (x1, y1), w0, w1 in zip(points[:-1], points[1:], widths[:-1], widths[1:], strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        if length > 0.0:
            nx, ny = (y1 - y0) / length / 2, (x0 - x1) / length / 2
            corners = [(x0 + w0 * nx, y0 + w0 * ny), (x1 + w1 * nx, y1 + w1 * ny)]
            corners += [(x1 - w1 * nx, y1 - w1 * ny), (x0 - w0 * nx, y0 - w0 * ny)]
            pygame.draw.polygon(canvas, colour, corners)
    for point, width in zip(points, widths, strict=True):
        pygame.draw.circle(canvas, colour, point, width / 2)


def write(canvas: pygame.Surface, text: str, at: Point, height: float, colour: Colour, align: float = 0.0) -> None:
    """Write a line of text, at half of whose height is the point `at`.

    `align` 0: `at` is the left end, 1/2: the middle, 1: the right end.
    """
    letters = _letters(text, round(1.36 * height), colour)
    wide, high = letters.get_size()
    canvas.blit(letters, (max(round(at[0] - align * wide), 0), max(round(at[1] - high / 2), 0)))


@functools.lru_cache(maxsize=256)
def _letters(text: str, height: int, colour: Colour) -> pygame.Surface:
    """Return a line of text. Its surface survives `pygame.quit`, a font does not."""
    pygame.font.init()
    return pygame.font.Font(None, height).render(text, True, colour)
