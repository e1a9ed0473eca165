"""Setup and calibration in Chromium: a drawn machine stands in the yard, a nominal one drives the trial."""

import math
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from runtime.assembly import plant_of
from runtime.setup import load_scenario, load_setup
from simulation.plant import Plant
from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import SIZES, Browser, PageProcess, add_user, log_in, needs_browser, page_process, view, wait_for
from tests.simulation.simulated_farm import CONFIG, Farm, machine_file

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
MISSION = ("--mission", "calibration", "--scenario", "empty", "--seed", "1", "--stop-port", "0")
RADIUS = "vehicle.drivetrain.wheel_radius_m"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("page")
    for user in ("anna:setup", "bo:operate"):
        add_user(found, user, PASSWORD)
    return found


@pytest.fixture(scope="module")
def process(folder: Path) -> Iterator[PageProcess]:
    with page_process(folder, *MISSION, "--plant", "drawn") as found:
        yield found


@pytest.fixture(scope="module")
def anna(browser: Browser, process: PageProcess) -> Any:
    return in_control(browser, process)


@pytest.fixture(scope="module")
def plant() -> Plant:
    setup = load_setup("calibration", None, None, None, 1)
    return plant_of(setup, load_scenario("empty", setup.mission, None, "drawn"))


def in_control(browser: Browser, process: PageProcess) -> Any:
    """The operator in control, on the setup view."""
    page = browser.open("desktop")
    log_in(page, process, "anna", PASSWORD)
    view(page, "setup")
    page.click("[data-hl=seat-button]")
    wait_for(page, "[data-hl=seat]", "You have control")
    return page


def edit(page: Any, key: str, text: str) -> None:
    """Enters a value."""
    field = page.locator(f"[data-key='{key}']:not([disabled])")
    field.fill(text)
    field.press("Enter")
    field.blur()


def value(page: Any, key: str, pattern: str) -> None:
    """Waits for the value of a setting."""
    script = "([key, pattern]) => new RegExp(pattern).test(document.querySelector(`[data-key='${key}']`)?.value)"
    page.wait_for_function(script, arg=[key, pattern])


def press_twice(page: Any, button: str) -> None:
    """Presses a button that has to be pressed again."""
    page.click(f"#{button}:not([disabled])")
    wait_for(page, f"#{button}", "Press again")
    page.click(f"#{button}")


def estimate(page: Any, name: str) -> tuple[float, float, float]:
    """Present value, found value and its error (95 %) of a row of the result."""
    row = page.locator("#table-estimates tbody tr", has_text=name)
    row.wait_for()
    present, found, error = (row.locator("td").nth(k).text_content() for k in (1, 2, 3))
    return float(present), float(found), float(error.removeprefix("± "))


def test_a_setting_is_shown_and_a_bad_value_refused_in_words(anna: Any) -> None:
    """T14-5.5, BD-4.1f: vehicle, implement, mounts, corrections and work mode."""
    value(anna, RADIUS, r"^0\.82$")
    edit(anna, RADIUS, "-1")
    wait_for(anna, "#answer", r"wheel_radius_m.*-1\.0.*greater than 0")
    value(anna, RADIUS, r"^0\.82$")
    edit(anna, RADIUS, "a lot")
    wait_for(anna, "#answer", r"wheel_radius_m 'a lot': must be a number")
    for section, key in (
        ("implement", "implement.working_width_m"),
        ("corrections", "corrections.max_correction_age_s"),
        ("work", "work.overlap_m"),
    ):
        anna.select_option("#section", section)
        anna.wait_for_selector(f"[data-key='{key}']")
    assert anna.locator("#table-mounts tbody tr").count() > 10
    anna.select_option("#section", "vehicle")


def test_a_change_is_a_version_with_author_and_time(anna: Any, folder: Path) -> None:
    edit(anna, RADIUS, "0,83")
    value(anna, RADIUS, r"^0\.83$")
    anna.fill("#note", "new tyres")
    anna.click("#store:not([disabled])")
    row = anna.locator("#table-versions tbody tr", has_text="new tyres")
    row.wait_for()
    assert row.locator("td").nth(0).text_content() == "2"
    assert row.locator("td").nth(2).text_content() == "anna"
    wait_for(anna, "#used", "version 1.*Version 2 takes effect")
    with sqlite3.connect(folder / "state" / "setup.db") as link:
        rows = link.execute("SELECT number, stored_s, author, note FROM versions ORDER BY number").fetchall()
    assert [(number, author, note) for number, _, author, note in rows][1] == (2, "anna", "new tyres")
    assert abs(rows[1][1] - time.time()) < 600.0


def test_an_operator_without_set_up_changes_nothing(browser: Browser, process: PageProcess, anna: Any) -> None:
    anna.click("[data-hl=seat-button]")
    page = browser.open("desktop")
    log_in(page, process, "bo", PASSWORD)
    view(page, "setup")
    page.click("[data-hl=seat-button]")
    wait_for(page, "#why", "role does not permit")
    assert page.locator(f"[data-key='{RADIUS}']").is_disabled()
    page.evaluate(f"() => window.emitEvent('headland', {{action: 'edit', key: '{RADIUS}', value: '0.5'}})")
    wait_for(page, "#answer", "role does not permit")
    page.evaluate("() => window.emitEvent('headland', {action: 'store', value: 'x'})")
    page.click("[data-hl=seat-button]")
    page.context.close()
    anna.click("[data-hl=seat-button]:not([disabled])")
    wait_for(anna, "[data-hl=seat]", "You have control")
    assert anna.locator("#table-versions tbody tr").count() == 2
    value(anna, RADIUS, r"^0\.83$")


def test_an_old_version_is_shown_and_restored(anna: Any) -> None:
    anna.locator("#table-versions tbody tr", has_text="configuration files").get_by_role("button").click()
    value(anna, RADIUS, r"^0\.82$")
    wait_for(anna, "#used", "Version 1 is shown")
    anna.click("#store:not([disabled])")
    wait_for(anna, "#table-versions tbody tr:first-child td", "^3$")
    value(anna, RADIUS, r"^0\.82$")


def test_targets_and_contrast(browser: Browser, process: PageProcess) -> None:
    for size in SIZES:
        page = browser.open(size, "zh-CN" if size == "phone" else "en-US")
        log_in(page, process, "bo", PASSWORD)
        for name in ("setup", "calibration"):
            view(page, name)
            wait_for(page, "#why", ".")
            assert small_targets(page) == low_contrasts(page) == []
            assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        page.context.close()


def test_the_mount_of_a_lidar_is_found_and_becomes_a_version(anna: Any, plant: Plant) -> None:
    """BD-4.2e: a wizard that ends with a verified value; the true mount is known to this test alone."""
    view(anna, "calibration")
    anna.select_option("#wizard", "lidar_mount.front")
    anna.click("#record:not([disabled])")
    anna.click("#evaluate:not([disabled])")
    wait_for(anna, "#verdict", "Not enough: . of 8 scans")
    wait_for(anna, "#recorded", r"Recording: (9|[1-9]\d)")
    anna.click("#evaluate")
    wait_for(anna, "#verdict", "Verified")
    assert anna.locator("#plot circle").count() > 100
    true = plant.vehicle.sensors.lidar["front"].mount
    for name, truth in (("Roll", true.rpy_deg[0]), ("Pitch", true.rpy_deg[1]), ("z up", true.xyz_m[2])):
        present, found, error = estimate(anna, f"Lidar front, {name}")
        assert abs(found - truth) < 1.5 * error < 0.3, name
        assert present in (0.0, 1.95)
    press_twice(anna, "accept")
    view(anna, "setup")
    wait_for(anna, "#table-versions tbody tr:first-child", "^4.*anna.*Lidar mount against the ground: front")


def test_a_version_is_applied_at_standstill(anna: Any, plant: Plant) -> None:
    """The next drive takes it, and finds nothing more to correct: the plant is as before."""
    press_twice(anna, "apply")
    wait_for(anna, "#used", "drives with version 4")
    view(anna, "calibration")
    anna.select_option("#wizard", "lidar_mount.front")
    anna.click("#record:not([disabled])")
    wait_for(anna, "#recorded", r"Recording: (9|[1-9]\d)")
    anna.click("#evaluate")
    wait_for(anna, "#verdict", "Verified")
    present, found, error = estimate(anna, "Lidar front, Pitch")
    assert abs(present - plant.vehicle.sensors.lidar["front"].mount.rpy_deg[1]) < 0.25
    assert abs(found - present) < error


def test_a_trial_drive_gives_zero_of_steering_and_radius(browser: Browser, folder: Path) -> None:
    """The nominal machine follows the line; its angle sensor has a zero error of the seed, its radius is set wrong."""
    own = folder / "trial"
    own.mkdir()
    add_user(own, "anna:setup", PASSWORD)
    with page_process(own, *MISSION) as process:
        anna = in_control(browser, process)
        edit(anna, RADIUS, "0.80")
        anna.click("#store:not([disabled])")
        wait_for(anna, "#used", "Version 2 takes effect")
        view(anna, "calibration")
        press_twice(anna, "trial")
        view(anna, "setup")
        wait_for(anna, "#used", "drives with version 2")
        view(anna, "calibration")
        anna.click("#record:not([disabled])")
        wait_for(anna, "#recorded", r"Recording: [6-9]|\d\d")
        start(anna)
        assert_not_applied_while_driving(anna)
        view(anna, "drive")
        anna.set_default_timeout(400_000.0)
        wait_for(anna, "#mode", "Finished")
        view(anna, "calibration")
        finished_m = metres(wait_for(anna, "#recorded", r"(1[89]|20)\d.m"))
        for name in ("imu_level", "hitch_time", "antenna_side", "pto_time"):
            evaluated(anna, name)
        evaluated(anna, "steering_zero")
        _, found, error = estimate(anna, "Steering zero")
        assert abs(found - true_zero_deg()) < 1.5 * error < 0.2
        evaluated(anna, "wheel_radius")
        present, found, error = estimate(anna, "Rolling radius")
        assert present == 0.8
        assert abs(found - 0.82 / 1.006) < 1.5 * error < 0.02  # slip of rolling: 0.6 %
        assert abs(finished_m - 191.0) < 10.0
        press_twice(anna, "accept")
        view(anna, "setup")
        wait_for(anna, "#table-versions tbody tr:first-child", "^4.*anna.*Wheel radius")
        press_twice(anna, "apply")
        wait_for(anna, "#used", "drives with version 4")
    assert browser.requested == {"127.0.0.1"}
    assert browser.errors == []


def start(page: Any) -> None:
    """Starts the drive."""
    view(page, "drive")
    for order, answer in (("start", "Start: accepted"), ("confirm_clear", "Nobody is near: accepted")):
        page.click(f"[data-hl=order-{order}]:not([disabled])")
        wait_for(page, "[data-hl=answer]", answer)
    if page.text_content("#mode") == "Standby" and not page.locator("[data-hl=order-start]").is_disabled():
        page.click("[data-hl=order-start]")  # the first one has expired meanwhile
    wait_for(page, "#mode", "Automatic")


def assert_not_applied_while_driving(page: Any) -> None:
    """A version that is stored now waits."""
    view(page, "setup")
    edit(page, "vehicle.body.mass_kg", "5700")
    page.click("#store:not([disabled])")
    wait_for(page, "#used", "version 2.*Version 3 takes effect")
    press_twice(page, "apply")
    wait_for(page, "#answer", "automatic operation")
    wait_for(page, "#used", "drives with version 2")


def evaluated(page: Any, name: str) -> None:
    """Evaluates a calibration until enough is recorded."""
    page.select_option("#wizard", name)
    until_s = time.monotonic() + 60.0
    verdict = ""
    while "Verified" not in verdict and time.monotonic() < until_s:
        page.click("#evaluate:not([disabled])")
        verdict = wait_for(page, "#verdict", ".")
        time.sleep(1.0)
    assert "Verified" in verdict, (name, verdict)


def metres(text: str) -> float:
    """Distance of the line that says what is recorded."""
    return float(text.rpartition(", ")[2].rstrip("m\u202f"))


def true_zero_deg() -> float:
    """True zero error of the angle sensor of seed 1."""
    farm = Farm(machine_file("tractor_e", ("wheels",)), CONFIG)
    found = math.degrees(farm.machine.angle_offset_rad)
    farm.close()
    return found
