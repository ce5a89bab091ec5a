"""Gain scheduling against equation (46), and against stiction."""

import numpy as np

from controllers.gain_scheduling import FORMS, schedule


def test_the_schedule_is_equation_46():
    v = np.array([[0.0, 0.0], [0.1, -0.02], [5.0, 5.0]])
    alpha = np.array([[3.0, 0.5], [0.25, 4.0]])
    factors = schedule(v, alpha, 1e-3)
    for row, (v1, v2) in zip(factors, v, strict=True):
        near = np.exp(-(v1**2) / 1e-3), np.exp(-(v2**2) / 1e-3)
        np.testing.assert_allclose(row, 1 + alpha @ near, rtol=1e-12)
    np.testing.assert_allclose(factors[0], [4.5, 5.25])
    np.testing.assert_allclose(factors[2], 1.0)


def test_every_form_is_full_at_rest_and_none_at_speed():
    """Between them the switch is hard, and the rules meet (46) at rest, at sqrt(v_s) and far away."""
    scale = np.sqrt(1e-3)
    v = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]]) * scale
    alpha = ((20.0, 0.0), (0.0, 20.0))
    factors = {form: schedule(v, alpha, 1e-3, form)[:, 0] for form in FORMS}
    for form in FORMS:
        assert factors[form][0] == 21.0
        assert factors[form][2] < 1.01
    np.testing.assert_allclose(factors["fuzzy"][1], factors["soft"][1], rtol=1e-9)
    assert list(schedule(0.999 * v[1:2], alpha, 1e-3, "hard")[0]) == [21.0, 21.0]
    assert list(schedule(1.001 * v[1:2], alpha, 1e-3, "hard")[0]) == [1.0, 1.0]
