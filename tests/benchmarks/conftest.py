"""A folder and a command line for tests that run commands."""

import shlex

import pytest

from benchmarks import cli


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def fbl_gym(capsys):
    """Run a command that ends with a status; returns what it printed."""

    def run(line, status=0):
        try:
            found = cli.main(shlex.split(line) if isinstance(line, str) else line)
        except SystemExit as left:
            found = left.code
        assert found == status
        return capsys.readouterr()

    return run
