"""The page in a real browser, with numbers from real runs of short episodes."""

import json
import re
import shutil

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from benchmarks.analysis import statistics
from benchmarks.analysis.board import assemble
from benchmarks.analysis.generalization import RangeErrors
from benchmarks.analysis.robustness import BOUND, DIRECTIONS, with_radius
from benchmarks.report.contents import contents
from benchmarks.report.page import POINTS, scene, write_page
from benchmarks.run.cell import run_cell
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.suite import Cell
from fbl_gym import scenarios

POLICIES = ("zero", "pd-gravity", "pid-flm", "cascade-flm", "adaptive-flm-ls", "oracle-flm")
SCENARIOS = ("nominal", *(f"{family}-{severity}" for family in ("mass-error", "disturbance") for severity in (1, 2, 3)))
SEEDS = tuple(range(8))
BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")


def short(scenario):
    return scenarios.get(scenario).replace(duration=1.5)


def radius(policy, direction):
    """The uncertainty radius, roughly."""

    def share(r):
        rows = measure(rollout(policy, with_radius(short("nominal"), r, direction), SEEDS[:2]))
        return float(np.mean([row["error_pct"] <= BOUND for row in rows]))

    return statistics.radius(share, scan=3, tolerance=0.5)


@pytest.fixture(scope="module")
def data():
    """What the page shows of a board of six policies on two families.

    Rows that are not in the order of the ranks, so that the page sorts them, and a title that could end its script.
    """
    results = [run_cell(Cell(policy, short(scenario), SEEDS)) for policy in POLICIES for scenario in SCENARIOS]
    board = assemble(results)
    radii = {(policy, way): radius(policy, way) for policy in ("pd-gravity", "cascade-flm") for way in DIRECTIONS}
    splits = {"extrapolation": RangeErrors(board.family_errors["mass-error"], np.full(len(POLICIES), 0.25))}
    page = contents(board, results, radii, splits, "pytest")
    rows = sorted(page["policies"], key=lambda row: POLICIES.index(row["name"]))
    assert rows != page["policies"]
    return {**page, "title": "fbl-gym leaderboard </script><b>", "policies": rows}


@pytest.fixture(scope="module")
def path(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "deep" / "index.html"
    write_page(path, data)
    return path


def of(policy, lines):
    """The one of a list of runs or curves that is this policy's."""
    (found,) = [line for line in lines if line["policy"] == policy]
    return found


def test_the_page_holds_its_data_and_loads_nothing(path, data):
    text = path.read_text(encoding="utf-8")
    (inside,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    found = json.loads(inside)
    assert found["title"] == data["title"]
    assert [policy["name"] for policy in found["policies"]] == list(POLICIES)
    assert found["policies"][3]["error"]["value"] == pytest.approx(data["policies"][3]["error"]["value"], rel=1e-4)
    assert "default-src 'none'" in text
    assert not re.search(r"<(script|img|link|iframe)[^>]* (src|href)=", text.split("* plotly.js")[0])
    assert "<b>" not in text.split("<style>")[0]


def test_a_scene_is_one_lane_of_its_traces(data):
    found = data["scenes"][SCENARIOS.index("disturbance-3")]
    trace = rollout("pd-gravity", short("disturbance-3"), SEEDS)
    run = of("pd-gravity", found["runs"])
    assert (found["scenario"], found["seed"]) == ("disturbance-3", 0)
    assert len(found["time"]) <= POINTS
    assert run["error_pct"] == measure(trace)[0]["error_pct"]
    for signal, expected in (
        (run["position"], trace.position),
        (run["torque"], trace.torque),
        (found["reference"], trace.reference),
        (found["disturbance"], trace.disturbance),
    ):
        np.testing.assert_array_equal(np.transpose(signal), expected[:, 0])
    fallen = of("zero", found["runs"])
    zero = rollout("zero", short("disturbance-3"), SEEDS)
    assert (fallen["diverged"] is None) == bool(zero.alive[-1, 0])
    with pytest.raises(ValueError, match="traces must be of one scenario and the same seeds"):
        scene({"one": trace, "other": rollout("zero", short("nominal"), SEEDS)}, [1, 1])


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Starts headless Chromium in a window of a size; skips where there is none."""
    if not (BROWSER and DRIVER):
        pytest.skip("needs Chromium and its driver: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in (
        "headless=new",
        "no-sandbox",
        "disable-gpu",
        "disable-quic",
        "no-first-run",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        "disable-dev-shm-usage",
        f"user-data-dir={tmp_path_factory.mktemp('chromium')}",
    ):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def page(browser, path):
    browser.set_window_size(1280, 900)
    browser.get(path.as_uri())
    yield browser
    problems = [entry["message"] for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
    assert problems == []


def names(page):
    heads = page.find_elements("css selector", "#board-table tbody .pin")
    return [head.text.split("\n")[0] for head in heads]


def press(page, selector):
    page.execute_script("document.querySelector(arguments[0]).click()", selector)


def test_the_board_sorts(page, data):
    by_rank = sorted(data["policies"], key=lambda p: (p["rank"] is None, p["rank"] and p["rank"]["value"]))
    assert names(page) == [policy["name"] for policy in by_rank]
    press(page, "[data-sort=score]")
    assert names(page) == [p["name"] for p in sorted(data["policies"], key=lambda p: -p["score"]["value"])]
    press(page, "[data-sort=score]")
    assert names(page) == [p["name"] for p in sorted(data["policies"], key=lambda p: p["score"]["value"])]
    sorts = page.execute_script(
        "return [...document.querySelectorAll('#board-table [aria-sort]')].map(e => e.ariaSort)"
    )
    assert sorted(set(sorts)) == ["ascending", "none"]
    assert sorts.count("ascending") == 1
    press(page, "[data-sort=rank]")
    assert names(page)[-1] == "oracle-flm"  # unranked, last either way
    press(page, "[data-sort=rank]")
    assert names(page)[-1] == "oracle-flm"


def test_splits_are_columns_of_the_board(page, data):
    heads = page.find_elements("css selector", "#board-table thead tr:last-child th")
    at = [head.text for head in heads].index("extrapolation")
    first = page.find_elements("css selector", "#board-table tbody tr:first-child > *")[at]
    value, ends, diverged = first.text.split("\n")
    (policy,) = [policy for policy in data["policies"] if policy["name"] == names(page)[0]]
    assert float(value) == pytest.approx(policy["splits"]["extrapolation"]["value"], rel=5e-3)
    assert "…" in ends
    assert diverged == "25.0 % diverged"
    press(page, "[data-sort='split-extrapolation']")
    values = {policy["name"]: policy["splits"]["extrapolation"]["value"] for policy in data["policies"]}
    assert names(page) == sorted(values, key=values.get)


def test_the_board_sorts_with_the_keyboard(page):
    page.execute_script("document.querySelector('[data-sort=name]').focus()")
    page.switch_to.active_element.send_keys(Keys.ENTER)
    assert names(page) == sorted(POLICIES)
    page.switch_to.active_element.send_keys(Keys.SPACE)
    assert names(page) == sorted(POLICIES, reverse=True)


def test_the_board_filters(page):
    page.find_element("id", "search").send_keys("flm cascade")
    assert set(names(page)) == {"cascade-flm"}
    assert page.find_element("id", "count").text == "1 of 6 policies"
    page.find_element("id", "search").send_keys(Keys.CONTROL + "a", Keys.DELETE)
    page.find_element("css selector", "#filter-access option:nth-child(2)").click()
    assert names(page) == ["zero"]
    assert not page.find_element("css selector", "label:has(#filter-preview)").is_displayed()  # all have the same


def test_charts_are_drawn_and_follow_the_chips(page, data):
    def curves():
        return page.execute_script("return document.querySelector('#degradation .plot').data?.map(line => line.name)")

    page.execute_script("document.querySelector('#degradation').scrollIntoView()")
    WebDriverWait(page, 5).until(lambda _: curves())
    expected = [curve["policy"] for curve in data["degradation"][0]["curves"]]
    assert sorted(expected) == sorted(POLICIES)
    assert curves() == expected
    press(page, "[data-chip=zero]")
    assert curves() == [policy for policy in expected if policy != "zero"]
    assert len(page.find_elements("css selector", "#pairs tbody tr")) == len(POLICIES) - 1
    press(page, "#degradation summary")
    cell = "#degradation details td"
    WebDriverWait(page, 5).until(lambda page: page.find_elements("css selector", cell))
    shown = page.find_element("css selector", cell).text.split("\n")[0]
    assert float(shown.replace("−", "-")) == pytest.approx(data["degradation"][0]["curves"][0]["value"][0], rel=5e-3)
    assert not page.find_elements("id", "learning")  # nothing given


def test_the_arm_moves_when_played(page, data):
    page.execute_script("document.querySelector('#scenes').scrollIntoView()")
    picture = "return document.querySelector('#arm').toDataURL()"
    before = page.execute_script(picture)
    assert page.find_element("css selector", "#readout th").text == "t = 0.00 s"
    press(page, "#play")
    button, scrub = page.find_element("id", "play"), page.find_element("id", "scrub")
    assert button.text == "Pause"
    WebDriverWait(page, 20, poll_frequency=0.05).until(lambda _: float(scrub.get_attribute("value")) > 100)
    if button.text == "Pause":  # a slow browser may be at the end
        press(page, "#play")
    assert button.text == "Play"
    assert page.execute_script(picture) != before
    page.execute_script(
        """const scrub = document.querySelector('#scrub');
        scrub.value = 1000; scrub.dispatchEvent(new Event('input'));"""
    )
    cells = page.find_elements("css selector", "#readout tbody tr:first-child td")
    last = [joint[-1] for joint in data["scenes"][0]["reference"]]
    assert [float(cell.text.replace("−", "-")) for cell in cells[:2]] == pytest.approx(last, abs=6e-4)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_scrolling_the_page_sideways(page, path, scheme):
    page.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    )
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    )
    page.get(path.as_uri())
    root = "document.documentElement"
    assert page.execute_script(f"return {root}.dataset.theme") == scheme
    assert page.execute_script(f"return {root}.scrollWidth") == 390
    press(page, "#theme")
    assert page.execute_script(f"return {root}.dataset.theme") != scheme
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_page_of_the_board_alone(page, data, tmp_path):
    lists = {name: [] for name, value in data.items() if isinstance(value, list)}
    without_score = [{**policy, "score": None, "rank": None} for policy in data["policies"][:2]]
    write_page(tmp_path / "index.html", {**data, **lists, "policies": without_score})
    page.get((tmp_path / "index.html").as_uri())
    assert names(page) == list(POLICIES[:2])
    assert [link.text for link in page.find_elements("css selector", "#links a")] == ["Board"]
