"""The payload acts on the plant from its pick-up to its drop."""

import numpy as np
import pytest

from fbl_gym import TABLE_1
from fbl_gym.model.chain import HINGE
from tests.fbl_gym.episodes import watch


def test_a_payload_acts_from_its_physics_step_on():
    """Picked up at 23 ms and dropped at 71 ms, it acts in the physics steps from 23 up to 71 ms."""
    option = {"mass": 6.0, "pick_up": 0.0231, "drop": 0.0709}
    payload, lumped, velocity = watch("payload", "lumped", "velocity", parameter_error={"payload": option})
    plain_lumped, plain_velocity = watch("lumped", "velocity")
    carried = np.zeros(151, dtype=bool)
    carried[24:72] = True
    np.testing.assert_array_equal(payload, np.where(carried, 6.0, 0.0))
    np.testing.assert_array_equal(lumped[~carried], plain_lumped[~carried])
    L1, L2, g = TABLE_1.L1, TABLE_1.L2, TABLE_1.gravity
    extra = 6.0 * np.array([L1**2, L2**2, L1 * L2, L1 * g, L2 * g])
    np.testing.assert_allclose(lumped[carried] - plain_lumped[carried], np.tile(extra, (48, 1)), rtol=1e-12)
    np.testing.assert_array_equal(velocity[:24], plain_velocity[:24])
    assert np.any(velocity[24] != plain_velocity[24])
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.1  # it does not jump


@pytest.mark.parametrize(("option", "carried"), [(2.0, 2.0), ({"mass": 5.0, "drop": 4e-4}, 0.0)], ids=str)
def test_a_payload_without_a_pick_up_is_carried_at_the_start_unless_dropped_at_once(option, carried):
    payload, lumped = watch("payload", "lumped", steps=2, parameter_error={"payload": option})
    np.testing.assert_array_equal(payload, [carried] * 3)
    assert np.all((lumped > TABLE_1.lumped) == (carried > 0.0))


def test_the_drop_of_a_payload_that_an_event_released_leaves_another_one():
    """3 kg are dropped by the event, then 5 kg are picked up; the option's own drop has nothing left to release."""
    events = [{"kind": "drop", "time": 0.03}, {"kind": "pick-up", "time": 0.06, "mass": 5.0}]
    (payload,) = watch("payload", parameter_error={"payload": {"mass": 3.0, "drop": 0.09}}, events=events)
    assert [payload[k] for k in (10, 50, 80, 120)] == [3.0, 0.0, 5.0, 5.0]


PICK_UP = [{"kind": "pick-up", "time": 0.05, "mass": 6.0}]


@pytest.mark.parametrize(("payload", "events", "own", "other"), [
    ({}, [], 3.0, 0.0), ({}, PICK_UP, 3.0, 6.0), ({"mass": 0.0}, PICK_UP, 0.0, 6.0), ({"drop": 0.03}, PICK_UP, 0.0, 6.0),
    ({"drop": 0.07}, PICK_UP, 0.0, 6.0), ({"pick_up": 0.07}, PICK_UP, 3.0, 6.0),
    ({"pick_up": 0.09}, [*PICK_UP, {"kind": "drop", "time": 0.07}], 3.0, 0.0),
    ({"drop": 0.09}, [*PICK_UP, {"kind": "drop", "time": 0.03}], 0.0, 6.0),
], ids=str)  # fmt: skip
def test_what_an_event_picks_up_hangs_at_the_tip_whatever_the_other_payloads_size(payload, events, own, other):
    """Lumped parameters, and the moments of the last segment of links that bend, are sums over the bodies."""
    error = {"payload": {"mass": 3.0, "offset": 0.2, "radius": 0.1, **payload}}
    names = ("lumped", "payload", "segment_inertia", "segment_moment")
    lumped, mass, inertia, moment = watch(*names, parameter_error=error, events=events, link=20.0, physics_dt=5e-4)
    *_, plain_inertia, plain_moment = watch(*names, steps=0, link=20.0, physics_dt=5e-4)
    bodies, (L1, L2, g) = ((own, 0.2, 0.1), (other, 0.0, 0.0)), (TABLE_1.L1, TABLE_1.L2, TABLE_1.gravity)
    extra = [m * np.array([L1**2, (L2 + x) ** 2 + r**2, L1 * (L2 + x), L1 * g, (L2 + x) * g]) for m, x, r in bodies]
    np.testing.assert_allclose(lumped[-1] - TABLE_1.lumped, np.sum(extra, axis=0), rtol=1e-12)
    assert mass[-1] == pytest.approx(own + other)
    tip = (1 - HINGE) * L2
    seconds, firsts = zip(*((m * ((tip + x) ** 2 + r**2), m * (tip + x)) for m, x, r in bodies), strict=True)
    np.testing.assert_allclose(inertia[-1, 3] - plain_inertia[0, 3], sum(seconds), rtol=1e-12)
    np.testing.assert_allclose(moment[-1, 3] - plain_moment[0, 3], sum(firsts), rtol=1e-12)
