"""Rendering: frames show the real arm and change no episode; films and windows work as in Gymnasium."""

import sys
import time
from functools import partial
from types import SimpleNamespace

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.wrappers import RecordVideo
from scipy import ndimage

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import ArmParameters, joint_positions
from fbl_gym.view import picture, render
from fbl_gym.view.picture import INK, ORANGE, RULE, draw
from fbl_gym.view.render import View
from tests.fbl_gym.episodes import ID, started, started_batch

ACTION = np.array([0.1, -0.05])


@pytest.fixture(autouse=True)
def _without_windows():
    """Closes the windows of the test."""
    yield
    render.pygame.display.quit()


def drawn(size=480, title="", disturbed=False, **changes):
    """Return the frame of an instant of an arm at rest, with some changes."""
    truth = {"time": 0.0, "payload": 0.0, "lengths": (0.7, 0.5), "position": (0.6, 1.1), "reference": (0.6, 1.1)}
    truth |= dict.fromkeys(("bend", "applied_torque", "disturbance"), (0.0, 0.0)) | changes
    return draw(SimpleNamespace(**{name: np.array(x) for name, x in truth.items()}), title, size, disturbed)


def mask(frame, colour):
    """Return the pixels of a colour; averaging may change a channel by two."""
    return (abs(frame.astype(int) - colour) <= 2).all(axis=-1)


def count(frame, colour):
    return int(mask(frame, colour).sum())


def discs(frame, points):
    """Return the centre of the joint's disc that is nearest to each point."""
    labels, _ = ndimage.label(mask(frame, INK))
    large = np.flatnonzero(np.bincount(labels.ravel()) > 30)[1:]  # without the background
    # A pixel's middle lies half a pixel from its corner.
    centres = np.array(ndimage.center_of_mass(labels, labels, large))[:, ::-1] + 0.5
    return np.array([centres[np.hypot(*(centres - point).T).argmin()] for point in points])


@pytest.mark.parametrize("size", [480, 800])
@pytest.mark.parametrize("lengths", [(0.7, 0.5), (20.0, 15.0), (0.3, 0.9)])
def test_joints_are_drawn_at_the_positions_of_the_kinematics(size, lengths):
    """The base is in the ring's centre, y points upwards, both links have one scale; within half a pixel."""
    arm = ArmParameters(L1=lengths[0], L2=lengths[1])
    for q in ((0.6, 1.1), (-1.4, 0.3), (2.9, -1.9), (4.0, 0.9)):
        expected = joint_positions(arm, q) / sum(lengths) * (1, -1) * 0.35 * size + (0.5 * size, 0.458 * size)
        seen = discs(drawn(size, lengths=lengths, position=q, reference=q), expected)
        np.testing.assert_allclose(seen, expected, atol=0.5)


@pytest.mark.parametrize("options", [
    {"parameter_error": {"ratio": {"L1": 1.3}, "payload": 3.0}, "initial_error": 0.3},
    {"link": 1.5, "reference": {"kind": "sine", "amplitude": 0.0, "centre": (0.0, 0.5)}},
], ids=["longer", "bent"])  # fmt: skip
def test_an_environment_draws_the_real_arm(options):
    """Elbow and tip by complex numbers: a link turns by its bend at 0.15 of its length."""
    env = started(**options, render_mode="rgb_array")
    (b1, b2), (q1, q2), (l1, l2) = env.truth.bend, env.truth.position, env.truth.lengths
    assert (min(abs(b1), abs(b2)) > 0.1) == ("link" in options)
    elbow = l1 * np.exp(1j * q1) * (0.15 + 0.85 * np.exp(1j * b1))
    tip = elbow + l2 * np.exp(1j * (q1 + b1 + q2)) * (0.15 + 0.85 * np.exp(1j * b2))
    expected = picture.project([(p.real, p.imag) for p in (0j, elbow, tip)], (l1, l2), 480)
    frame = env.render()
    assert (frame.shape, frame.dtype) == ((480, 480, 3), np.uint8)
    np.testing.assert_allclose(discs(frame, expected), expected, atol=0.5)
    assert (count(frame, ORANGE) > 100) == ("link" not in options)


def test_a_change_of_the_picture_changes_the_frame():
    bare = drawn()
    assert count(bare, ORANGE) == 0
    assert count(drawn(payload=2.0), ORANGE) > 100
    pairs = {"bend": (0.1, 0.0), "reference": (0.9, 1.1), "applied_torque": (0.1, 0.0)}
    for name, value in {"title": "x", "time": 1.0, "disturbed": True, **pairs}.items():
        assert not np.array_equal(drawn(**{name: value}), bare), name
    np.testing.assert_array_equal(drawn(), bare)


def test_the_payloads_disc_has_an_area_by_its_mass():
    """At the scale of the arm, up to the part that the link covers."""
    area = {mass: count(drawn(800, payload=mass, position=(2.0, 1.1)), ORANGE) for mass in (0.5, 5.0, 20.0)}
    assert area[20.0] / area[5.0] == pytest.approx(4.0, rel=0.15)
    assert 0 < area[0.5] < area[5.0] / 5
    small = drawn(800, payload=5.0 / 9, position=(2.0, 1.1), lengths=(0.7 / 3, 0.5 / 3))
    assert count(small, ORANGE) == pytest.approx(area[5.0], rel=0.01)


def test_the_numbers_are_those_of_the_picture(monkeypatch):
    written = []
    monkeypatch.setattr(picture, "write", lambda canvas, text, *_: written.append(text))
    values = {"title": "here", "time": 1.234, "position": (0.5, 1.2), "payload": 2.5}
    drawn(**values, applied_torque=(-1234.56, 2.0), disturbance=(3.0, -1e300), disturbed=True)
    assert {"here", "1.23 s", "payload 2.5 kg"} < set(written)
    rows = ["error [mrad]", "+100.0", "−100.0", "torque [N m]", "−1,234.6", "+2.0"]
    assert written[-9:] == [*rows, "disturbance [N m]", "−3.0", "+1.0e+300"]


def test_drawing_changes_no_episode():
    modes = (None, "rgb_array", "human")
    plain, *others = (started("everything-2", render_mode=mode, render_size=160, seed=1) for mode in modes)
    for action in np.random.default_rng(0).uniform(-0.2, 0.2, (20, 2)):
        expected = plain.step(action)
        for env in others:
            env.render()
            np.testing.assert_equal(env.step(action), expected)


def test_without_pygame_the_error_names_the_extra_to_install(monkeypatch):
    env = started(render_mode="rgb_array")
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "fbl_gym.view.render")
    monkeypatch.delitem(sys.modules, "fbl_gym.view.picture")
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'fbl-gym\[render\]'"):
        env.render()


def test_a_window_shows_the_episode_in_real_time_until_close():
    env = gym.make(ID, render_mode="human", render_size=200)
    env.reset(seed=0)
    window = render.pygame.display.get_surface()
    assert window.get_size() == (200, 200)
    before = render.pygame.surfarray.array3d(window)
    begin = time.perf_counter()
    for _ in range(30):
        env.step(ACTION)
    assert time.perf_counter() - begin > 0.25
    assert env.render() is None
    assert not np.array_equal(render.pygame.surfarray.array3d(window), before)
    env.close()
    assert render.pygame.display.get_surface() is None
    env.close()


def test_the_window_shows_the_arm_that_moved_last():
    """It takes that arm's size; `pygame.quit` of another program does no harm."""
    first, second = (TwoLinkArmEnv(render_mode="human", render_size=size) for size in (200, 300))
    for env in (first, second):
        env.reset(seed=0)
    window = render.pygame.display.get_surface()
    pixels = render.pygame.surfarray.array3d(window).swapaxes(0, 1)
    np.testing.assert_array_equal(pixels, View(second.scenario, 300).frame(second.truth))
    for _ in range(2):
        first.step(ACTION)
    assert render.pygame.display.get_surface().get_size() == (200, 200)
    render.pygame.quit()
    for _ in range(2):
        second.step(ACTION)
    assert render.pygame.display.get_surface().get_size() == (300, 300)
    second.close()
    assert render.pygame.display.get_surface() is None


@pytest.mark.parametrize(("control_dt", "pictures"), [(0.1, 5), (0.01, 25), (0.001, 25)])
def test_a_window_draws_at_most_fifty_pictures_a_second(monkeypatch, control_dt, pictures):
    frames = []
    monkeypatch.setattr(render, "draw", lambda *_: frames.append(1) or np.zeros((480, 480, 3), np.uint8))
    monkeypatch.setattr(render, "_CLOCK", SimpleNamespace(tick=lambda _: None))
    env = started(render_mode="human", control_dt=control_dt, physics_dt=0.001)
    for _ in range(round(0.5 / control_dt)):
        env.step(ACTION)
    assert len(frames) == 1 + pictures
    env.reset()
    assert len(frames) == 2 + pictures


@pytest.mark.parametrize(("control_dt", "fps"), [(0.01, 100), (0.001, 1000), (0.003, 333), (2.0, 1)])
def test_the_frame_rate_is_real_time(control_dt, fps):
    options = {"control_dt": control_dt, "physics_dt": 0.001, "duration": 30 * control_dt}
    assert TwoLinkArmEnv(**options).metadata["render_fps"] == fps
    assert TwoLinkArmVectorEnv(2, **options).metadata["render_fps"] == fps


def test_record_video_writes_a_frame_for_every_step(tmp_path):
    options = {"duration": 0.3, "render_mode": "rgb_array", "render_size": 160}
    env = RecordVideo(gym.make(ID, **options), str(tmp_path / "films"))
    env.reset(seed=0)
    for _ in range(30):
        env.step(ACTION)
    assert len(env.recorded_frames) == 31
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    assert imageio_ffmpeg.count_frames_and_secs(str(film))[1] == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("make", [TwoLinkArmEnv, partial(TwoLinkArmVectorEnv, 2)], ids=["single", "batch"])
def test_rendering_without_a_mode_warns_and_before_reset_is_an_error(make):
    with pytest.warns(UserWarning, match="render_mode"):
        assert make().render() is None
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        make(render_mode="rgb_array").render()
    with pytest.raises(ValueError, match="render_size must be a whole number not below 160, got 10"):
        make(render_size=10)
    with pytest.raises(ValueError, match=r"unknown render_mode 'humann?'.* Known: .*rgb_array"):
        make(render_mode="humann" if make is TwoLinkArmEnv else "human")


def test_a_vector_environment_draws_every_lane_as_a_single_one():
    options = {"scenario": "everything-2", "render_mode": "rgb_array", "render_size": 160}
    envs, singles = started_batch(3, **options, seed=4), [started(**options, seed=4 + lane) for lane in range(3)]
    for _ in range(5):
        frames = envs.render()
        assert type(frames) is tuple
        np.testing.assert_array_equal(frames, [env.render() for env in singles])
        envs.step(np.tile(ACTION, (3, 1)))
        for env in singles:
            env.step(ACTION)


def test_letters_survive_pygame_quit():
    """Gymnasium's own environments shut all of pygame down when they close."""
    env = started(render_mode="rgb_array")
    before = env.render()
    render.pygame.quit()
    np.testing.assert_array_equal(env.render(), before)
    picture._letters.cache_clear()
    np.testing.assert_array_equal(env.render(), before)


def test_an_arm_that_diverged_can_be_drawn():
    env = started(arm={"m1": 0.01, "m2": 0.01}, actuator={"torque_limit": 1e5}, control_dt=0.1, render_mode="rgb_array")
    assert env.step((1.0, -1.0))[2]
    assert count(env.render(), RULE) > 100
