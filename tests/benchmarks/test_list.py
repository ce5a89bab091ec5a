"""`fbl-gym list`: options and gains are described from their declarations."""

import runpy
from pathlib import Path

from benchmarks import cli
from benchmarks.cli import names

DOCS = Path(__file__).parents[2] / "docs"


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
    sine = texts["disturbance[sine].phase"]
    assert sine.startswith(
        "one or two numbers not below -1e+06 and not above 1e+06, or None [rad]; default None; phase"
    )
    assert texts["reward.tracking"].startswith('"log" or "l1"; default log;')


def test_every_option_has_a_meaning():
    assert [option.path for option in names.options() if not option.meaning] == []


def test_the_page_of_options_is_current():
    page = DOCS / "reference" / "options.md"
    before = page.read_text(encoding="utf-8")
    assert before == runpy.run_path(str(DOCS / "conf.py"))["options_page"](), (
        "options.md was old: `make docs` writes it"
    )
