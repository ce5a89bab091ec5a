"""Films of traces: in real time, side by side, and of the same arm that the environment draws."""

import dataclasses
import itertools

import imageio_ffmpeg
import numpy as np
import pytest

import controllers
from benchmarks.report.video import film, picture, write_video
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.view.render import View

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
