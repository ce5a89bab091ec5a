"""The page in a real browser, with numbers from real runs of short episodes."""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from benchmarks.analysis.board import assemble
from benchmarks.analysis.statistics import Estimate
from benchmarks.report.figures import degradation
from benchmarks.report.page import contents, write_page
from benchmarks.report.scenes import scene
from benchmarks.run import runner
from benchmarks.run.cell import run_cell
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.runner import run, traces
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from benchmarks.run.traces import POINTS, load_trace, trace_path
from fbl_gym import scenarios

POLICIES = ("zero", "pd-gravity", "pid-flm", "cascade-flm", "adaptive-flm-ls", "oracle-flm")
SCENARIOS = (
    "nominal", *(f"{family}-{severity}" for family in ("mass-error", "disturbance") for severity in (1, 2, 3)), "knock",
)  # fmt: skip
SEEDS = tuple(range(8))
BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")


def short(scenario):
    if scenario == "knock":
        return short("nominal").replace(name="knock", events=[{"kind": "knock", "time": 0.5, "impulse": [9.0, 3.0]}])
    return scenarios.get(scenario).replace(duration=1.5)


@pytest.fixture(scope="module")
def board():
    return assemble([run_cell(Cell(policy, short(scenario), SEEDS)) for policy in POLICIES for scenario in SCENARIOS])


@pytest.fixture(scope="module")
def data(board, tmp_path_factory):
    """Contents of a page of six policies on two families, with a title that could end its script."""
    results = [run_cell(Cell("zero", short("nominal"), SEEDS))]
    store = Store(tmp_path_factory.mktemp("store"))
    moving = []
    for name in SCENARIOS:
        for policy in board.policies:
            run_cell(Cell(policy, short(name), SEEDS[:1]), store=store)
        runs = {board.policies[i]: load_trace(Cell(board.policies[i], short(name), SEEDS), store) for i in board.order}
        moving.append(scene(short(name), 0, runs))
    page = contents(board, results, moving, "pytest")
    return {**page, "title": "fbl-gym leaderboard </script><b>"}


@pytest.fixture(scope="module")
def path(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "deep" / "index.html"
    write_page(path, data)
    return path


def column(data, key):
    """Return a column of the board as a dict by policy."""
    (values,) = [column.values for column in data["columns"] if column.key == key]
    return dict(zip(data["policies"], values, strict=True))


def test_the_page_contains_its_data_and_loads_nothing(path, data):
    text = path.read_text(encoding="utf-8")
    (inside,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    stored = json.loads(inside)["figures"]["degradation"][0]
    assert stored["title"] == data["figures"]["degradation"][0]["title"]
    np.testing.assert_allclose(stored["data"][0]["y"], data["figures"]["degradation"][0]["data"][0]["y"], rtol=1e-4)
    assert "default-src 'none'" in text
    assert not re.search(r"<(script|img|link|iframe)[^>]* (src|href)=", text.split("* plotly.js")[0])
    assert "<b>" not in text.split("* plotly.js")[0]


def test_a_policy_cannot_put_markup_into_the_page(data, tmp_path):
    evil = '<img src=x onerror="alert(1)">'
    policies = [evil, *data["policies"][1:]]
    columns = [replace(c, values=policies) if c.key == "policy" else c for c in data["columns"]]
    order, ranked = (
        [evil if name == data["policies"][0] else name for name in data[key]] for key in ("order", "ranked")
    )
    changed = {**data, "policies": policies, "columns": columns, "order": order, "ranked": ranked}
    write_page(tmp_path / "index.html", changed)
    assert "<img" not in (tmp_path / "index.html").read_text(encoding="utf-8").split("* plotly.js")[0]


def test_a_scene_is_the_first_lane_of_its_traces(data):
    stored = data["scenes"][SCENARIOS.index("disturbance-3")]
    trace = rollout("pd-gravity", short("disturbance-3"), SEEDS)
    (run,) = [run for run in stored["runs"] if run["policy"] == "pd-gravity"]
    assert (stored["scenario"], stored["seed"]) == ("disturbance-3", 0)
    assert len(stored["time"]) <= POINTS
    assert run["error_pct"] == pytest.approx(measure(trace)[0]["error_pct"], rel=1e-4)
    for signal, expected in (
        (run["position"], trace.position),
        (run["torque"], trace.torque),
        (stored["reference"], trace.reference),
        (stored["disturbance"], trace.disturbance),
    ):
        np.testing.assert_allclose(np.transpose(signal), expected[:, 0], rtol=1e-4)
    np.testing.assert_array_equal(stored["lengths"], [0.7, 0.5])
    (still,) = [run for run in stored["runs"] if run["policy"] == "zero"]
    zero = rollout("zero", short("disturbance-3"), SEEDS)
    assert (still["diverged"] is None) == bool(zero.alive[-1, 0])


def test_a_diverged_run_stays_without_position_and_torque(tmp_path):
    store = Store(tmp_path)
    cell = Cell("zero", short("nominal").replace(limits={"position": 9.0, "velocity": 1.0}), SEEDS)
    result, trace = run_cell(cell, store=store), load_trace(cell, store)
    assert result.rows[0]["diverged"] == 1.0
    assert trace["error_pct"] == pytest.approx(result.rows[0]["error_pct"], rel=1e-4)
    assert [position is None for position in trace["position"][0]] == [
        time >= trace["diverged"] for time in trace["time"]
    ]
    assert None not in trace["reference"][0]


def test_a_run_of_cells_stores_their_traces_and_the_page_runs_none_again(tmp_path, monkeypatch):
    cells, store = (
        [Cell("pd-gravity", short(s).replace(duration=0.1), SEEDS[:2]) for s in SCENARIOS[:2]],
        Store(tmp_path),
    )
    assert [outcome.done for outcome in run(cells, store, traced=SCENARIOS[:1])] == ["computed"] * 2
    assert len(store.files()) == 2  # a trace is no result
    (absent,) = [cell for cell in cells if not trace_path(cell, store).exists()]
    assert absent.scenario.name == SCENARIOS[1]
    first = traces([*cells, *cells], store)
    monkeypatch.setattr(runner, "run_apart", lambda *_: pytest.fail("it was run again"))
    assert traces(cells, store) == first
    trace_path(cells[0], store).write_text("{")
    with pytest.raises(ValueError, match=r"trace1 is damaged .*: delete it"):
        traces(cells, store)


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
    return page.execute_script(
        "return [...document.querySelectorAll('#table tbody tr:not([hidden])')].map(row => row.dataset.policy)"
    )


def press(page, selector):
    page.execute_script("document.querySelector(arguments[0]).click()", selector)


def test_the_board_sorts(page, data):
    rank, score = column(data, "rank"), column(data, "score")
    assert names(page) == sorted(POLICIES, key=lambda p: (rank[p] is None, rank[p]))
    press(page, "[data-sort=score]")
    assert names(page) == sorted(POLICIES, key=lambda p: -score[p])
    press(page, "[data-sort=score]")
    assert names(page) == sorted(POLICIES, key=score.get)
    sorts = page.execute_script("return [...document.querySelectorAll('#table [aria-sort]')].map(e => e.ariaSort)")
    assert sorted(set(sorts)) == ["ascending", "none"]
    assert sorts.count("ascending") == 1
    press(page, "[data-sort=rank]")
    assert names(page)[-1] == "oracle-flm"  # without a rank, last in both directions
    press(page, "[data-sort=rank]")
    assert names(page)[-1] == "oracle-flm"


def test_families_are_columns_of_the_board(page, data):
    heads = [head.text for head in page.find_elements("css selector", "#table thead th")]
    assert {"nominal", "mass-error", "disturbance"} <= set(heads)
    press(page, "[data-sort='family-mass-error']")
    values = column(data, "family-mass-error")
    assert names(page) == sorted(POLICIES, key=values.get)
    place = next(i for i, head in enumerate(heads) if head.startswith("mass-error"))
    first = page.find_elements("css selector", "#table tbody tr:first-child > *")[place]
    value, ends = first.text.split("\n")
    assert float(value) == pytest.approx(values[names(page)[0]], rel=6e-3)
    assert "…" in ends


def test_the_board_sorts_with_the_keyboard(page):
    page.execute_script("document.querySelector('[data-sort=policy]').focus()")
    page.switch_to.active_element.send_keys(Keys.ENTER)
    assert names(page) == sorted(POLICIES)
    page.switch_to.active_element.send_keys(Keys.SPACE)
    assert names(page) == sorted(POLICIES, reverse=True)


def test_the_board_filters(page):
    page.find_element("id", "search").send_keys("flm cascade")
    assert names(page) == ["cascade-flm"]
    assert page.find_element("id", "count").text == "1 of 6 policies"
    page.find_element("id", "search").send_keys(Keys.CONTROL + "a", Keys.DELETE)
    select = page.find_element("id", "filter-access")
    (option,) = [option for option in select.find_elements("tag name", "option") if option.text == "none"]
    option.click()
    assert names(page) == ["zero"]
    assert not page.find_element("css selector", "label:has(#filter-preview)").is_displayed()  # all have the same


def test_figures_are_drawn_and_follow_the_chips_and_filters(page, data):
    def curves(section="degradation"):
        return page.execute_script(
            "return document.querySelector(arguments[0]).data?.map(line => line.name)", f"#{section} .plot"
        )

    page.execute_script("document.querySelector('#degradation').scrollIntoView()")
    WebDriverWait(page, 5).until(lambda _: curves())
    assert curves() == data["order"]
    press(page, "[data-chip=zero]")
    assert curves() == [policy for policy in data["order"] if policy != "zero"]
    page.execute_script("document.querySelector('#pairs').scrollIntoView()")
    rows = "return document.querySelector('#pairs .plot').data?.[0].y"
    WebDriverWait(page, 5).until(lambda _: page.execute_script(rows))
    assert page.execute_script(rows) == [policy for policy in data["order"] if policy != "zero"]
    page.find_element("id", "search").send_keys("flm")
    assert curves() == [policy for policy in data["order"] if "flm" in policy]
    press(page, "#degradation summary")
    cell = "#degradation details td"
    WebDriverWait(page, 5).until(lambda page: page.find_elements("css selector", cell))
    text = page.find_element("css selector", cell).text.split("\n")[0]
    assert float(text) == pytest.approx(data["figures"]["degradation"][0]["data"][0]["y"][0], rel=5e-3)


def test_a_severity_without_runs_leaves_a_gap():
    numbers = np.array([[1.0, 2.0, 4.0]])
    board = SimpleNamespace(
        policies=("a",), order=[0], degradation={"noise": ("text", [0, 2, 3], Estimate(numbers, numbers, numbers))}
    )
    (figure,) = degradation(board)
    (line,) = figure["data"]
    np.testing.assert_array_equal(line["x"], [0, 1, 2, 3])
    np.testing.assert_array_equal(line["y"], [1.0, np.nan, 2.0, 4.0])


def test_a_figure_is_saved_as_svg(page, tmp_path):
    page.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    page.execute_script("document.querySelector('#degradation').scrollIntoView()")
    button = "#degradation .modebar-btn"
    WebDriverWait(page, 5).until(lambda page: page.find_elements("css selector", button))
    page.execute_script("document.querySelector(arguments[0]).dispatchEvent(new Event('click'))", button)
    WebDriverWait(page, 5).until(lambda _: list(tmp_path.glob("*.svg")))
    (saved,) = tmp_path.glob("*.svg")
    assert 'class="legendtext"' in saved.read_text()
    assert saved.read_text().count(">pid-flm<") == 1


def test_the_pareto_front_and_the_recovery_are_drawn(page, data):
    draw = "document.querySelector(arguments[0]).scrollIntoView(); return document.querySelector(arguments[0] + ' .plot').data"
    for section in ("#pareto", "#recovery"):
        WebDriverWait(page, 5).until(lambda _, section=section: page.execute_script(draw, section))
    front, *points = page.execute_script(draw, "#pareto")
    assert {point["name"] for point in points} == set(data["ranked"])
    assert front["x"] == sorted(front["x"])
    assert front["y"] == sorted(front["y"], reverse=True)
    (heatmap,) = page.execute_script(draw, "#recovery")
    assert (heatmap["x"], heatmap["y"]) == (["knock"], data["order"])
    press(page, "[data-chip=zero]")
    (heatmap,) = page.execute_script(draw, "#recovery")
    assert heatmap["x"] == ["knock"]
    assert "zero" not in heatmap["y"]
    assert not page.find_elements("css selector", "#pareto details")


def test_the_arm_moves_when_played(page, data):
    page.execute_script("document.querySelector('#scenes').scrollIntoView()")
    arm = "return document.querySelector('#arm').data.filter(line => line.line?.width === 9)[0].x[1]"
    before = page.execute_script(arm)
    readout = page.find_element("id", "readout")
    assert readout.text.startswith("t = 0.00 s, error of joints 1 and 2: ")
    button, slider = page.find_element("id", "play"), page.find_element("id", "time")
    press(page, "#play")
    assert button.text == "Pause"
    WebDriverWait(page, 20, poll_frequency=0.05).until(lambda _: float(slider.get_attribute("value")) > 0.2)
    # In one script: between two calls, a slow browser may reach the end.
    page.execute_script("const b = document.querySelector('#play'); if (b.textContent === 'Pause') b.click()")
    assert button.text == "Play"
    assert page.execute_script(arm) != before
    page.execute_script(
        """const slider = document.querySelector('#time');
        slider.value = slider.max; slider.dispatchEvent(new Event('input'));"""
    )
    first = data["scenes"][0]
    (run,) = [run for run in first["runs"] if run["policy"] == data["order"][0]]
    errors = 1e3 * (np.asarray(first["reference"])[:, -1] - np.asarray(run["position"])[:, -1])
    shown = [float(x) for x in re.findall(r"-?\d+\.\d+", readout.text.partition(":")[2])]
    assert shown == pytest.approx(errors, abs=0.2)
    page.execute_script(
        """const choice = document.querySelector('#scene');
        choice.value = 3; choice.dispatchEvent(new Event('change'));"""
    )
    assert "Scenario: " + data["scenes"][3]["description"] in page.find_element("id", "scene-text").text


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
    columns = [replace(c, values=[None] * len(POLICIES), low=(), high=()) if c.key == "rank" else c
               for c in data["columns"] if c.key != "score"]  # fmt: skip
    alone = {**data, "columns": columns, "figures": {}, "scenes": []}
    write_page(tmp_path / "index.html", alone)
    page.get((tmp_path / "index.html").as_uri())
    assert names(page) == data["order"]
    assert [link.text for link in page.find_elements("css selector", "#links a")] == ["Board"]
