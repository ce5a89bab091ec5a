"""The window of running arms, by scripted mouse and keys without a display; and the film of a notebook."""

import numpy as np
import pytest
from PIL import Image

import benchmarks
from benchmarks.cli import play
from benchmarks.cli.play import SIZE, Game, picture, pygame
from benchmarks.policies.spec import resolve
from fbl_gym import scenarios


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
