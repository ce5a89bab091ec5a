"""The page in a real browser, with numbers from real runs of short episodes."""

import json
import math
import re
import shutil

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

import controllers
from benchmarks import statistics
from benchmarks.metrics import measure
from benchmarks.report.page import POINTS, between, scene, write_page
from benchmarks.rollout import rollout
from fbl_gym import scenarios

POLICIES = ("zero", "pd-gravity", "pid-flm", "cascade-flm", "adaptive-flm-ls", "oracle-flm")
FAMILIES = ("mass-error", "disturbance")
SEVERITIES = (0, 1, 2, 3)
SEEDS = tuple(range(8))
BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")


def short(family, severity):
    return scenarios.family(family, severity).replace(duration=1.5)


def lengths(env, *_):
    return env.truth.lengths


@pytest.fixture(scope="module")
def data():
    """A page of six policies on two families, as the leaderboard would fill it."""
    traces = {
        (policy, family, severity): rollout(policy, short(family, severity), SEEDS, watch={"lengths": lengths})
        for policy in POLICIES
        for family in FAMILIES
        for severity in SEVERITIES
    }

    measured = [measure(trace) for trace in traces.values()]

    def column(name):  # [policy x family x severity x seed]
        return np.reshape(
            [[row[name] for row in rows] for rows in measured],
            (len(POLICIES), len(FAMILIES), len(SEVERITIES), len(SEEDS)),
        )

    def flat(x):
        return x.reshape(len(POLICIES), -1, len(SEEDS))

    error, failed = column("error_pct"), column("diverged")
    score = statistics.score(error, column("stay_pct"), error[-1:], failed)
    counts = statistics.resample(len(SEEDS), 0, resamples=200)
    of_error = statistics.estimate(flat(error), counts)
    of_score = statistics.estimate(flat(score), counts, statistics.mean)
    by_family = statistics.estimate(error, counts)
    by_severity = statistics.estimate(error[..., None, :], counts)
    ranked = [i for i, policy in enumerate(POLICIES) if controllers.tier(policy) != "truth"]
    rank = statistics.ranks(statistics.mean(-flat(score)[ranked], counts))
    tau = np.geomspace(0.01, 1000, 60)
    share = statistics.profile(flat(error), tau, counts)
    runs = failed[0].size
    failures = statistics.failures(flat(failed).sum(axis=(1, 2)), runs)

    def row(i, policy):
        return {
            "name": policy,
            "summary": controllers.summary(policy),
            "tier": controllers.tier(policy),
            "sensors": "none" if policy == "zero" else "position, velocity",
            "preview": "none",
            "tuning": "default gains",
            "rank": between(rank, ranked.index(i)) if i in ranked else None,
            "score": between(of_score, i),
            "error": between(of_error, i),
            "families": {family: between(by_family, i, f) for f, family in enumerate(FAMILIES)},
            "splits": {"extrapolation": {**between(by_family, i, 0), "diverged": 0.25}},
            "failures": between(failures, i),
            "variation": float(column("variation")[i].mean()),
            "decision_us": 1e6 * traces[policy, "mass-error", 0].decision_time,
            "label": "",
        }

    def curve(policy, x, found, *index):
        value, low, high = (part[index].tolist() for part in (found.value, found.low, found.high))
        return {"policy": policy, "x": list(x), "value": value, "low": low, "high": high}

    pairs = [
        [
            None if a == b else statistics.improvement(flat(error)[a], flat(error)[b], counts)
            for b in range(len(POLICIES))
        ]
        for a in range(len(POLICIES))
    ]

    def part(field):
        return [[None if pair is None else float(getattr(pair, field)) for pair in row] for row in pairs]

    def reach(policy, sign):
        def tracks(r):
            scenario = short("mass-error", 0).replace(
                parameter_error={"ratio": (1 + r) ** sign, "parameters": ("m1", "m2")}
            )
            return np.mean([row["error_pct"] < 5 for row in measure(rollout(policy, scenario, SEEDS[:2]))])

        found = statistics.radius(tracks, scan=3, tolerance=0.5)
        direction = "larger" if sign > 0 else "smaller"
        value = None if math.isnan(found.value) else found.value
        return {"policy": policy, "direction": direction, "value": value, "text": str(found), "tried": found.tried}

    return {
        "title": "fbl-gym leaderboard </script><b>",
        "summary": "Six policies on two families of uncertainty, in episodes of 1.5 s.",
        "facts": {"command": "pytest", "seeds": f"{SEEDS[0]} to {SEEDS[-1]}"},
        "families": {family: scenarios.families()[family] for family in FAMILIES},
        "splits": {"extrapolation": "everything-2 with parameters off by more"},
        "policies": [row(i, policy) for i, policy in enumerate(POLICIES)],
        "degradation": [
            {
                "title": family,
                "description": scenarios.families()[family],
                "x": "severity",
                "y": "error [%]",
                "scales": ("linear", "log"),
                "curves": [curve(policy, SEVERITIES, by_severity, i, f) for i, policy in enumerate(POLICIES)],
            }
            for f, family in enumerate(FAMILIES)
        ],
        "radius": [reach(policy, sign) for policy in ("pd-gravity", "cascade-flm") for sign in (1, -1)],
        "profiles": [
            {
                "title": "All scenarios",
                "description": "",
                "x": "error [%]",
                "y": "share of runs",
                "scales": ("log", "linear"),
                "curves": [curve(policy, tau, share, i) for i, policy in enumerate(POLICIES)],
            }
        ],
        "pairs": [
            {
                "title": "Probability of improvement",
                "description": "That a run of the row's policy errs less than one of the column's on another seed.",
                "policies": list(POLICIES),
                "value": part("value"),
                "low": part("low"),
                "high": part("high"),
            }
        ],
        "learning": [],
        "scenes": [
            scene(
                {policy: traces[policy, family, 3] for policy in POLICIES},
                traces["zero", family, 3].watched["lengths"][0, lane],
                lane,
            )
            for family in FAMILIES
            for lane in (0,)
        ],
    }


@pytest.fixture(scope="module")
def path(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "deep" / "index.html"
    write_page(path, data)
    return path


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
    found = data["scenes"][1]
    trace = rollout("pd-gravity", short("disturbance", 3), SEEDS)
    run = found["runs"][1]
    assert (found["scenario"], found["seed"], run["policy"]) == ("disturbance-3", 0, "pd-gravity")
    assert len(found["time"]) <= POINTS
    assert run["error_pct"] == measure(trace)[0]["error_pct"]
    for signal, expected in (
        (run["position"], trace.position),
        (run["torque"], trace.torque),
        (found["reference"], trace.reference),
        (found["disturbance"], trace.disturbance),
    ):
        np.testing.assert_array_equal(np.transpose(signal), expected[:, 0])
    fallen = found["runs"][0]
    zero = rollout("zero", short("disturbance", 3), SEEDS)
    assert (fallen["diverged"] is None) == bool(zero.alive[-1, 0])
    with pytest.raises(ValueError, match="traces must be of one scenario and the same seeds"):
        scene({"one": trace, "other": rollout("zero", short("nominal", 0), SEEDS)}, [1, 1])


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
    page.find_element("css selector", "#filter-tier option:nth-child(2)").click()
    assert names(page) == ["zero"]
    assert not page.find_element("css selector", "label:has(#filter-preview)").is_displayed()  # all have the same


def test_charts_are_drawn_and_follow_the_chips(page, data):
    def curves():
        return page.execute_script("return document.querySelector('#degradation .plot').data?.map(line => line.name)")

    page.execute_script("document.querySelector('#degradation').scrollIntoView()")
    WebDriverWait(page, 5).until(lambda _: curves())
    assert curves() == list(POLICIES)
    press(page, "[data-chip=zero]")
    assert curves() == list(POLICIES[1:])
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
    page.execute_async_script("setTimeout(arguments[0], 400)")
    assert page.find_element("id", "play").text == "Pause"
    press(page, "#play")
    time = float(page.find_element("id", "scrub").get_attribute("value")) / 1000 * 1.5
    assert 0.1 < time < 1.5
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
