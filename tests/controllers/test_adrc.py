"""The extended state observer against its poles; what active disturbance rejection knows of the arm."""

import dataclasses

import numpy as np
import pytest

import controllers
from controllers.parts import Eso
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import loop


def error_dynamics(observer):
    """The matrix [3 x 3] by which the prediction of the first joint nears the truth, found by asking the observer."""
    columns = []
    for e in np.eye(3, 4):
        # The truth is 0 and the prediction e: the plant stays at 0, and the next prediction is the error.
        prediction = np.stack([e, e])[None]
        columns.append(observer.predict(observer.correct(prediction, np.zeros((1, 2))), np.zeros((1, 2)))[0, 0, :3])
    return np.array(columns).T


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("w", [5.0, 80.0, 300.0])
def test_the_observer_has_its_three_poles(dt, w):
    """det(z - F + F L H) = (z - exp(-w dt))^3: three equal poles, inside the circle at every rate."""
    polynomial = np.poly(error_dynamics(Eso(dt, w)))
    np.testing.assert_allclose(polynomial, np.poly([np.exp(-w * dt)] * 3), rtol=1e-7, atol=1e-7)


def test_the_estimate_of_a_constant_disturbance_follows_its_step_response():
    """From rest, f' = f (1 - (1 + w t + (w t)^2 / 2) exp(-w t)): the step response of three poles at -w."""
    dt, w, f = 1e-3, 20.0, 3.0
    observer = Eso(dt, w)
    prediction, log = observer.initial(np.zeros((1, 2)), np.zeros((1, 2))), []
    t = dt * np.arange(600)
    for q in 0.5 * f * t**2:
        estimate = observer.correct(prediction, np.full((1, 2), q))
        prediction = observer.predict(estimate, np.zeros((1, 2)))
        log.append(estimate[0, 0, 3])
    wt = w * t
    np.testing.assert_allclose(log, f * (1.0 - (1.0 + wt + wt**2 / 2) * np.exp(-wt)), atol=0.02 * f)
    assert log[-1] == pytest.approx(f, rel=1e-3)


def test_ladrc_knows_one_number_of_each_joint():
    """With another gravity in the nominal model, the torque is the same."""
    env = TwoLinkArmEnv()
    light = dataclasses.replace(env.interface, nominal=dataclasses.replace(env.interface.nominal, gravity=0.0))
    law, other = (controllers.make("ladrc", interface) for interface in (env.interface, light))
    for observation, state, action, _ in loop(law, env, 20):
        np.testing.assert_array_equal(other.predict(observation, state)[0], action)
