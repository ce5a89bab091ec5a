"""The paper's claims: the rule of their verdicts, the committed numbers, the page that quotes them, and the files."""

import json
import re
import runpy
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cli import reproduce
from benchmarks.paper import claims, measuring
from benchmarks.paper.claims import CLAIMS, CONTROL, OPEN, SHORT, STATED, judge, measure_claim
from benchmarks.paper.outcome import Outcome
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmVectorEnv, scenarios

DOCS = Path(__file__).parents[2] / "docs" / "explanation"
PAGE, COMMITTED = (DOCS / "paper.md").read_text(encoding="utf-8"), claims.load(DOCS / "paper")
#: Cases that two seeds repeat in a few seconds; `make test-long` and `fbl-gym reproduce` measure
#: all seeds.
QUICK, SECONDS = tomllib.loads(Path(__file__).with_name("quick_claims.toml").read_text(encoding="utf-8")).values()


def test_one_rule_gives_both_verdicts():
    """A case holds if the 95 % interval of the share of seeds lies above 90 %; controls count for neither verdict."""
    assert Outcome(np.arange(40) < 40).texts == ("", "40 of 40", "yes")
    assert Outcome(np.arange(40) < 39).texts == ("", "39 of 40", "no")
    assert Outcome(np.True_, "5 %").texts == ("5 %", "", "yes")
    stated, not_stated, best, control = [STATED, "yes"], [STATED, "no"], [OPEN, "yes"], [CONTROL, "yes"]
    assert judge([stated, not_stated, control]) == ("not reproduced, 1 of 2", "reproduced, 1 of 2")
    assert judge([not_stated, best]) == ("not reproduced, 0 of 1", "reproduced, 1 of 2")
    assert judge([not_stated, control]) == ("not reproduced, 0 of 1",) * 2


def test_a_value_that_contradicts_the_paper_makes_a_control():
    best = "Kp 150, reference 2 rad/s"
    kinds = {"first values": STATED, "noise 1 dB": STATED, best: OPEN, f"{best}, rate 10 kHz, noise 1 dB": OPEN}
    kinds |= dict.fromkeys(("noise σ 0.01", f"noise σ 0.01, {best}", "estimates double"), CONTROL)
    assert kinds.items() <= {title: kind for kind, title, _ in CLAIMS["figure-4b-error"].cases}.items()


@pytest.mark.parametrize("name", CLAIMS)
def test_cases_differ_and_change_values_of_the_claim(name):
    kinds, titles, values = zip(*CLAIMS[name].cases, strict=True)
    assert (kinds[0], len({*titles})) == (STATED, len(titles))
    assert all(each.keys() == values[0].keys() for each in values)


@pytest.mark.parametrize(("direction", "low", "high"), [("larger", 1, 4), ("smaller", 0.25, 1), ("both", 0.25, 4)])
def test_a_radius_has_directions(direction, low, high):
    """Radius 3: the real parameters lie within [1, 4], [1/4, 1] and [1/4, 4] times the nominal ones, and fill them."""
    env = TwoLinkArmVectorEnv(500, measuring.with_radius(scenarios.get("nominal"), 3.0, direction), action="torque")
    env.reset(seed=0)
    ratios = np.hstack([env.truth.masses / [20.0, 15.0], env.truth.lengths / [0.7, 0.5]])
    assert low - 1e-9 < ratios.min() < low * 1.05 <= high / 1.05 < ratios.max() < high + 1e-9


@pytest.mark.parametrize("name", CLAIMS)
def test_the_committed_verdicts_follow_from_the_cases_that_the_code_declares(name):
    committed, declared = COMMITTED[name], CLAIMS[name]
    assert [case[:2] for case in committed["cases"]] == [[kind, title] for kind, title, _ in declared.cases]
    assert declared.texts.items() <= committed.items()
    for *_, measured, count, holds in committed["cases"]:
        assert Outcome(meets(count, holds), measured).texts == (measured, count, holds)
    assert (committed["at_stated"], committed["at_best"]) == judge(committed["cases"])


def meets(count, holds):
    """Return flags of seeds from "39 of 40", or the flag of a measurement without chance."""
    met, _, n = count.partition(" of ")
    return np.arange(int(n)) < int(met) if n else holds == "yes"


@pytest.mark.parametrize(("name", "i"), [(name, i) for name, cases in QUICK.items() for i in cases])
def test_two_seeds_meet_a_claim_as_all_do(name, i, monkeypatch):
    def short(policy, task, seeds, *more):
        return rollout(policy, task.replace(duration=SECONDS.get(name, task.duration)), seeds[:2], *more)

    monkeypatch.setattr(measuring, "rollout", short)
    measuring.metrics.cache_clear()
    measured = CLAIMS[name].measure(CLAIMS[name].cases[i][2])
    _, _, text, count, holds = COMMITTED[name]["cases"][i]
    assert len(set(meets(count, holds))) == 1 if count else name in SECONDS or measured.measured == text
    assert np.all(measured.meets == (holds == "yes"))


#: Claims whose runs amplify last bits, which depend on the processor, and by how much.
ROUNDING = {"soft-scheduling": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAIMS)
def test_the_committed_numbers_are_those_of_the_code(name, tmp_path):
    """In the short form."""
    measuring.metrics.cache_clear()
    (short, draw), committed = measure_claim(name, SHORT), COMMITTED[name]
    mine, theirs = (json.dumps(cases) for cases in (short["cases"], committed["cases"][:SHORT]))
    number = re.compile(r"\d+(?:\.\d+)?")
    assert number.sub("#", mine) == number.sub("#", theirs)
    numbers = ([float(text) for text in number.findall(cases)] for cases in (mine, theirs))
    np.testing.assert_allclose(*numbers, rtol=ROUNDING.get(name, 0))
    if draw is not None:
        draw(tmp_path / "picture.png")
        assert (tmp_path / "picture.png").stat().st_size > 10_000


NAMES = re.compile("`([^`]+)`")
POINTS = PAGE.partition("## In short")[2].partition("\n## ")[0].split("\n- ")[1:]
ROWS = [" ".join(row.split(" | ")[2:]) for row in PAGE.splitlines() if row.startswith("| ")]


def test_the_summary_counts_the_verdicts():
    verdicts = ([each[column] for each in COMMITTED.values()] for column in ("at_stated", "at_best"))
    stated, best = (sum(text.startswith("reproduced") for text in texts) for texts in verdicts)
    assert f"{stated} of {len(CLAIMS)} claims are reproduced at stated values, and {best} at" in PAGE


@pytest.mark.parametrize("line", POINTS + ROWS, ids=lambda line: line[:30])
def test_each_number_of_the_page_is_one_of_the_claims_that_it_names(line):
    """In the summary and in the table of misprints, where a line names claims."""
    named = [COMMITTED[name] for name in NAMES.findall(line) if name in CLAIMS]
    assert named or line in ROWS
    text = re.sub(r"\(\d+\)", "", line)  # without numbers of equations
    printed = set(re.findall(r"(?<![\w.§-])\d+(?:\.\d+)?(?:e-?\d+)?(?!\w)", text))
    assert not named or printed <= set(re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", json.dumps(named).replace(",", "")))


def test_the_page_has_the_numbers_of_its_cart_and_pendulum(capsys):
    runpy.run_path(str(DOCS.parents[1] / "examples" / "cart_and_pendulum.py"))
    printed = re.findall(r"([\d.]+ %)\n", capsys.readouterr().out)
    assert len(printed) == 5
    assert all(error in PAGE.partition("It prints ")[2] for error in printed)


def test_names_select_claims():
    """The beginning of names selects all claims with it."""
    assert claims.select(["figure-4b"]) == [f"figure-4b-{kind}" for kind in ("filter", "error", "settling")]
    assert claims.select([]) == list(CLAIMS)


CLAIM = COMMITTED["figure-5"] | {"cases": [["stated", "first", "2 %", "", "yes"]]}


def test_new_measurements_replace_old_ones_and_other_claims_stay(tmp_path, monkeypatch, fbl_gym):
    """In the paper's order."""
    claims.save(tmp_path, {"figure-7": CLAIM, "figure-6a": CLAIM | {"paper": "3 %"}})
    monkeypatch.setattr(reproduce, "measure_claim", lambda name, cases: (CLAIM, None))
    fbl_gym(f"reproduce --only figure-6a equation-10 --out {tmp_path}")
    assert list(claims.load(tmp_path).items()) == [(name, CLAIM) for name in ("equation-10", "figure-6a", "figure-7")]
    assert (tmp_path / "claims.md").read_text().count("first case, first: 2 %") == 3
    (tmp_path / "claims.json").write_text('[{"name": "figure-7"}]')
    assert "claims.json must be absent, or as `fbl-gym reproduce` wr" in fbl_gym(f"reproduce --out {tmp_path}", 2).err
