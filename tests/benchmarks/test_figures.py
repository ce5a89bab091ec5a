"""Figures that a journal takes, and films in real time, side by side, of the arm that the environment draws."""

import dataclasses
import itertools

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import controllers
from benchmarks.report import plot
from benchmarks.report.plot import Line, Panel, plot_comparison, plot_lines, plot_trace
from benchmarks.report.video import film, picture, write_video
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.view.render import View

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


@pytest.mark.parametrize("columns", [1, 2])
def test_the_ending_gives_the_format(columns, tmp_path):
    panels = [Panel("", "time [s]", "error [%]", (Line(X, X, "a", low=X - 1, high=X + 1), Line(X, X, "_")))]
    for ending in ("png", "pdf", "svg"):
        plot_lines("not drawn", panels, tmp_path / f"figure.{ending}", columns)
    pdf, svg = (tmp_path / "figure.pdf").read_bytes(), (tmp_path / "figure.svg").read_text()
    assert b"/FontFile2" in pdf  # TrueType, embedded
    assert b"/Type3" not in pdf
    assert ">error [%]</text>" in svg
    assert ">not drawn</text>" not in svg
    with Image.open(tmp_path / "figure.png") as picture:
        assert picture.width == round(300 * plot.WIDTHS[columns])
        assert picture.info["Title"] == "not drawn"


def test_lines_differ_in_grey_print():
    styles = {(plot.MARKERS[i % len(plot.MARKERS)], plot.DASHES[i % len(plot.DASHES)]) for i in range(28)}
    assert len(styles) == 28


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


SHORT = scenarios.get("everything-1").replace(duration=0.4)


@pytest.fixture(scope="module")
def traces():
    return {policy: rollout(policy, SHORT, [6, 5]) for policy in ("zero", "pd-gravity", "cascade-flm")}


@pytest.mark.parametrize(("ending", "fps"), [("mp4", 50), ("gif", 25)])
def test_a_film_runs_in_real_time(tmp_path, traces, ending, fps):
    path = tmp_path / "new" / f"film.{ending}"
    write_video(traces, path, size=160)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 0.4 * fps + 1
    assert seconds == pytest.approx(0.4, abs=1.5 / fps)
    shape = next(imageio_ffmpeg.read_frames(str(path)))["source_size"]
    assert shape == (3 * 160, 160 + 12)


def test_a_film_is_as_long_as_the_episode_at_any_rate():
    for control_dt, steps in ((0.001, 300), (0.01, 30), (0.1, 3)):
        trace = rollout("zero", SHORT.replace(control_dt=control_dt, duration=steps * control_dt), [0])
        frames = list(film({"zero": trace}, 20, size=160))
        assert len(frames) == 7
        assert len({frame.tobytes() for frame in frames}) == (4 if control_dt == 0.1 else 7)


def test_a_film_shows_what_the_environment_draws():
    """Every number, in an episode with everything in it, around pick-up and drop too."""
    scenario = scenarios.get("everything-2")
    trace = rollout("cascade-flm", scenario, [8, 3])
    env = TwoLinkArmEnv(scenario)
    view, policy, state = View(scenario, 480), controllers.make("cascade-flm", env), None
    observation, _ = env.reset(seed=8)
    for k in range(scenario.steps):
        if k in (0, 1, 299, 300, 301, 500, 699, 700, 701, 702):
            one, two = map(dataclasses.asdict, (picture("cascade-flm", trace, k), view.picture(env.truth)))
            for name in ("lengths", "position", "reference", "torque", "disturbance", "time"):
                np.testing.assert_allclose(one[name], two[name], rtol=0, atol=1e-9, err_msg=f"{name} at {k}")
            assert one["payload"] == two["payload"], k
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]


def test_the_running_error_ends_as_the_metric(traces):
    for policy, trace in traces.items():
        last = picture(policy, trace, len(trace.time) - 1)
        assert last.subtitle == f"RMS error {measure(trace)[0]['rms_mrad']:,.1f} mrad"
        assert last.title == policy


def test_an_arm_that_diverged_stays_where_it_was():
    trace = rollout("zero", SHORT.replace(limits={"velocity": 3.0}, duration=2.0), [0])
    end = int(trace.alive[:, 0].sum())
    assert 10 < end < len(trace.time)
    assert "diverged" not in picture("zero", trace, end - 1).subtitle
    last = picture("zero", trace, len(trace.time) - 1)
    assert last.subtitle == f"diverged at {end * 0.01:.2f} s"
    assert last.position == picture("zero", trace, end - 1).position
    assert len(list(film({"zero": trace}, 2, size=160))) == 5


def test_frames_stand_side_by_side(traces):
    apart = [film({policy: trace}, 50, size=160) for policy, trace in traces.items()]
    for together, *alone in itertools.islice(zip(film(traces, 50, size=160), *apart, strict=True), 5):
        for i, frame in enumerate(alone):
            np.testing.assert_array_equal(together[12:, 160 * i : 160 * (i + 1)], frame[12:])
