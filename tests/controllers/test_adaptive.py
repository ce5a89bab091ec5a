"""The paper's cascade, its adaptive controller on its figures 6a and 6b, and gain scheduling by equation (46)."""

import numpy as np
import pytest

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from controllers.paper.adaptive import FORMS, schedule
from fbl_gym import TwoLinkArmEnv, scenarios
from tests.controllers.closed_loop import nominal, tracking


def learn(scenario, steps, **gains):
    """Relative errors [steps x 4] of the estimates of m1, m2, L1, L2 over a run."""
    env = TwoLinkArmEnv(scenario, action="torque" if scenario.actuator.torque_limit is None else "normalized")
    policy = controllers.make("adaptive-flm", env, **gains)
    _, states = tracking(policy, env, steps)
    estimates = np.array([policy.parameters(state)[0] for state in states])
    return np.abs(estimates / [*env.truth.masses, *env.truth.lengths] - 1)


def test_small_parameters_need_a_fast_loop():
    """The nominal inertia is a thousand times the real one's: at 1 kHz the arm diverges before the first estimate."""
    small = scenarios.get("paper-6b").replace(duration=0.3)
    fast = measure(rollout("adaptive-flm", small, [0]))[0]
    slow = measure(rollout("adaptive-flm", small.replace(control_dt=1e-3), [0]))[0]
    assert fast["diverged"] == 0.0
    assert slow["diverged"] == 1.0


def test_samples_that_lie_apart_bear_noise():
    """The same noise: half a second apart, the estimates are within some per cent."""
    exciting = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}
    noisy = nominal(
        control_dt=1e-3, parameter_error=2.0, reference=exciting, noise={"acceleration": 0.01}, duration=5.0
    )
    close, apart = (np.median(learn(noisy, 4000, spacing=spacing)[3000:]) for spacing in (0.0, 0.5))
    assert apart < 0.05 < 0.2 < close


def test_the_paper_s_tools_together_work_with_noise():
    scenario = scenarios.get("paper-10").replace(
        noise={"position": 1e-2, "velocity": 1e-2, "acceleration": 1e-2}, duration=2.0
    )
    laws = (("adaptive-flm-scheduled", {}), ("adaptive-robust-flm", {}), ("adaptive-robust-flm", {"spacing": 0.0}))
    plain, together, quick = (measure(rollout(policy, scenario, [0], gains))[0] for policy, gains in laws)
    assert together["diverged"] == plain["diverged"] == 0.0
    assert quick["steady_1_pct"] < plain["steady_1_pct"]


@pytest.mark.parametrize("alpha", [((1.0, 2.0),), ((1.0, -1.0), (0.0, 1.0)), ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))])
def test_an_alpha_that_is_not_four_numbers_is_refused(alpha):
    with pytest.raises(ValueError, match="alpha must be"):
        controllers.make("adaptive-flm", TwoLinkArmEnv(), alpha=alpha)


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


def test_feed_forward_tracks_a_moving_reference():
    scenario = scenarios.get("paper-8").replace(friction=None, duration=4.0)
    traces = (rollout("cascade-flm", scenario, [0], {"feedforward": share}) for share in (0.0, 1.0))
    without, with_it = (measure(trace)[0]["error_pct"] for trace in traces)
    assert with_it < 0.2 * without


def test_a_known_friction_that_varies_is_refused():
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match=r"friction must have fixed numbers and no load, .* got Friction"):
        controllers.make("cascade-flm", env, friction={"coulomb": {"uniform": [1.0, 2.0]}})
    with pytest.raises(ValueError, match=r"no load, as in equation \(22\), got .*load=\(0.2"):
        controllers.make("cascade-flm", env, friction={"load": 0.2})
