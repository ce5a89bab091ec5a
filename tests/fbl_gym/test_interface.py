"""`Interface`: a policy knows what a datasheet states of drive and sensors, and no draw or error."""

import dataclasses

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv

IDEAL = TwoLinkArmEnv().interface
FIELDS = ("delay", "lag", "rate_limit", "latency", "resolution", "noise_std")
SPRINGS = ("stiffness", "damping", "rotor_inertia", "backlash", "encoder")


@pytest.mark.parametrize(
    ("options", "stated"),
    [
        ({}, {}), ({"actuator": {"delay": 0.004, "delay_samples": 1}}, {"delay": (0.014, 0.014)}),
        ({"actuator": {"delay": {"uniform": [0.001, 0.005]}}}, {"delay": (0.001, 0.005)}),
        ({"actuator": {"delay_samples": {"choice": [2, 1]}, "delay": 0.001}}, {"delay": (0.011, 0.021)}),
        ({"actuator": {"lag": {"log_uniform": [0.001, 0.005]}}}, {"lag": (0.001, 0.005)}),
        ({"actuator": {"rate_limit": [{"choice": [9.0, 5.0]}, 7.0]}}, {"rate_limit": (5.0, 7.0)}),
        ({"encoder": {"latency": 2}}, {"latency": 0.02}),
        ({"encoder": {"counts": (1000, 2000)}}, {"resolution": (2e-3 * np.pi, 1e-3 * np.pi)}),
        ({"noise": {"position": {"quantization": 0.01}}}, {"resolution": (0.01, 0.01)}),
        ({"noise": {"velocity": {"uniform": [0.1, 0.2]}}}, {"noise_std": ((0.0, 0.0), (0.2, 0.2), (0.0, 0.0))}),
        ({"noise": {"position": {"density": (1.0, 2.0)}}}, {"noise_std": ((50**0.5, 200**0.5), (0.0, 0.0), (0.0, 0.0))}),
    ],
    ids=str,
)  # fmt: skip
def test_the_interface_states_drive_and_sensors(options, stated):
    interface = TwoLinkArmEnv(**options).interface
    for name in FIELDS:
        expected = np.array(stated.get(name, getattr(IDEAL, name)), dtype=float)
        np.testing.assert_allclose(np.array(getattr(interface, name), dtype=float), expected, err_msg=name)
    assert hash(interface) == hash(dataclasses.replace(interface))


@pytest.mark.parametrize(
    "options",
    [
        {"friction": {"coulomb": {"uniform": [0, 20]}, "viscous": 3.0}},
        {"parameter_error": {"radius": 1.0, "payload": {"uniform": [0, 5]}}}, {"actuator": {"gain": 1.3}},
        {"actuator": {"gain": {"uniform": [0.9, 1.1]}}}, {"noise": {"position": {"bias": {"uniform": [-0.1, 0.1]}}}},
        {"initial_error": {"uniform": [-0.1, 0.1]}, "initial_velocity": 0.5},
        {"disturbance": {"kind": "sine", "amplitude": {"uniform": [0, 5]}}},
    ],
    ids=str,
)  # fmt: skip
def test_the_interface_hides_the_errors_of_the_real_arm(options):
    assert TwoLinkArmEnv(**options).interface == IDEAL


def test_the_interface_states_the_springs():
    joint = {"stiffness": [{"uniform": [3e3, 5e3]}, 2e3], "damping": 5.0, "backlash": {"uniform": [0, 1e-3]}}
    interface = TwoLinkArmEnv(joint={**joint, "rotor_inertia": (0.5, 0.2), "encoder": "link"}).interface
    stated = (((3e3, 2e3), (5e3, 2e3)), ((5.0, 5.0), (5.0, 5.0)), (0.5, 0.2), (1e-3, 1e-3), "link")
    assert tuple(getattr(interface, name) for name in SPRINGS) == stated
    assert IDEAL.stiffness is None
