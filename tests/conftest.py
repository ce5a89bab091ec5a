"""The environment of all tests."""

import os

import pytest

os.environ["OMP_NUM_THREADS"] = "1"  # several workers with several threads each wait for each other
os.environ["SDL_VIDEODRIVER"] = "dummy"  # windows go nowhere


@pytest.fixture(scope="session", autouse=True)
def _logs_of_stable_baselines3(tmp_path_factory):
    """Its default logger makes a folder, /tmp/SB3-TIME without this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.getbasetemp() / "sb3"))
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests that look at a page in a browser are slow."""
    for item in items:
        if "browser" in item.fixturenames and item.path.name == "test_page.py":
            item.add_marker(pytest.mark.slow)
