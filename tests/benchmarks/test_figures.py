"""Figures that a journal takes."""

import dataclasses
import re

import numpy as np
import pytest
from PIL import Image

from benchmarks.report import plot
from benchmarks.report.plot import Line, Panel, plot_comparison, plot_lines, plot_trace
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios

X = np.linspace(0.0, 1.0, 5)


@pytest.fixture(scope="module")
def trace():
    return rollout("pd-gravity", scenarios.get("noise-2").replace(duration=0.6), range(3))


@pytest.fixture
def panels(monkeypatch):
    """The panels that are drawn, instead of a figure."""
    drawn = []
    monkeypatch.setattr(plot, "plot_lines", lambda _title, panels, *_, **__: drawn.extend(panels))
    return drawn


@pytest.mark.parametrize("width", [1, 2, None])
@pytest.mark.parametrize("label", ["b", "_"])
def test_the_ending_gives_the_format_and_a_width_leaves_out_the_title(width, label, tmp_path):
    panels = [Panel("", "time [s]", "error [%]", (Line(X, X, "a", low=X - 1, high=X + 1), Line(X, X, label)))]
    for ending in ("png", "pdf", "svg"):
        plot_lines("the title", panels, tmp_path / f"figure.{ending}", width)
    pdf, svg = (tmp_path / "figure.pdf").read_bytes(), (tmp_path / "figure.svg").read_text()
    assert b"/FontFile2" in pdf  # TrueType, embedded
    assert b"/Type3" not in pdf
    assert ">error [%]</text>" in svg
    assert (">the title</text>" in svg) == (width is None)
    with Image.open(tmp_path / "figure.png") as picture:
        assert (picture.width, picture.info["Title"]) == (round(300 * plot.WIDTHS[width or 2]), "the title")


@pytest.mark.parametrize(("low", "labels"), [(0.2, "0.2 0.3 0.5 1"), (0.02, "0.03 0.1 0.3 1"), (1e-4, "0.0001 0.001")])
def test_a_logarithmic_axis_has_plain_numbers(low, labels, tmp_path):
    line = Line(np.array([low, 1.0]), np.array([1.0, 2.0]), "a", color="black")
    plot_lines("t", [Panel("", "x", "y", (line,), ("log", "linear"))], tmp_path / "figure.svg")
    drawn = re.findall(r">([^<]+)</text>", (tmp_path / "figure.svg").read_text())
    assert set(labels.split()) <= set(drawn)
    assert len(drawn) < 25


def test_lines_differ_in_grey_print():
    assert len({(plot.MARKERS[i % len(plot.MARKERS)], plot.DASHES[i % len(plot.DASHES)]) for i in range(28)}) == 28


def test_several_seeds_give_medians_and_bands(trace, panels, tmp_path):
    plot_trace(trace, "t", tmp_path / "trace.png")
    angle, error, torque = panels  # no disturbance acts
    np.testing.assert_array_equal(angle.lines[0].y, trace.position[:, 0, 0])  # each seed has its reference
    np.testing.assert_allclose(torque.lines[1].y, np.median(trace.torque[..., 1], axis=1))
    assert np.all(error.lines[0].low <= error.lines[0].high)
    panels.clear()
    first = {name: getattr(trace, name)[:, :1] for name in ("position", "reference", "torque", "alive", "disturbance")}
    plot_trace(dataclasses.replace(trace, seeds=(0,), **first), "t", tmp_path / "trace.png")
    assert panels[1].lines[0].low is None


def test_a_diverged_run_counts_in_a_comparison(trace, panels, tmp_path):
    dead = dataclasses.replace(trace, alive=np.zeros_like(trace.alive))
    plot_comparison({"a": trace, "dead": dead}, "t", tmp_path / "errors.png")
    np.testing.assert_allclose(panels[0].lines[1].y, 1e3 * np.pi)
    assert len(panels[0].lines[0].x) == 50
    assert panels[0].lines[0].y.max() < 1e3
    # Angles and torques are those of the first seed.
    np.testing.assert_array_equal(panels[3].lines[0].y, trace.position[:, 0, 1])
    np.testing.assert_array_equal(panels[4].lines[0].y, trace.torque[:, 0, 0])
    assert np.isnan(panels[4].lines[1].y).all()
