"""Figures that a journal takes; the window of running arms, by scripted mouse and keys without a display."""

import dataclasses
import re

import numpy as np
import pytest
from PIL import Image

import benchmarks
from benchmarks.cli import play
from benchmarks.cli.play import SIZE, Game, picture, pygame
from benchmarks.policies.spec import resolve
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
@pytest.mark.parametrize("label", ["b", "_", "_law.py"])
def test_the_ending_gives_the_format_and_a_width_leaves_out_the_title(width, label, tmp_path):
    panels = [Panel("", "time [s]", "error [%]", (Line(X, X, "a", low=X - 1, high=X + 1), Line(X, X, label)))]
    for ending in ("png", "pdf", "svg"):
        plot_lines("the title", panels, tmp_path / f"figure.{ending}", width)
    pdf, svg = (tmp_path / "figure.pdf").read_bytes(), (tmp_path / "figure.svg").read_text()
    assert b"/FontFile2" in pdf  # TrueType, embedded
    assert b"/Type3" not in pdf
    assert ">error [%]</text>" in svg
    assert (f">{label}</text>" in svg.replace("> ", ">")) == (label != "_")
    assert (">the title</text>" in svg) == (width is None)
    with Image.open(tmp_path / "figure.png") as picture:
        assert (picture.width, picture.info["Title"]) == (round(300 * plot.WIDTHS[width or 2]), "the title")


@pytest.mark.parametrize(("low", "labels"), [(0.2, "0.2 0.3 0.5 1"), (0.02, "0.03 0.1 0.3 1"), (1e-4, "0.0001 0.001")])
def test_a_logarithmic_axis_has_plain_numbers(low, labels, tmp_path):
    line = Line(np.array([low, 1.0]), np.array([1.0, 2.0]), "_law.py", color="black")
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


# The window, and the film of a notebook.


@pytest.fixture
def game():
    laws = [resolve(name) for name in ("pid-flm", "cascade-flm", "computed-torque")]
    return Game(laws, scenarios.get("nominal").replace(duration=5.0), 0)


def press(game, kind, **details):
    return game.handle(pygame.event.Event(kind, details))


def advance(game, pictures):
    """Advance, and return the truth of each arm."""
    for _ in range(pictures):
        game.advance()
    return [arm.env.truth for arm in game.arms]


def test_the_tip_of_the_reference_goes_where_the_mouse_drags_it(game):
    press(game, pygame.MOUSEBUTTONDOWN, pos=(SIZE + 330, 320))
    press(game, pygame.MOUSEMOTION, pos=(SIZE + 340, 300))
    for truth in advance(game, 40):
        tip = picture.chain(truth.lengths, truth.reference, (0.0, 0.0))[-1]
        np.testing.assert_allclose(picture.project(tip, truth.lengths, SIZE), (340, 300), atol=1.0)
        assert np.abs(truth.reference - truth.position).max() < 0.1
    target = game.target
    press(game, pygame.MOUSEBUTTONUP)
    press(game, pygame.MOUSEMOTION, pos=(10, 10))
    assert game.target == target


def test_the_larger_torque_limit_is_the_stiffness_of_a_drag():
    task = scenarios.get("nominal").replace(actuator={"torque_limit": (0.0, 50.0)})
    game = Game([resolve("zero")], task, 0)
    assert game.stiffness == pytest.approx(50.0 / game.reach**2)


def test_a_drag_of_a_link_pushes_both_arms_alike(game):
    arm = game.arms[0]
    tip = picture.project(arm.joints()[2], arm.lengths, SIZE)
    press(game, pygame.MOUSEBUTTONDOWN, pos=tuple(tip))
    press(game, pygame.MOUSEMOTION, pos=(tip[0] + 100, tip[1]))
    force = game.stiffness * 100 * game.reach / (picture.REACH * SIZE)  # along x
    levers = arm.joints()[2] - arm.joints()[:2]
    first, second = advance(game, 1)
    np.testing.assert_allclose(first.disturbance, levers[:, 1] * force, rtol=1e-6)
    np.testing.assert_array_equal(first.disturbance, second.disturbance)
    press(game, pygame.MOUSEBUTTONUP)
    assert not np.any([truth.disturbance for truth in advance(game, 1)])


def test_keys_change_payload_drive_noise_and_law_and_r_begins_again(game):
    start = game.frame()
    press(game, pygame.MOUSEMOTION, pos=(SIZE + 5, 5))
    for key in "pbn3":
        press(game, pygame.KEYDOWN, unicode=key)
    for truth in advance(game, 2):
        assert (truth.payload, *truth.gain) == (game.mass, 1.0, 0.5)
    assert [arm.law for arm in game.arms] == [0, 2]
    assert not np.array_equal(game.arms[0].observation[:2], game.arms[0].env.truth.position)
    press(game, pygame.KEYDOWN, unicode="d")
    assert advance(game, 1)[0].payload == 0.0
    press(game, pygame.KEYDOWN, unicode="r")
    game.arms[1].law = 1
    np.testing.assert_array_equal(game.frame(), start)
    assert not press(game, pygame.KEYDOWN, unicode="q")


def test_an_arm_that_diverged_stays_and_the_frame_says_so():
    game = Game([resolve("zero")], scenarios.get("nominal").replace(duration=1.0), 0)
    before = game.frame()
    game.arms[0].diverged = game.arms[0].over = True
    game.advance()
    assert game.over
    assert not np.array_equal(game.frame(), before)


def test_the_command_records_a_film_in_real_time(tmp_path, fbl_gym):
    path = tmp_path / "play.gif"
    assert str(path) in fbl_gym(f"play zero --seconds 0.5 --record {path}").out
    with Image.open(path) as film:
        assert film.size == (SIZE, SIZE + 2 * play.STRIP + 2 * play.LINE)
        assert film.n_frames <= 10  # equal frames become one


def test_a_notebook_shows_an_animation():
    short = scenarios.get("disturbance-3").replace(duration=0.3)
    film = benchmarks.animate(["pid-flm", "cascade-flm"], short, size=160)
    assert (film._repr_html_().count("data:image/png"), [*film._fig.bbox.size]) == (6, [320, 160])
