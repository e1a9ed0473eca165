"""Service in Chromium: self-test of the controls, frames of the bus, and a failure of the corrections, on a machine."""

import re
from collections.abc import Iterator
from typing import Any

import pytest

from hmi.diagnosis.self_test import TESTED
from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import Browser, PageProcess, add_user, log_in, needs_browser, page_process, row, view, wait_for

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
LOSES_CORRECTIONS = """
name: loses corrections
operator_commands: []
gnss: [{from_s: 60.0, for_s: 600.0, state: single}]
"""
COUNT_TONES = """
window.tones = 0;
const begin = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (at) { window.tones += 1; return begin.call(this, at); };
"""


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    folder = tmp_path_factory.mktemp("page")
    for user in ("anna:operate", "kim:service"):
        add_user(folder, user, PASSWORD)
    (folder / "scenario.yaml").write_text(LOSES_CORRECTIONS, encoding="utf-8")
    scenario = ("--scenario", str(folder / "scenario.yaml"))
    with page_process(folder, "--mission", "line", *scenario, "--stop-port", "0") as found:
        yield found


@pytest.fixture(scope="module")
def kim(browser: Browser, process: PageProcess) -> Any:
    page = browser.open()
    page.add_init_script(COUNT_TONES)
    log_in(page, process, "kim", PASSWORD)
    page.wait_for_selector("#rows-position dd")
    return page


def test_corrections_are_received(kim: Any) -> None:
    """BD-4.2f: state of the link."""
    assert "receiving" in row(kim, "position", "link")


def test_self_test_of_each_control_moves_nothing(kim: Any) -> None:
    """BD-5.8.1: every control with its result; the emergency stop by its own process."""
    view(kim, "diagnosis")
    assert kim.locator("#self_test").is_disabled() or "Nobody" in kim.text_content("[data-hl=seat]")
    kim.click("[data-hl=seat-button]")
    kim.click("#self_test:not([disabled])")
    for number in range(1, len(TESTED) + 1):
        line = f"#table-self_test tbody tr:nth-child({number}) td:nth-child(2)"
        assert "works" in wait_for(kim, line, "works|refused|answer")
    stop = kim.frame_locator("iframe.hl-stop").locator("[role=status]")
    stop.get_by_text(re.compile("the machine answers")).wait_for()
    wait_for(kim, "#table-audit tbody tr:first-child td:nth-child(2)", "^0$")  # no order has had an effect
    view(kim, "drive")
    wait_for(kim, "#mode", "Standby")
    assert kim.locator("[data-hl=order-forbid]").is_enabled()  # operation was not forbidden


def test_frames_of_the_bus_are_decoded_for_service(browser: Browser, process: PageProcess, kim: Any) -> None:
    view(kim, "diagnosis")
    sent = kim.locator("#table-bus tbody tr", has_text="GuidanceSystemCommand").first
    sent.wait_for()
    assert re.search(r"to the machine.*Curvature -?[\d.]+ 1/km", sent.text_content())
    came = kim.locator("#table-bus tbody tr", has_text="WheelBasedSpeed").first
    assert re.search(r"from the machine.*Speed 0 m/s", came.text_content())
    assert small_targets(kim) == low_contrasts(kim) == []
    anna = browser.open()
    log_in(anna, process, "anna", PASSWORD)
    view(anna, "diagnosis")
    anna.wait_for_selector("#table-topics tbody tr")
    assert anna.locator("#table-bus").count() == 0
    anna.context.close()


def test_service_changes_the_setup(kim: Any) -> None:
    view(kim, "setup")
    wait_for(kim, "#used", "Version 1|drives with version 1")
    assert "role does not permit" not in (kim.text_content("#why") or "")
    kim.wait_for_selector("input[data-change=edit]:not([disabled])")


def test_failing_corrections_sound_and_flash_until_acknowledged(kim: Any) -> None:
    """BD-5.8.2b: on every view; the machine itself decides how far it drives without them."""
    view(kim, "drive")
    kim.click("#state")  # a browser plays nothing before the first click
    kim.set_default_timeout(240_000.0)
    wait_for(kim, "#light:not([hidden])", "corrections have failed")
    assert re.search("too old|none", row(kim, "position", "link"))
    animation = "() => getComputedStyle(document.querySelector('#light')).animationName"
    assert kim.evaluate(animation) == "hl-flash"
    assert low_contrasts(kim) == []
    kim.wait_for_function("() => window.tones >= 2")
    view(kim, "diagnosis")
    wait_for(kim, "#light:not([hidden])", "corrections have failed")
    alarm = kim.locator("#table-alarm_log tbody tr", has_text="corrections have failed")
    assert "radio or network" in alarm.text_content()
    alarm.locator("button").click()
    kim.wait_for_selector("#light[hidden]", state="attached")
    assert "kim" in alarm.text_content()
    tones = kim.evaluate("() => window.tones")
    kim.wait_for_timeout(4000.0)
    assert kim.evaluate("() => window.tones") == tones
