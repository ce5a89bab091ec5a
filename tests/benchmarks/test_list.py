"""`fbl-gym list`: options and gains are described from their declarations."""

from pathlib import Path

import pytest

from benchmarks import cli
from benchmarks.cli import names

PAGE = Path(__file__).parents[2] / "docs" / "options.md"


def listed(what, capsys):
    """Return the printed text of each name."""
    assert cli.main(["list", what]) == 0
    lines = capsys.readouterr().out.splitlines()
    return {name: text.strip() for name, _, text in (line.partition("  ") for line in lines)}


def test_an_option_is_listed_with_valid_values_unit_default_and_meaning(capsys):
    texts = listed("options", capsys)
    form = "one or two numbers or distributions not below 0 [N m]"
    assert texts["friction.coulomb"] == form + "; default 0; Coulomb friction, f_i2."
    assert (
        texts["parameter_error.payload.mass"]
        == "a number or distribution not below 0 [kg]; required; mass of the payload."
    )
    assert texts["disturbance[sine].phase"].startswith("one or two numbers, or None [rad]; default None; phase")
    assert texts["reward.tracking"].startswith('"log" or "l1"; default log;')


def test_every_option_has_a_meaning():
    assert [option.path for option in names.options() if not option.meaning] == []


def test_the_page_of_options_is_current(capsys):
    assert cli.main(["list", "options", "--markdown"]) == 0
    assert PAGE.read_text(encoding="utf-8") == capsys.readouterr().out, (
        "docs/options.md is old: run `fbl-gym list options --markdown > docs/options.md`"
    )


@pytest.mark.parametrize("what", [[], ["policies"]])
def test_only_options_have_a_page(what, capsys):
    assert cli.main(["list", *what, "--markdown"]) == 2
    assert "--markdown needs the list 'options'" in capsys.readouterr().err
