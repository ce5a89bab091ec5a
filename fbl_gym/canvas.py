"""Paper that shapes and letters are painted on, in plain NumPy; it knows nothing of arms.

Shapes are painted by their signed distance: a pixel is covered by as much of it as lies inside the edge, so edges are smooth
and nothing is rounded to whole pixels. Letters are pygame's, and whoever needs pygame takes it from here.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame greets on the standard output
try:
    import pygame
except ImportError as problem:
    raise DependencyNotInstalled("drawing needs pygame: pip install 'fbl-gym[render]'") from problem

Frame: TypeAlias = NDArray[np.uint8]
Pixels: TypeAlias = NDArray[np.floating[Any]]
Distance: TypeAlias = Callable[[Pixels, Pixels], Pixels]
Point: TypeAlias = tuple[float, float]
Colour: TypeAlias = tuple[int, int, int]

# Okabe and Ito, "Color Universal Design" (2008): told apart with any colour vision.
BLUE, SKY, ORANGE = (0, 114, 178), (86, 180, 233), (230, 159, 0)
VERMILLION, PURPLE = (213, 94, 0), (204, 121, 167)
PAPER, RULE, GHOST, INK = (252, 252, 250), (224, 224, 220), (168, 168, 164), (44, 44, 44)


class Canvas:
    """Paper that shapes are painted on; lengths and positions in pixels from the upper left corner, y downwards.

    The distances are those of Quilez, "2D distance functions" (https://iquilezles.org/articles/distfunctions2d).
    """

    def __init__(self, width: int, height: int) -> None:
        self._pixels = np.empty((3, height, width), dtype=np.float32)
        self._pixels[:] = _channels(PAPER)

    @property
    def frame(self) -> Frame:
        """What was painted, [height x width x 3]."""
        return np.ascontiguousarray(np.moveaxis((self._pixels + np.float32(0.5)).astype(np.uint8), 0, -1))

    def disc(self, centre: Point, radius: float, colour: Colour) -> None:
        """A filled circle."""
        self._paint([centre], radius, lambda x, y: _length(x, y, centre) - radius, colour)

    def ring(self, centre: Point, radius: float, width: float, colour: Colour) -> None:
        """A circle."""
        self._paint([centre], radius + width, lambda x, y: abs(_length(x, y, centre) - radius) - width / 2, colour)

    def line(self, points: Sequence[Point], widths: Sequence[float], colour: Colour, opacity: float = 1.0) -> None:
        """A line through some points, with its width at each, and round ends."""

        def distance(x: Pixels, y: Pixels) -> Pixels:
            pieces = zip(points[:-1], points[1:], widths[:-1], widths[1:], strict=True)
            return functools.reduce(np.minimum, (_along(x, y, *piece) for piece in pieces))

        self._paint(points, max(widths), distance, colour, opacity)

    def trail(self, points: Sequence[Point], opacity: Pixels, width: float, colour: Colour) -> None:
        """A line through many points, as opaque at each as `opacity` [k] says."""
        rows, columns = self._region(points, width)
        cover = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
        for a, b, strength in zip(points[:-1], points[1:], opacity[1:].tolist(), strict=True):
            y, x = self._region([a, b], width)
            piece = cover[y.start - rows.start : y.stop - rows.start, x.start - columns.start : x.stop - columns.start]
            inside = _cover((y, x), lambda x, y, a=a, b=b: _along(x, y, a, b, width, width))  # type: ignore[misc]
            np.maximum(piece, strength * inside, out=piece)
        self._blend((rows, columns), cover, colour)

    def arrow(self, centre: Point, radius: float, start: float, sweep: float, width: float, colour: Colour) -> None:
        """An arc about a centre, with an arrowhead beyond its end; angles counter-clockwise from the right [rad]."""
        if abs(sweep) * radius < 0.5 * width:
            return
        end, middle = start + sweep, start + sweep / 2

        def distance(x: Pixels, y: Pixels) -> Pixels:
            away = np.arctan2(centre[1] - y, x - centre[0]) - middle
            within = abs((away + math.pi) % (2 * math.pi) - math.pi) <= abs(sweep) / 2
            to_ends = (_length(x, y, _on_circle(centre, radius, angle)) for angle in (start, end))
            return np.where(within, abs(_length(x, y, centre) - radius), np.minimum(*to_ends)) - width / 2

        self._paint([centre], radius + width, distance, colour)
        head = 3.0 * width
        point = _on_circle(centre, radius, end + math.copysign(head / radius, sweep))
        wing = math.copysign(0.6 * head, sweep)
        self._polygon([point, *(_on_circle(centre, radius + w, end) for w in (-wing, wing))], colour)

    def write(self, text: str, at: Point, height: float, colour: Colour, align: float = 0.0) -> None:
        """A line of text.

        Args:
            text: what to write.
            at: a point at half its height; where along its width, `align` says.
            height: of the line.
            colour: of the letters.
            align: 0: `at` is its left end, 1/2: its middle, 1: its right end.
        """
        letters = _letters(text, height)
        high, wide = letters.shape
        left, top = max(round(at[0] - align * wide), 0), max(round(at[1] - high / 2), 0)
        letters = letters[: self._pixels.shape[1] - top, : self._pixels.shape[2] - left]
        self._blend((slice(top, top + high), slice(left, left + wide)), letters, colour)

    def _polygon(self, corners: Sequence[Point], colour: Colour) -> None:
        """A filled convex polygon, its corners in counter-clockwise order as seen."""

        def distance(x: Pixels, y: Pixels) -> Pixels:
            sides = []
            for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
                sides.append(((y - y0) * (x1 - x0) - (x - x0) * (y1 - y0)) / math.hypot(x1 - x0, y1 - y0))
            return np.maximum.reduce(sides)

        self._paint(corners, 0.0, distance, colour)

    def _paint(
        self, points: Sequence[Point], margin: float, distance: Distance, colour: Colour, opacity: float = 1.0
    ) -> None:
        """Paint where the signed distance to an edge is negative, which it is only within `margin` of the points."""
        region = self._region(points, margin)
        self._blend(region, opacity * _cover(region, distance), colour)

    def _region(self, points: Sequence[Point], margin: float) -> tuple[slice, slice]:
        """The rows and columns with everything that is within `margin` of the points."""
        _, height, width = self._pixels.shape
        x, y = [p[0] for p in points], [p[1] for p in points]
        return _span(min(y) - margin, max(y) + margin, height), _span(min(x) - margin, max(x) + margin, width)

    def _blend(self, region: tuple[slice, slice], cover: Pixels, colour: Colour) -> None:
        rows, columns = region
        part = self._pixels[:, rows, columns]
        part += cover * (_channels(colour) - part)


def _channels(colour: Colour) -> Pixels:
    return np.array(colour, dtype=np.float32)[:, None, None]


def _span(low: float, high: float, size: int) -> slice:
    """The pixels out of `size` between two edges, with one more on either side for the soft edge."""
    start = min(max(math.floor(low) - 1, 0), size)
    return slice(start, max(min(math.ceil(high) + 1, size), start))


def _cover(region: tuple[slice, slice], distance: Distance) -> Pixels:
    """How much of each pixel is covered: all where its centre lies half a pixel inside the edge, none as far outside."""
    rows, columns = region
    y = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None] + np.float32(0.5)
    x = np.arange(columns.start, columns.stop, dtype=np.float32) + np.float32(0.5)
    return np.clip(0.5 - distance(x, y), 0.0, 1.0)


def _length(x: Pixels, y: Pixels, centre: Point) -> Pixels:
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2)


def _along(x: Pixels, y: Pixels, a: Point, b: Point, width_a: float, width_b: float) -> Pixels:
    """Distance to the edge of a straight piece from a to b whose width goes from one value to the other."""
    x, y, bx, by = x - a[0], y - a[1], b[0] - a[0], b[1] - a[1]
    h = np.clip((x * bx + y * by) / max(bx * bx + by * by, 1e-12), 0.0, 1.0)
    return np.sqrt((x - h * bx) ** 2 + (y - h * by) ** 2) - 0.5 * (width_a + h * (width_b - width_a))


def _on_circle(centre: Point, radius: float, angle: float) -> Point:
    return centre[0] + radius * math.cos(angle), centre[1] - radius * math.sin(angle)


@functools.lru_cache(maxsize=256)
def _letters(text: str, height: float) -> Pixels:
    """How much of each pixel the letters of a line cover, [rows x columns]; drawn four times as large and averaged."""
    n = 4
    pygame.font.init()
    surface = pygame.font.Font(None, round(1.36 * n * height)).render(text, True, INK)
    fine = pygame.surfarray.array_alpha(surface).T.astype(np.float32) / 255.0
    fine = np.pad(fine, [(0, -k % n) for k in fine.shape])
    return fine.reshape(fine.shape[0] // n, n, fine.shape[1] // n, n).mean(axis=(1, 3))
