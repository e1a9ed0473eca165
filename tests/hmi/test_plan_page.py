"""Plan, diagnosis and statistics in Chromium: a field is loaded or drawn, planned, stored, driven, counted."""

import re
import signal
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import SIZES, Browser, PageProcess, add_user, log_in, needs_browser, page_process, view, wait_for
from tests.hmi.planned import L_SHAPE, geojson

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
SHOUT = "<img src=x onerror=alert(1)>"
MISSION = ("--mission", "line", "--scenario", "empty", "--stop-port", "0")
LARGE = tuple((4.0 * x, 4.0 * y) for x, y in L_SHAPE)  # 11 ha, planned in some 10 s
COUNT_TONES = """window.tones = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...times) { window.tones++; return start.apply(this, times); };"""
COLORS = """() => {
  const c = document.getElementById('map'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  const seen = {};
  for (let k = 0; k < d.length; k += 4) { const v = d[k] << 16 | d[k + 1] << 8 | d[k + 2]; seen[v.toString(16)] = 1; }
  return Object.keys(seen); }"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("page")
    for user in ("anna:operate", "bo:operate", "cem:view"):
        add_user(found, user, PASSWORD)
    (found / "field.geojson").write_bytes(geojson())
    (found / "large.geojson").write_bytes(geojson(LARGE, "large"))
    return found


@pytest.fixture(scope="module")
def process(folder: Path) -> Iterator[PageProcess]:
    with page_process(folder, *MISSION) as found:
        yield found


@pytest.fixture(scope="module")
def anna(browser: Browser, process: PageProcess) -> Any:
    """The operator in control, on the plan view."""
    page = browser.open()
    page.add_init_script(COUNT_TONES)
    log_in(page, process, "anna", PASSWORD)
    view(page, "plan")
    page.click("[data-hl=seat-button]")
    wait_for(page, "[data-hl=seat]", "You have control")
    return page


def load(page: Any, path: Path) -> None:
    page.wait_for_selector("#field-file:not([disabled])")
    page.set_input_files("#field-file", str(path))


def planned(page: Any) -> None:
    """Plans and waits for the result."""
    page.click("#plan:not([disabled])")
    page.wait_for_selector("#rows-plan [data-key=length]", timeout=300_000.0)


def stored(page: Any, name: str) -> Any:
    """Row of a stored mission."""
    return page.locator("#table-missions tbody tr", has_text=name)


def test_a_field_file_is_loaded_and_planned_on_the_map(anna: Any, folder: Path) -> None:
    """BD-4.1f path set-up: field, machine, implement, headland passes, turns and direction; length, time and share."""
    load(anna, folder / "field.geojson")
    wait_for(anna, "#hint", "^corner field$")
    anna.select_option("#headland_passes", "3")
    anna.select_option("#heading_deg", "90")
    planned(anna)
    text = anna.text_content("#rows-plan")
    for part in (r"Length\d\.\d\d", r"Driving time, about\d+", "Planned share of the field9", "rows|Rows"):
        assert wait_for(anna, "#rows-plan", part), text
    assert {"1d4ed8", "14532d"} <= set(anna.evaluate(COLORS))  # rows and boundary


def test_a_mission_is_stored_under_any_name_without_running_it(anna: Any) -> None:
    anna.fill("#mission-name", SHOUT)
    anna.click("#store")
    stored(anna, SHOUT).wait_for()
    assert anna.locator("#table-missions img").count() == 0
    assert anna.locator("#store").is_disabled()


def test_a_reload_shows_field_plan_and_missions_again(anna: Any) -> None:
    anna.reload()
    anna.wait_for_selector("#rows-plan [data-key=length]")
    assert wait_for(anna, "#hint", ".") == SHOUT
    stored(anna, SHOUT).wait_for()


def test_an_option_that_changes_makes_the_plan_void(anna: Any) -> None:
    anna.select_option("#turns", "reverse")
    anna.wait_for_selector("#rows-plan [data-key=length]", state="detached")
    assert anna.locator("#store").is_disabled()
    stored(anna, SHOUT).get_by_text("Open").click()
    anna.wait_for_selector("#rows-plan [data-key=length]")
    anna.wait_for_function("() => document.getElementById('turns').value === 'forward'")


def test_a_bad_file_is_refused_in_words(anna: Any, folder: Path) -> None:
    crossing = ((0.0, 0.0), (0.001, 0.001), (0.001, 0.0), (0.0, 0.001), (0.0, 0.0))
    bad = {"crossing.geojson": geojson(crossing), "photo.png": b"\x89PNG\r\n" + bytes(100), "empty.kml": b""}
    words = {"crossing.geojson": "outline crosses itself", "photo.png": "no known field format", "empty.kml": "empty"}
    for name, content in bad.items():
        (folder / name).write_bytes(content)
        load(anna, folder / name)
        assert str(folder) not in wait_for(anna, "#answer", words[name])
        assert anna.locator("#plan").is_disabled()


def test_a_file_of_100_mb_is_refused_in_words(anna: Any, folder: Path) -> None:
    with (folder / "huge.geojson").open("wb") as file:
        file.truncate(100_000_000)
    load(anna, folder / "huge.geojson")
    wait_for(anna, "#answer", "larger than 20 MB")
    anna.evaluate("() => { document.getElementById('field-file').dataset.large = ''; }")


def test_a_field_is_drawn_by_clicks(anna: Any) -> None:
    anna.click("#draw:not([disabled])")
    wait_for(anna, "#hint", "0 so far")
    box = anna.locator("#map").bounding_box()
    for k, (x, y) in enumerate(((0.2, 0.2), (0.6, 0.2), (0.6, 0.9), (0.2, 0.7), (0.1, 0.1))):
        anna.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        wait_for(anna, "#hint", f"{k + 1} so far")
    anna.click("#undo")
    wait_for(anna, "#hint", "4 so far")
    anna.click("#close")
    wait_for(anna, "#hint", "^Drawn field$")
    planned(anna)


def test_no_go_area_and_gate_are_placed_by_clicks(anna: Any, folder: Path) -> None:
    """On the field of a file; the plan leaves the area out and begins at the gate."""
    (folder / "areas.geojson").write_bytes(geojson(name="field with areas"))
    load(anna, folder / "areas.geojson")
    wait_for(anna, "#hint", "^field with areas$")
    planned(anna)
    swaths = anna.text_content("#rows-plan [data-key=share] dd")
    anna.click("#no_go:not([disabled])")
    wait_for(anna, "#hint", "no-go area.*0 so far")
    box = anna.locator("#map").bounding_box()
    for k, (x, y) in enumerate(((0.37, 0.64), (0.41, 0.64), (0.41, 0.73), (0.37, 0.73))):
        anna.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        wait_for(anna, "#hint", f"{k + 1} so far")
    anna.wait_for_selector("#rows-plan [data-key=length]")
    anna.click("#close")
    anna.wait_for_selector("#rows-plan [data-key=length]", state="detached")  # the plan without it is void
    anna.click("#gate:not([disabled])")
    wait_for(anna, "#hint", "place of the gate")
    anna.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.97 * box["height"])
    wait_for(anna, "#hint", "^field with areas$")
    planned(anna)
    assert wait_for(anna, "#rows-plan [data-key=gate]", ".*[Gg]ate")
    assert anna.text_content("#rows-plan [data-key=share] dd") != swaths
    anna.click("#remove_areas:not([disabled])")
    anna.wait_for_selector("#rows-plan [data-key=length]", state="detached")
    anna.wait_for_selector("#remove_areas", state="hidden")


def test_a_lane_is_drawn_by_clicks(anna: Any, folder: Path) -> None:
    """From the edge of the field to the yard; the plan comes by it."""
    (folder / "lane.geojson").write_bytes(geojson(name="field with lane"))
    load(anna, folder / "lane.geojson")
    wait_for(anna, "#hint", "^field with lane$")
    for _ in range(2):
        anna.click("#map-smaller")
    anna.click("#lane:not([disabled])")
    wait_for(anna, "#hint", "lane from the edge.*0 so far")
    box = anna.locator("#map").bounding_box()
    for k, (x, y) in enumerate(((0.5, 0.7), (0.5, 0.82), (0.58, 0.93))):
        assert anna.locator("#close").is_disabled() == (k < 2)
        anna.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        wait_for(anna, "#hint", f"{k + 1} so far")
    anna.click("#close")
    wait_for(anna, "#hint", "^field with lane$")
    planned(anna)
    assert "yard" in wait_for(anna, "#rows-plan [data-key=gate] dd", "yard")
    anna.click("#remove_areas:not([disabled])")
    anna.wait_for_selector("#remove_areas", state="hidden")


def test_side_margin_and_refill_are_placed_by_clicks(anna: Any, folder: Path) -> None:
    """Their ends on the map are those of the clicks; the plan has the refill stop, without them it is void."""
    (folder / "places.geojson").write_bytes(geojson(name="field with places"))
    load(anna, folder / "places.geojson")
    wait_for(anna, "#hint", "^field with places$")

    def click(x: float, y: float) -> None:
        box = anna.locator("#map").bounding_box()  # the page scrolls to what is filled in
        anna.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])

    anna.select_option("#swath_skip", "1")
    anna.click("#swaths_from:not([disabled])")
    wait_for(anna, "#hint", "worked first")
    click(0.9, 0.5)
    wait_for(anna, "#hint", "^field with places$")
    anna.fill("#margin_amount", "2")
    anna.fill("#margin_reason", "hedge")
    anna.click("#margin:not([disabled])")
    wait_for(anna, "#hint", "0 of 2 so far")
    click(0.3, 0.97)
    wait_for(anna, "#hint", "1 of 2 so far")
    click(0.6, 0.97)
    wait_for(anna, "#hint", "^field with places$")
    anna.fill("#refill_amount", "none")
    anna.click("#refill:not([disabled])")
    wait_for(anna, "#answer", "a number and a reason are needed")
    anna.fill("#refill_amount", "3500")
    anna.click("#refill:not([disabled])")
    wait_for(anna, "#hint", "refill place")
    click(0.5, 0.97)
    wait_for(anna, "#hint", "^field with places$")
    assert {"b45a00", "7a0010"} <= set(anna.evaluate(COLORS))  # margin and labels
    planned(anna)
    assert wait_for(anna, "#rows-plan [data-key=refill1]", "m²")
    assert {"b45a00", "7a0010"} <= set(anna.evaluate(COLORS))
    anna.screenshot(path=str(folder / "places.png"), full_page=True)
    anna.click("#remove_places:not([disabled])")
    anna.wait_for_selector("#rows-plan [data-key=length]", state="detached")
    anna.wait_for_selector("#remove_places", state="hidden")
    anna.select_option("#swath_skip", "")


def test_rows_follow_a_guidance_line_that_is_drawn(anna: Any) -> None:
    """BD-4.2b: AB by two clicks, A+ by its heading and one."""
    box = anna.locator("#map").bounding_box()

    def click(x: float, y: float) -> None:
        anna.locator("#map").click(position={"x": x * box["width"], "y": y * box["height"]})

    anna.click("#ab:not([disabled])")
    wait_for(anna, "#hint", "0 of 2")
    click(0.3, 0.8)
    wait_for(anna, "#hint", "1 of 2")
    click(0.7, 0.8)  # to the east
    heading = float(re.search(r"heading ([\d.]+)", wait_for(anna, "#line", "heading"))[1])  # type: ignore[index]
    assert heading == pytest.approx(90.0, abs=0.5)
    planned(anna)
    assert {"1d4ed8", "6b1fa3"} <= set(anna.evaluate(COLORS))  # rows and line
    anna.fill("#a_plus_deg", "north")
    anna.click("#a_plus")
    wait_for(anna, "#answer", "Heading north: a number")
    anna.fill("#a_plus_deg", "37.25")
    anna.click("#a_plus")
    wait_for(anna, "#hint", "Click point A")
    click(0.5, 0.8)
    wait_for(anna, "#line", "heading 37.25")
    anna.wait_for_selector("#rows-plan [data-key=length]", state="detached")
    anna.click("#remove_line")
    wait_for(anna, "#line", "^$")
    anna.wait_for_selector("#remove_line", state="hidden")


def test_consent_for_plants_is_given_by_name_and_stored(anna: Any, folder: Path) -> None:
    """It is part of the mission that is stored, and is taken back."""
    (folder / "crop.geojson").write_bytes(geojson(name="field in crop"))
    load(anna, folder / "crop.geojson")
    wait_for(anna, "#hint", "^field in crop$")
    assert anna.text_content("#consent") == ""
    anna.select_option("#vegetation_cm", "30")
    assert re.search(r"anna consents .*30.cm", wait_for(anna, "#consent", "anna"))
    planned(anna)
    anna.fill("#mission-name", "in crop")
    anna.click("#store")
    stored(anna, "in crop").wait_for()
    missions = (folder / "state" / "missions").glob("2*")
    found = [yaml.safe_load((one / "mission.yaml").read_text(encoding="utf-8")).get("consent") for one in missions]
    assert {"by": "anna", "vegetation_m": 0.3} in found
    anna.select_option("#vegetation_cm", "")
    wait_for(anna, "#consent", "^$")
    stored(anna, "in crop").get_by_text("Open").click()
    wait_for(anna, "#consent", "anna consents")
    anna.select_option("#vegetation_cm", "")


def test_a_plan_goes_on_while_the_page_is_loaded_again_and_can_be_cancelled(anna: Any, folder: Path) -> None:
    load(anna, folder / "large.geojson")
    wait_for(anna, "#hint", "^large$")
    anna.click("#plan:not([disabled])")
    wait_for(anna, "#progress", "planner|passes|Rows|turns")
    anna.reload()
    wait_for(anna, "#progress", "planner|passes|Rows|turns|swept")
    assert anna.locator("#draw").is_disabled()
    anna.click("#cancel")
    wait_for(anna, "#progress", "^$")
    anna.wait_for_selector("#plan:not([disabled])")
    assert anna.locator("#rows-plan [data-key=length]").count() == 0
    assert anna.text_content("#answer") == ""


def test_others_see_the_plan_and_change_nothing(browser: Browser, process: PageProcess, anna: Any) -> None:
    for name, reason in (("bo", "anna has control"), ("cem", "viewing only")):
        page = browser.open()
        log_in(page, process, name, PASSWORD)
        view(page, "plan")
        wait_for(page, "#why", reason)
        wait_for(page, "#hint", "^large$")
        for control in ("draw", "plan", "store", "machine", "field-file"):
            assert page.locator(f"#{control}").is_disabled(), control
        for values in ('{action: "draw"}', '{action: "delete", value: "x"}', "{action: 5}", "[1]", "null"):
            page.evaluate(f"() => emitEvent('headland', {values})")  # past the controls
        answer = page.evaluate(
            """async () => { const form = new FormData(); form.append("field", new File(["x"], "a.kml"));
            return (await fetch("/plan/field", {method: "POST", body: form})).status; }"""
        )
        assert answer == 403
        page.wait_for_timeout(600.0)
        assert anna.text_content("#hint") == "large"
        page.context.close()


def test_a_mission_is_deleted_after_a_second_press(anna: Any, folder: Path) -> None:
    missions = folder / "state" / "missions"
    before = set(missions.glob("2*"))
    planned(anna)
    anna.fill("#mission-name", "to delete")
    anna.click("#store")
    stored(anna, "to delete").get_by_role("button", name="Delete").click()
    stored(anna, "to delete").get_by_text("Press again").wait_for()
    assert len(set(missions.glob("2*")) - before) == 1
    stored(anna, "to delete").get_by_text("Press again").click()
    stored(anna, "to delete").wait_for(state="detached")
    assert set(missions.glob("2*")) == before


def test_odd_events_have_no_effect(anna: Any) -> None:
    """Of the operator in control: unknown actions, ids with folders, values of other types."""
    odd = (
        '{action: "delete", value: "../../.."}', '{action: "open", value: "../x"}',
        '{action: "start", value: {}}', '{action: "corner", x: "a", y: null}', '{action: "corner", x: 1e300, y: 0}',
        '{action: "machine", value: "../x"}', '{action: "none"}', "7", "{}",
        '{action: "open"}',
    )  # fmt: skip
    before = anna.locator("#table-missions tbody tr").all_text_contents()
    for values in odd:
        for _ in range(2):  # a second press as well
            anna.evaluate(f"() => emitEvent('headland', {values})")
    wait_for(anna, "#answer", "is not stored")
    assert anna.locator("#table-missions tbody tr").all_text_contents() == before != []
    anna.reload()
    stored(anna, SHOUT).wait_for()


def test_a_simulated_drive_is_started_on_a_stored_mission(anna: Any) -> None:
    """The machine stands at the start of that field, and drives there when it is ordered to."""
    start = stored(anna, SHOUT).get_by_text("Start simulation")
    start.click()
    stored(anna, SHOUT).get_by_text("Press again").click()
    view(anna, "drive")
    wait_for(anna, "#rows-work [data-key=driven] dd", r"/ \d{3,}")
    wait_for(anna, "#mode", "Standby")
    for order in ("confirm_clear", "start"):
        anna.wait_for_selector(f"[data-hl=order-{order}]:not([disabled])")
        anna.click(f"[data-hl=order-{order}]")
        wait_for(anna, "[data-hl=answer]", "accepted")
    wait_for(anna, "#mode", "Automatic")
    wait_for(anna, "#rows-work [data-key=driven] dd", r"^(1[5-9]|[2-9]\d)\D")
    view(anna, "plan")
    stored(anna, SHOUT).get_by_text("Start simulation").click()
    stored(anna, SHOUT).get_by_text("Press again").click()
    wait_for(anna, "#answer", "in automatic operation")


def test_alarms_are_listed_with_remedy_and_acknowledged(anna: Any) -> None:
    """T14-5.5, BD-4.1f: cause, device, remedy, latched; the sound repeats until it is acknowledged."""
    view(anna, "diagnosis")
    anna.frame_locator("iframe.hl-stop").locator("#emergency-stop").click()
    row = anna.locator("#table-alarm_log tbody tr", has_text="mergency stop commanded")
    row.wait_for()
    text = row.text_content()
    for part in ("Supervisor", "Remove the danger", "latched"):
        assert part in text
    anna.wait_for_function("() => window.tones >= 4")  # repeated
    row.get_by_text("Acknowledge").click()
    row.get_by_text("anna").wait_for()


def test_the_sound_is_switched_off_in_this_browser(anna: Any) -> None:
    anna.click("#sound")
    wait_for(anna, "#sound", "Sound off")
    anna.reload()
    wait_for(anna, "#sound", "Sound off")
    assert anna.get_attribute("#sound", "aria-pressed") == "false"
    anna.click("#sound")
    wait_for(anna, "#sound", "Sound on")


def test_topics_have_rates_and_ages(anna: Any) -> None:
    row = anna.locator("#table-topics tbody tr", has_text="odom").first
    row.wait_for()
    anna.wait_for_timeout(3000.0)
    name, rate, expected, age, state = (cell.strip() for cell in row.locator("td").all_text_contents())
    assert name in ("lidar_odometry/front", "odom")
    assert float(rate.split("\u202f")[0]) > 0.0
    assert expected.endswith("Hz")
    assert float(age.split("\u202f")[0]) < 1.0
    assert state == "current"
    topics = anna.locator("#table-topics tbody tr").count()
    assert topics > 30


def test_log_and_report_files_of_runs_are_downloaded(anna: Any, process: PageProcess, browser: Browser) -> None:
    rows = anna.locator("#table-runs tbody tr")
    rows.first.wait_for()
    assert rows.count() == 2  # the first drive and that of the mission
    for row in (rows.first, rows.last):  # the running one, whose log grows, and the finished one
        with anna.expect_download() as download:
            row.get_by_text("log.mcap").click()
        assert Path(download.value.path()).read_bytes().startswith(b"\x89MCAP")
    href = rows.last.get_by_text("log.mcap").get_attribute("href")
    stranger = browser.open()
    assert stranger.request.get(process.url.rstrip("/") + href).status == 401
    stranger.context.close()


def test_work_is_counted_by_day_and_field(anna: Any, folder: Path) -> None:
    view(anna, "statistics")
    wait_for(anna, "#table-statistics", "corner field")
    cells = anna.locator("#table-statistics tbody tr", has_text="corner field").locator("td").all_text_contents()
    day, _, drives, _, _, distance, stops = cells
    assert (day, drives, stops) == (time.strftime("%Y-%m-%d"), "1", "1")
    assert float(distance.split("\u202f")[0]) > 0.0
    with anna.expect_download() as download:
        anna.click("#csv")
    assert "corner field" in Path(download.value.path()).read_text()


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", SIZES)
def test_targets_and_contrast(browser: Browser, process: PageProcess, size: str, language: str) -> None:
    page = browser.open(size, {"en": "en-US", "zh": "zh-CN"}[language])
    log_in(page, process, "cem", PASSWORD)
    for name, title in (("plan", "已保存"), ("diagnosis", "报警"), ("statistics", "统计")):
        view(page, name)
        page.wait_for_function("() => document.querySelector('tbody td')")
        assert (title in page.text_content("main")) == (language == "zh")
        assert small_targets(page) == low_contrasts(page) == []
        assert page.evaluate("() => document.documentElement.scrollWidth <= window.innerWidth")
    page.context.close()


def test_statistics_are_right_after_the_page_was_killed(
    anna: Any, process: PageProcess, folder: Path, browser: Browser
) -> None:
    """kill -9 of the page: the database has what was shown, and the missions are there at the next start."""
    before = anna.locator("#table-statistics tbody tr", has_text="corner field").locator("td").all_text_contents()
    process.process.send_signal(signal.SIGKILL)
    process.process.wait()
    assert browser.requested == {"127.0.0.1"}
    assert browser.errors == []
    with sqlite3.connect(folder / "state" / "statistics.db") as link:
        ((distance_m, stops),) = link.execute(
            "SELECT SUM(distance_m), SUM(stops) FROM drives WHERE field = 'corner field'"
        )
    assert distance_m * 1e-3 == pytest.approx(float(before[5].split("\u202f")[0]), abs=0.01)
    assert str(stops) == before[6]
    with page_process(folder, *MISSION) as again:
        page = browser.open()
        log_in(page, again, "anna", PASSWORD)
        view(page, "statistics")
        wait_for(page, "#table-statistics", "corner field")
        after = page.locator("#table-statistics tbody tr", has_text="corner field").locator("td").all_text_contents()
        assert after == before
        view(page, "plan")
        stored(page, SHOUT).wait_for()
        assert browser.requested == {"127.0.0.1"}
        page.context.close()
