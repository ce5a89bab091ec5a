"""The law `swing-up` on arms that lack a drive, scored by the rules of DFKI's leaderboards."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import rollout
from fbl_gym import ArmParameters, TwoLinkArmEnv

EXAMPLE = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "swing_up.py"))
CRITERIA = ("time", "energy", "torque_cost", "smoothness", "velocity_cost")

# DFKI's controller "Energy PFL" (leaderboard/*/simulation_v1/con_pflcol_lqr.py) on designs C.0 and A.0: lumped
# parameters of model_parameters.yml, lengths, torque limit, gains, and the published criteria of version 1.
C0 = (0.02671076499939512, 0.053878129629650884), (0.6416937799349799, 0.563935954099688), (0.2, 0.3212669909674605)
A0 = (0.053470810264216295, 0.02392374528789766), (0.5593806151425046, 0.6043459469186889), (0.3, 0.18377686083653508)
PUBLISHED = {
    "acrobot": (C0, (0.2, 0.3), (0.0, 5.0), 1.0, (0.97, 0.93, 0.39, 0.26), 0.11, (4.12, 29.01, 18.79, 0.251, 280.81)),
    "pendubot": (A0, (0.3, 0.2), (3.0, 0.0), 0.5, (12.5e-4, 0.65, 6.88e-4, 9.36e-4), 25.0, (4.8, 53.75, 33.06, 0.136, 870.16)),
}  # fmt: skip


@pytest.mark.parametrize("robot", PUBLISHED)
def test_with_dfkis_gains_it_has_the_scores_that_dfki_published(robot):
    """In DFKI's table, the energy pairs each torque with the motion of the step before it."""
    (inertia, mass, centre), length, limit, pump, q, r, published = PUBLISHED[robot]
    p2, p3, p5 = inertia[1], mass[1] * length[0] * centre[1], 9.81 * mass[1] * centre[1]
    p1, p4 = inertia[0] + mass[1] * length[0] ** 2, 9.81 * (mass[0] * centre[0] + mass[1] * length[0])
    arm = ArmParameters.from_lumped((p1, p2, p3, p4, p5), length, gravity=9.81)
    env = TwoLinkArmEnv(f"dfki-c1-{robot}", arm=arm, actuator={"torque_limit": limit})
    angle, rate = np.sqrt(q[:2]), np.sqrt(q[2:])
    gains = {"stiffness": 1.0, "damping": 1.0, "pump": pump * (p4 + p5), "angle": angle, "rate": rate, "catch": 15.0}
    policy = controllers.make("swing-up", env, effort=r**-0.5 / (p4 + p5), **gains)
    found = EXAMPLE["criteria"](env, policy)
    assert found["success"]
    np.testing.assert_allclose([found[name] for name in CRITERIA], published, rtol=3e-3)


def test_the_score_is_dfkis():
    """The row "TVLQR" of the acrobot's leaderboard, version 2."""
    row = dict(zip(CRITERIA, (4.046, 10.433058, 1.868874, 0.0155377, 105.830286), strict=True))
    assert EXAMPLE["score"]({"success": True, **row}) == pytest.approx(0.504233, abs=1e-5)
    assert EXAMPLE["score"]({"success": False, **row}) == 0.0


@pytest.mark.parametrize(("robot", "seconds", "score"), [("acrobot", 1.376, 0.41), ("pendubot", 1.34, 0.24)])
def test_it_swings_up_and_balances(robot, seconds, score):
    env = TwoLinkArmEnv(f"dfki-c1-{robot}", action="torque")
    found = EXAMPLE["criteria"](env, controllers.make("swing-up", env))
    assert found["time"] == pytest.approx(seconds, abs=0.01)
    assert EXAMPLE["score"](found) > score
    trace = rollout("swing-up", env.scenario.replace(initial_error=({"uniform": [-3.19, -3.09]}, 0.02)), range(8))
    tops = np.sin(trace.position[-1, :, 0]), np.cos(trace.position[-1, :, 1])
    assert trace.alive.all()
    assert np.mean(np.minimum(*tops) > 0.99) >= 0.75


def test_it_needs_one_drive_and_a_hanging_arm():
    def make(**options):
        return controllers.make("swing-up", TwoLinkArmEnv("dfki-c1-acrobot", action="torque", **options))

    assert (make().driven, make(actuator=None).driven) == (1, 0)
    assert controllers.factory("swing-up+kalman").missing == 1
    with pytest.raises(ValueError, match="SwingUp needs a drive, got"):
        make(actuator=0.0)
    with pytest.raises(ValueError, match="needs an arm that hangs"):
        make(arm={"gravity": 0.0})
