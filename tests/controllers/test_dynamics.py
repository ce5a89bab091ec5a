"""The compiled dynamics of the laws."""

import numpy as np
import pytest

from controllers import dynamics
from fbl_gym.model import arm


@pytest.mark.parametrize("name", ["inverse_dynamics", "forward_dynamics"])
@pytest.mark.parametrize("shape", [(1, 2), (7, 2), (4, 3, 2)])
def test_compiled_dynamics_has_the_bits_of_the_arms(name, shape):
    q, v, x = np.random.default_rng(1).normal(scale=3.0, size=(3, *shape))
    geared = arm.ArmParameters(rotor=(2.0, 1.0))
    models = [geared, geared.lumped, np.tile(geared.lumped, (*shape[:-1], 1)), np.tile(geared.base, (*shape[:-1], 1))]
    for model in models:
        compiled = getattr(dynamics, name)(model, q, v, x)
        np.testing.assert_array_equal(compiled, getattr(arm, name)(model, q, v, x))


def test_an_acceleration_for_all_rows_is_broadcast():
    q, v = np.random.default_rng(1).normal(size=(2, 5, 2))
    model = arm.ArmParameters()
    torque = dynamics.inverse_dynamics(model, q, v, np.array([1.0, -2.0]))
    np.testing.assert_array_equal(torque, dynamics.inverse_dynamics(model, q, v, np.tile([1.0, -2.0], (5, 1))))
