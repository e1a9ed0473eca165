"""Orders from the page in Chromium to a simulated machine: the whole stack in one process, in simulated time."""

import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from benchmarks.page import descendants, is_running
from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import Browser, PageProcess, add_user, log_in, needs_browser, page_process, row, wait_for
from tests.hmi.planned import row_mission

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
SHOWN_SHIFT = """
shown => new RegExp(shown).test(document.querySelector("#rows-work [data-key=shift] dd")?.textContent || "")
"""


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    folder = tmp_path_factory.mktemp("page")
    for user in ("anna:operate", "bo:operate", "cem:view"):
        add_user(folder, user, PASSWORD)
    (folder / "row.yaml").write_text(row_mission(1.2), encoding="utf-8")
    mission = ("--mission", str(folder / "row.yaml"), "--scenario", "empty", "--stop-port", "0")
    with page_process(folder, *mission) as found:
        assert found.password == ""  # users are set up
        yield found


@pytest.fixture(scope="module")
def anna(browser: Browser, process: PageProcess) -> Any:
    page = browser.open()
    log_in(page, process, "anna", PASSWORD)
    return page


def press(page: Any, order: str) -> None:
    """Presses an order as soon as it is available."""
    page.wait_for_selector(f"[data-hl=order-{order}]:not([disabled])")
    page.click(f"[data-hl=order-{order}]")


def why(page: Any, order: str, pattern: str) -> str:
    """Shown reason for which an order cannot be given; its button is disabled."""
    text = wait_for(page, f"[data-hl=why-{order}]", pattern)
    assert page.locator(f"[data-hl=order-{order}]").is_disabled()
    return text


def stop_frame(page: Any) -> Any:
    return page.frame_locator("iframe.hl-stop")


def test_wrong_password(browser: Browser, process: PageProcess) -> None:
    page = browser.open()
    log_in(page, process, "anna", "wrong")
    wait_for(page, "[role=alert]", "wrong")
    page.goto(process.url)
    assert "/log-in" in page.url
    page.context.close()


def test_orders_need_control_and_say_why_they_are_not_available(anna: Any) -> None:
    """BD-4.1f: forbid, pause, start, manual, automatic are on the page; BD-5.8.1: nothing triggers by accident."""
    wait_for(anna, "#mode", "Standby")
    why(anna, "start", "Take control first")
    anna.click("[data-hl=seat-button]")
    wait_for(anna, "[data-hl=seat]", "You have control")
    why(anna, "pause", "not in automatic operation")
    why(anna, "nudge_left", "No row is driven")
    why(anna, "resume", "has not begun|Not ready")
    assert small_targets(anna) == low_contrasts(anna) == []


def test_the_mode_switch_changes_the_mode(anna: Any) -> None:
    """BD-5.8.1: manual and automatic; in manual mode nothing is started."""
    press(anna, "manual")
    wait_for(anna, "[data-hl=answer]", "Manual: accepted")
    wait_for(anna, "#mode", "Manual")
    why(anna, "start", "Select Automatic first")
    why(anna, "manual", "is in manual mode")
    press(anna, "automatic")
    wait_for(anna, "#mode", "Standby")
    why(anna, "automatic", "not in manual mode")


def test_start_needs_a_confirmation_then_drives(anna: Any) -> None:
    press(anna, "start")
    wait_for(anna, "[data-hl=answer]", "Start: accepted")
    wait_for(anna, "#cause", "Nobody has confirmed")
    assert "confirm that nobody is near" in anna.text_content("#next")
    press(anna, "confirm_clear")
    wait_for(anna, "[data-hl=answer]", "Nobody is near: accepted")
    if anna.text_content("#mode") == "Standby" and not anna.locator("[data-hl=order-start]").is_disabled():
        anna.click("[data-hl=order-start]")  # the first one has expired meanwhile
    wait_for(anna, "#mode", "Start warning|Automatic")
    wait_for(anna, "#mode", "Automatic")
    wait_for(anna, "#rows-motion [data-key=speed] dd", "^[1-9]")
    assert row(anna, "machine", "park_brake") == "released"
    why(anna, "start", "in automatic operation")


def test_a_second_operator_and_a_viewer_give_no_orders(browser: Browser, process: PageProcess, anna: Any) -> None:
    for name, reason in (("bo", "anna has control"), ("cem", "viewing only")):
        page = browser.open()
        log_in(page, process, name, PASSWORD)
        why(page, "pause", reason)
        button = page.locator("[data-hl=seat-button]")
        assert button.count() == 0 if name == "cem" else button.is_disabled()
        page.context.close()


def shift(page: Any, side: str, shown: str) -> None:
    """Shifts the row by a step until it is shown; a slow simulation takes fewer orders in a second of the clock."""
    for _ in range(8):
        press(page, f"nudge_{side}")
        with suppress(Exception):  # Playwright is loaded late, so its TimeoutError has no name here
            page.wait_for_function(SHOWN_SHIFT, arg=shown, timeout=8_000.0)
            page.wait_for_timeout(1_000.0)
            return
    raise AssertionError([shown, page.text_content("[data-hl=answer]"), row(page, "work", "shift")])


def test_a_driven_row_is_shifted_in_steps(anna: Any) -> None:
    """BD-4.1f: row-joining nudge; the machine refuses a shift above its limit."""
    for side, shown in (("left", "1.cm left"), ("left", "2.cm left"), ("right", "1.cm left"), ("right", "0.cm")):
        shift(anna, side, f"^{shown}")
    assert re.search("accepted", anna.text_content("[data-hl=answer]"))
    for number in range(1, 11):
        shift(anna, "right", f"^{number}.cm right")
    anna.wait_for_timeout(4_000.0)
    press(anna, "nudge_right")
    wait_for(anna, "[data-hl=answer]", "refused .largest shift")
    assert "10" in row(anna, "work", "shift")
    wait_for(anna, "#rows-motion [data-key=xte] dd", r"^[0-2]\.\d")
    assert anna.text_content("#mode") == "Automatic"


def test_pause_and_resume(anna: Any) -> None:
    press(anna, "pause")
    wait_for(anna, "#mode", "Standby")
    wait_for(anna, "#rows-motion [data-key=speed] dd", r"^-?0\.0")
    why(anna, "start", "has begun")
    press(anna, "resume")
    wait_for(anna, "#mode", "Automatic")


def test_forbid_pauses_and_prevents_a_start(anna: Any) -> None:
    """BD-4.1f: until operation is permitted, which moves nothing."""
    press(anna, "forbid")
    wait_for(anna, "#mode", "Standby")
    wait_for(anna, "#cause", "forbidden operation")
    why(anna, "resume", "Operation is forbidden")
    why(anna, "forbid", "already")
    press(anna, "permit")
    wait_for(anna, "[data-hl=why-permit]", "not forbidden")
    assert anna.text_content("#mode") == "Standby"
    press(anna, "resume")
    wait_for(anna, "#mode", "Automatic")


def test_without_the_page_of_the_operator_the_machine_stops(
    browser: Browser, process: PageProcess, anna: Any
) -> None:  # fmt: skip
    """BD-5.8.1: 10 s after it was left; others see why. It drives on by an order only."""
    witness = browser.open()
    log_in(witness, process, "cem", PASSWORD)
    wait_for(witness, "#mode", "Automatic")
    anna.goto("about:blank")
    wait_for(witness, "#mode", "Fault stop")
    wait_for(witness, "#cause", "page no longer answers")
    anna.goto(process.url)
    if "Nobody" in wait_for(anna, "[data-hl=seat]", "You have control|Nobody"):
        anna.click("[data-hl=seat-button]")
    press(anna, "reset")
    wait_for(anna, "[data-hl=order-reset]", "Press again")
    anna.click("[data-hl=order-reset]")
    wait_for(anna, "#mode", "Standby")
    for order in ("confirm_clear", "resume"):
        press(anna, order)
    wait_for(witness, "#mode", "Automatic")
    witness.context.close()


def test_emergency_stop_works_while_the_page_hangs(anna: Any, process: PageProcess) -> None:
    """BD-5.8.1: the form has a process of its own; the frozen page says that it is old."""
    process.process.send_signal(signal.SIGSTOP)
    try:
        anna.wait_for_selector("#lost:not([hidden])")
        stop_frame(anna).locator("#emergency-stop").click()
        stop_frame(anna).get_by_text("The machine has answered").wait_for()
    finally:
        process.process.send_signal(signal.SIGCONT)
    wait_for(anna, "#mode", "Emergency stop")
    assert "remove the danger" in anna.text_content("#next")
    wait_for(anna, "#rows-motion [data-key=speed] dd", r"^-?0\.0")


def test_emergency_stop_is_released_in_two_steps(anna: Any) -> None:
    why(anna, "resume", "Release the stop first")
    press(anna, "reset")
    wait_for(anna, "[data-hl=order-reset]", "Press again")
    assert anna.text_content("#mode") == "Emergency stop"
    anna.click("[data-hl=order-reset]")
    wait_for(anna, "#mode", "Standby")


def test_emergency_stop_without_log_in(browser: Browser, process: PageProcess, anna: Any) -> None:
    page = browser.open("phone", "zh-CN")
    page.goto(process.url)
    assert small_targets(page) == low_contrasts(page) == []
    stop_frame(page).locator("#emergency-stop").click()
    stop_frame(page).get_by_text("机器已应答").wait_for()
    wait_for(anna, "#mode", "Emergency stop")
    page.context.close()


def test_hand_over(browser: Browser, process: PageProcess, anna: Any) -> None:
    anna.click("[data-hl=seat-button]")
    wait_for(anna, "[data-hl=seat]", "Nobody")
    page = browser.open()
    log_in(page, process, "bo", PASSWORD)
    page.click("[data-hl=seat-button]")
    wait_for(page, "[data-hl=seat]", "You have control")
    why(anna, "reset", "bo has control")
    page.context.close()


def test_a_killed_page_leaves_no_process(process: PageProcess, anna: Any, browser: Browser) -> None:
    """The simulation ends with its page; the emergency stop when the machine no longer answers."""
    children = descendants(process.process.pid)
    assert len(children) >= 2
    process.process.kill()
    until_s = time.monotonic() + 60.0
    while time.monotonic() < until_s and any(is_running(child) for child in children):
        time.sleep(0.2)
    assert not [child for child in children if is_running(child)]
    anna.wait_for_selector("#lost:not([hidden])")
    assert browser.requested == {"127.0.0.1"}
    assert browser.errors == []
