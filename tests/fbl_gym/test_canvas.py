"""Shapes on paper, against their formulas."""

import numpy as np
import pytest

from fbl_gym.canvas import INK, PAPER, PURPLE, Canvas


def test_shapes_cover_what_geometry_says():
    """Edges are soft, and lose no area: disc, ring, tapered line and arrow against their formulas."""

    def area(paint):
        canvas = Canvas(200, 200)
        paint(canvas)
        ink = np.array(PAPER, dtype=float) - canvas.frame
        return (ink.sum(axis=-1) / (np.array(PAPER) - INK).sum()).sum()

    centre = (100.3, 99.6)
    assert area(lambda c: c.disc(centre, 30.0, INK)) == pytest.approx(np.pi * 30**2, rel=2e-3)
    assert area(lambda c: c.ring(centre, 60.0, 4.0, INK)) == pytest.approx(2 * np.pi * 60 * 4, rel=2e-3)
    tapered = area(lambda c: c.line([(40, 50), (160, 50)], [20, 10], INK))
    assert tapered == pytest.approx(120 * 15 + np.pi / 2 * (10**2 + 5**2), rel=2e-3)
    # An arc with round ends and a head of three widths' length, less the end that the head covers.
    arrow = 60 * 2.0 * 4 + np.pi * 2**2 / 2 + 12 * 14.4 / 2
    assert area(lambda c: c.arrow(centre, 60.0, 0.5, 2.0, 4.0, INK)) == pytest.approx(arrow, rel=2e-2)
    assert area(lambda c: c.arrow(centre, 60.0, 0.5, -2.0, 4.0, INK)) == pytest.approx(arrow, rel=2e-2)


def test_what_lies_outside_the_canvas_is_left_out():
    canvas = Canvas(40, 30)
    canvas.disc((-50.0, 10.0), 20.0, INK)
    canvas.line([(100.0, 100.0), (200.0, 100.0)], [5.0, 5.0], INK)
    canvas.write("far too long for so small a canvas", (20.0, 15.0), 12.0, PURPLE, 0.5)
    assert canvas.frame.shape == (30, 40, 3)
    assert not (canvas.frame == INK).all(axis=-1).any()
    assert not (canvas.frame == PAPER).all()
