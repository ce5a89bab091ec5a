"""The environment of all tests."""

import os

import pytest

SLOW = (
    "benchmarks/rl/test_train.py::test_every_algorithm",
    "benchmarks/rl/test_train.py::test_a_killed_run_resumes",
    "benchmarks/rl/test_train.py::test_a_finished_run_is_extended",
    "benchmarks/rl/test_train_command.py::test_the_page_on_learning_runs",
    "benchmarks/rl/test_external_tools.py",
)
"""Beginnings of the names of tests that are slow by nature. Those with a browser are slow too."""

os.environ["OMP_NUM_THREADS"] = "1"  # several workers with several threads each wait for each other


@pytest.fixture(scope="session", autouse=True)
def _logs_of_stable_baselines3(tmp_path_factory):
    """Its default logger makes a folder, /tmp/SB3-TIME without this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.getbasetemp() / "sb3"))
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        browser = item.path.name == "test_page.py" and "page" in item.fixturenames
        if browser or item.nodeid.removeprefix("tests/").startswith(SLOW):
            item.add_marker(pytest.mark.slow)
