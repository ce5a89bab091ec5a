"""`fbl-gym doctor`: where the packages of fbl-gym come from."""

import sys
from pathlib import Path

import fbl_gym
from benchmarks.cli.doctor import origins


def test_each_package_is_named_with_its_place():
    folder = Path(fbl_gym.__file__).parent
    assert f"fbl_gym is imported from {folder}" in origins()
    assert [line.split()[0] for line in origins() if not line.startswith("warning")] == [
        "fbl_gym", "controllers", "benchmarks",
    ]  # fmt: skip


def test_another_package_of_the_same_name_is_named(tmp_path, monkeypatch):
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "__init__.py").touch()
    (tmp_path / "benchmarks.py").touch()
    before = len(origins())
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    warnings = [line for line in origins() if str(tmp_path) in line]
    assert len(warnings) == 2 == len(origins()) - before
    assert all(line.startswith("warning: ") for line in warnings)
