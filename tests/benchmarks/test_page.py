"""Reports, run as a user runs them; and the page in a real browser, with numbers from real runs of short episodes."""

import csv
import json
import re
import shutil
from dataclasses import replace

import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from benchmarks.analysis.board import assemble
from benchmarks.report.columns import columns
from benchmarks.report.page import pareto, write_page
from benchmarks.run.cell import Cell
from benchmarks.run.metrics import METRICS
from benchmarks.run.runner import run_cell
from fbl_gym import scenarios

POLICIES = ("zero", "pd-gravity", "pid-flm", "cascade-flm", "adaptive-flm", "oracle-flm")
SCENARIOS = ("nominal", "mass-error-1", "mass-error-3", "disturbance-2", "knock")
SEEDS = tuple(range(4))
BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")


def short(scenario):
    if scenario == "knock":
        return short("nominal").replace(name="knock", events=[{"kind": "knock", "time": 0.5, "impulse": [9.0, 3.0]}])
    return scenarios.get(scenario).replace(duration=1.5)


@pytest.fixture(scope="module")
def board():
    return assemble([run_cell(Cell(policy, short(scenario), SEEDS)) for policy in POLICIES for scenario in SCENARIOS])


@pytest.fixture(scope="module")
def results():
    return [run_cell(Cell("zero", short("nominal"), SEEDS))]


@pytest.fixture(scope="module")
def path(board, results, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "deep" / "index.html"
    write_page(path, board, results, "pytest")
    return path


def column(board, key):
    """Return a column of the board as a dict by policy."""
    (values,) = [column.values for column in columns(board) if column.key == key]
    return dict(zip(board.policies, values, strict=True))


def test_the_page_contains_its_data_and_loads_nothing(path, board):
    text = path.read_text(encoding="utf-8")
    (inside,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    assert json.loads(inside) == pareto(board)
    assert "default-src 'none'" in text
    assert not re.search(r"<(script|img|link|iframe)[^>]* (src|href)=", text.split("* plotly.js")[0])


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Starts headless Chromium in a window of a size; skips where there is none."""
    if not (BROWSER and DRIVER):
        pytest.skip("needs Chromium and its driver: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    quiet = "gpu quic background-networking component-update sync dev-shm-usage"
    for argument in ("headless=new", "no-sandbox", "no-first-run", *(f"disable-{part}" for part in quiet.split())):
        options.add_argument(f"--{argument}")
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('chromium')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def ready(page):
    """Wait until the scripts have run: a driver may return before, from a page that it has already."""
    ran = "return document.readyState === 'complete' && Boolean(document.querySelector('#count')?.textContent)"
    WebDriverWait(page, 20).until(lambda page: page.execute_script(ran))


def problems(browser):
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


@pytest.fixture
def page(browser, path):
    browser.set_window_size(1280, 900)
    browser.get(path.as_uri())
    ready(browser)
    yield browser
    assert problems(browser) == []


def names(page):
    rows = "document.querySelectorAll('#table tbody tr:not([hidden])')"
    return page.execute_script(f"return [...{rows}].map(row => row.dataset.policy)")


def press(page, selector):
    page.execute_script("document.querySelector(arguments[0]).click()", selector)


def test_the_board_sorts(page, board):
    rank, error = column(board, "rank"), column(board, "error")
    assert names(page) == sorted(POLICIES, key=lambda p: (rank[p] is None, rank[p]))
    for reverse in (False, True):
        press(page, "[data-sort=error]")
        assert names(page) == sorted(POLICIES, key=error.get, reverse=reverse)
    sorts = page.execute_script("return [...document.querySelectorAll('#table [aria-sort]')].map(e => e.ariaSort)")
    assert set(sorts) == {"descending", "none"}
    assert sorts.count("descending") == 1
    for _ in range(2):
        press(page, "[data-sort=rank]")
        assert names(page)[-1] == "oracle-flm"  # without a rank, last in both directions


def test_families_are_columns_of_the_board(page, board):
    heads = [head.text for head in page.find_elements("css selector", "#table thead th")]
    assert {"nominal", "mass-error", "disturbance"} <= set(heads)
    press(page, "[data-sort='family-mass-error']")
    values = column(board, "family-mass-error")
    assert names(page) == sorted(POLICIES, key=values.get)
    place = next(i for i, head in enumerate(heads) if head.startswith("mass-error"))
    first = page.find_elements("css selector", "#table tbody tr:first-child > *")[place]
    value, ends = first.text.split("\n")
    assert float(value) == pytest.approx(values[names(page)[0]], rel=6e-3)
    assert "…" in ends


def test_the_board_filters(page):
    page.find_element("id", "search").send_keys("flm pid")
    assert names(page) == ["pid-flm"]
    assert page.find_element("id", "count").text == "1 of 6 policies"
    page.find_element("id", "search").send_keys(Keys.CONTROL + "a", Keys.DELETE)
    select = page.find_element("id", "filter-access")
    (option,) = [option for option in select.find_elements("tag name", "option") if option.text == "none"]
    option.click()
    assert names(page) == ["zero"]
    assert not page.find_element("css selector", "label:has(#filter-tuning)").is_displayed()  # all have the same


def test_the_pareto_front_is_drawn_and_follows_the_filters(page, board):
    draw = "return document.querySelector('#plot').data"
    front, *points = page.execute_script(draw)
    assert {point["name"] for point in points} == {board.policies[i] for i in board.ranked if board.effort[i] > 0}
    assert front["x"] == sorted(front["x"])
    assert front["y"] == sorted(front["y"], reverse=True)
    page.find_element("id", "search").send_keys("flm")
    _, *points = page.execute_script(draw)
    assert {point["name"] for point in points} == {"pid-flm", "cascade-flm", "adaptive-flm"}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_scrolling_the_page_sideways(page, path, scheme):
    wish = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", wish)
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    page.get(path.as_uri())
    ready(page)
    root = "document.documentElement"
    assert page.execute_script(f"return {root}.dataset.theme") == scheme
    assert page.execute_script(f"return {root}.scrollWidth") == 390
    press(page, "#theme")
    page.refresh()  # the choice is kept
    ready(page)
    assert page.execute_script(f"return {root}.dataset.theme") != scheme
    page.execute_script("localStorage.clear()")
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_page_of_the_board_alone(page, board, results, tmp_path):
    rows = {policy: board.rows[policy] for policy in ("zero", "pid-flm")}
    runs = {name: runs[[0, 2]] for name, runs in board.runs.items()}
    alone = replace(board, rows=rows, runs=runs, decision_us=board.decision_us[[0, 2]])
    write_page(tmp_path / "index.html", alone, results, "pytest")
    page.get((tmp_path / "index.html").as_uri())
    assert names(page) == [alone.policies[i] for i in alone.order]
    assert [link.text for link in page.find_elements("css selector", "#links a")] == ["Board"]


#: Names of policies and scenarios that HTML, JavaScript, Plotly or the template could take for
#: their own.
NAMES = (
    '<img src=x onerror="document.title = 1">', '"><script>document.title = 2</script>', "a&amp;b < c > d",
    "quotes \" and '", "{{ TABLE }} %{y} \\u003c", "<b>bold</b><br><a href='https://x.org'>link</a>", "two\nlines\x1b[31m",
    "Überlänge 日本語 🤖",
)  # fmt: skip


def renamed(run, name, task):
    """A result with other names of its policy and its scenario."""
    policy = replace(run.cell.policy, parsed=replace(run.cell.policy.parsed, source=name))
    return replace(run, cell=replace(run.cell, policy=policy, scenario=short("nominal").replace(name=task)))


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """A page with these names alone."""
    runs = [run_cell(Cell(law, short("nominal"), SEEDS[:2])) for law in ("zero", "pd-gravity", "pid-flm", "oracle-flm")]
    results = [renamed(run, name, task) for run, name in zip(runs * 2, NAMES, strict=True) for task in NAMES]
    path = tmp_path_factory.mktemp("named") / "index.html"
    write_page(path, assemble(results), results, NAMES[0])
    return path


def test_no_name_is_an_element(named):
    """The next test looks at the page in a browser."""
    text = named.read_text(encoding="utf-8").split("* plotly.js")[0]
    assert not re.search(r"<img|<script>document|<b>bold|<a href='https://x", text)


def test_every_kind_of_name_is_text(browser, named):
    """No name becomes an element, an attribute or a style of the page or of a figure."""
    browser.set_window_size(1280, 900)
    browser.get(named.as_uri())
    assert sorted(names(browser)) == sorted(name.replace("\x1b", "\\u001b") for name in NAMES)
    heads = [head.text.replace("\n", " ") for head in browser.find_elements("css selector", "#table thead th")]
    heads = {head.split("\\u001b")[0].strip() for head in heads}
    assert {" ".join(name.split("\x1b")[0].split()) for name in NAMES} <= heads
    assert browser.find_elements("css selector", "thead .policy")[0].text == "policy"
    assert browser.execute_script("return document.querySelectorAll('img, main a, iframe, main script').length") == 0
    shown = browser.execute_script("return document.querySelector('#plot').data.map(line => line.name)")
    assert any(name.replace("&", "&amp;").replace("<", "&lt;") in shown for name in NAMES[:4])
    assert browser.title == "fbl-gym leaderboard"
    assert problems(browser) == []


# Reports.


FEW = "--policies zero --seeds 1 --scenarios nominal"


def test_the_report_has_every_run_and_the_accesses(tmp_path, fbl_gym):
    store, out, readme = (tmp_path / name for name in ("store", "out", "README.md"))
    same = f"--policies zero pid-flm cascade-flm oracle-flm --seeds 3 --scenarios nominal --store {store}"
    shown = fbl_gym(f"leaderboard {same} --workers 1").out.replace("\n", "")
    assert all(text in shown for text in ("1 scenario, 3 seeds each", "cascade-flm", "(oracle-flm)", "a page of them"))
    assert not list(store.glob(".*"))
    readme.write_text("before\n<!-- leaderboard -->\nold\n<!-- /leaderboard -->\nafter\n")
    fbl_gym(f"report {same} --out {out} --readme {readme}")
    table = (out / "board.md").read_text()
    assert table.startswith("| policy | rank | error % | lost runs % | × oracle |")
    before, _, rest = readme.read_text().partition("<!-- leaderboard -->\n")
    short, _, after = rest.partition("<!-- /leaderboard -->\n")
    assert (before, after) == ("before\n", "after\n")
    header, _, first, *_ = short.splitlines()
    assert header == "| rank | servo |"
    assert re.fullmatch(r"\| 1 \| `[\w-]+` [\d.]+ % \|", first)
    page, picture = ((tmp_path / "docs" / name).read_text() for name in ("results/board.md", "pictures/errors.svg"))
    assert "cascade-flm" in page
    assert "cascade-flm<" in picture  # a dot for each ranked policy
    assert "oracle-flm<" not in picture
    page = (out / "board.html").read_text()
    assert "cascade-flm" in page
    assert "src=" not in page.partition("<body")[0].replace("data:", "")
    runs = list(csv.DictReader((out / "board.csv").read_text().splitlines()))
    assert (len(runs), len({run["policy"] for run in runs})) == (12, 4)
    assert set(runs[0]) == {"policy", "scenario", "control_dt", "seed", *METRICS}


@pytest.fixture
def report(folder, fbl_gym):
    """The folder of a complete report."""
    fbl_gym(f"leaderboard {FEW} --workers 1")
    fbl_gym(f"report {FEW}")
    return folder / "results" / "report"


def test_an_incomplete_report_says_what_it_lacks(report, fbl_gym):
    assert "ncomplete" not in (report / "board.md").read_text()
    shown = fbl_gym(f"report {FEW} noise-1 noise-2", 1)
    sentence = "Incomplete: 2 of 3 scenarios have no results: noise-1, noise-2"
    assert sentence in shown.out
    assert "the report is incomplete" in shown.err
    for name in ("board.md", "board.html"):
        assert sentence in (report / name).read_text(encoding="utf-8")
    several = "--suite few.toml servo --policies zero --seeds 1"
    (report.parents[1] / "few.toml").write_text('policies = ["zero"]\nscenarios = ["nominal"]\n')
    assert "servo has no results, and no report" in fbl_gym(f"report {several}", 1).err


def test_a_page_is_complete_or_as_it_was(report, fbl_gym, monkeypatch):
    """Killed while it writes, the report leaves the last page."""
    before = {path.name: path.read_bytes() for path in report.iterdir()}
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    fbl_gym(f"report {FEW}", 130)
    assert {path.name: path.read_bytes() for path in report.iterdir()} == before
