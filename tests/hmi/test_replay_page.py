"""The page in Chromium, with a log of a simulated drive that stops for a person."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import SIZES, Browser, PageProcess, log_in, needs_browser, page_process, row, wait_for

pytestmark = [needs_browser, pytest.mark.slow]
STOP_S = (20.0, 27.0)  # the machine stops for the person within these seconds of the log


@pytest.fixture(scope="module")
def process(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    with page_process(tmp_path_factory.mktemp("page"), "--replay", str(log)) as found:
        yield found


@pytest.fixture
def page(browser: Browser, process: PageProcess) -> Iterator[Any]:
    found = browser.open()
    log_in(found, process)
    found.wait_for_selector("#rows-motion dd")
    set_paused(found, False)
    found.click("[data-hl=replay-rate-1]")
    yield found
    found.context.close()


def set_paused(page: Any, is_paused: bool) -> None:
    """Pauses or continues; the position is one for all pages of a process."""
    text = "Continue" if is_paused else "Pause"
    if text not in wait_for(page, "[data-hl=replay-pause]", "Continue|Pause"):
        page.click("[data-hl=replay-pause]")
    wait_for(page, "[data-hl=replay-pause]", text)


def seek(page: Any, share: float) -> None:
    """Clicks on the slider of the position at a share of its length."""
    box = page.locator("[data-hl=replay-position]").bounding_box()
    page.mouse.click(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])


def seconds(page: Any) -> float:
    """Position in the log."""
    return clock_seconds(page, 0)


def clock_seconds(page: Any, which: int) -> float:
    """Position (0) or length (1) of the log."""
    minutes, rest = wait_for(page, "#replay-time", " / ").split(" / ")[which].split(":")
    return 60.0 * float(minutes) + float(rest)


def seek_to(page: Any, position_s: float) -> None:
    """Clicks at a time of the log; waits until it is shown, within the width of the slider's knob."""
    seek(page, position_s / clock_seconds(page, 1))
    until_s = time.monotonic() + 60.0
    while not abs(seconds(page) - position_s) <= 1.5 and time.monotonic() < until_s:
        page.wait_for_timeout(100.0)
    assert seconds(page) == pytest.approx(position_s, abs=1.5)


def test_values_of_the_drive_are_shown(page: Any) -> None:
    """BD-4.2f and BD-4.1f: state, speed, heading, errors, steering, satellites, corrections, area, row."""
    set_paused(page, True)
    seek_to(page, 15.5)
    wait_for(page, "#rows-motion [data-key=speed] dd", "^([5-9]|1[0-9])\\.")
    for key in ("heading", "xte", "heading_error", "steering"):
        assert any(sign.isdigit() for sign in row(page, "motion", key)), key
    assert "RTK fixed" in row(page, "position", "solution")
    assert int(row(page, "position", "satellites").split(" ")[0]) > 5
    assert row(page, "position", "correction_age").endswith("s")
    assert row(page, "position", "protection_level").endswith("cm")
    assert row(page, "work", "row")
    assert "good, up to" in row(page, "sensors", "lidar_front")
    assert row(page, "machine", "hitch") == "0\u202f% · in work"
    assert page.text_content("#mode") == "Automatic"


def test_jump_to_the_stop_explains_it(page: Any) -> None:
    set_paused(page, True)
    seek(page, 0.0)
    wait_for(page, "#replay-time", "0:00 /")
    page.click("[data-hl=replay-next]")
    wait_for(page, "#mode", "Automatic")
    assert STOP_S[0] - 2.0 <= seconds(page) <= STOP_S[1]
    set_paused(page, False)
    wait_for(page, "#mode", "Obstacle stop")
    assert "ahead" in wait_for(page, "#cause", "[Oo]bstacle|[Pp]erson")
    assert "continues by itself" in page.text_content("#next")
    page.click("[data-hl=replay-next]")
    wait_for(page, "[data-hl=replay-next]", "No further stop")


def test_pause_rate_and_seek(page: Any) -> None:
    set_paused(page, True)
    seek(page, 0.0)
    wait_for(page, "#replay-time", "0:00 /")
    page.click("[data-hl=replay-rate-5]")
    set_paused(page, False)
    began_s = time.monotonic()
    wait_for(page, "#replay-time", "0:1[0-9] /")
    elapsed_s = time.monotonic() - began_s
    assert 1.0 < elapsed_s < 8.0  # 2.0 s at five times real time
    set_paused(page, True)
    paused_s = seconds(page)
    page.wait_for_timeout(1200.0)
    assert seconds(page) == paused_s
    seek_to(page, 13.0)


def test_worked_area_after_a_seek_is_that_of_the_log(page: Any) -> None:
    """A seek back and forth gives the same area as before."""
    set_paused(page, True)
    found = []
    for share in (0.95, 0.1, 0.95):
        seek(page, share)
        page.wait_for_timeout(2000.0)
        found.append(page.text_content("#rows-work [data-key=area] dd"))
    assert found[0] == found[2] != found[1]


def test_map_draws_machine_and_follows_it(page: Any) -> None:
    """The canvas has the colours of field, machine and path; zoom and whole field change it."""
    script = """() => {
      const c = document.getElementById('map'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      const seen = new Set();
      for (let k = 0; k < d.length; k += 4) seen.add((d[k] << 16 | d[k + 1] << 8 | d[k + 2]).toString(16));
      return [...seen]; }"""
    set_paused(page, True)
    seek(page, 0.6)
    wait_for(page, "#mode", "Automatic")
    colors = set(page.evaluate(script))
    assert {"2f6f3e", "c9a227", "b9d8a8", "fffef8"} <= colors
    near = page.evaluate("() => document.getElementById('map').toDataURL()")
    page.click("#map-all")
    assert page.evaluate("() => document.getElementById('map').toDataURL()") != near
    assert {"14532d"} <= set(page.evaluate(script))


def test_a_log_takes_no_orders_and_has_no_emergency_stop(page: Any) -> None:
    assert page.text_content("[data-hl=barred]") == "A log is shown, not a machine"
    assert page.locator("[data-hl=order-start]").count() == 0
    assert page.locator("iframe").count() == 0


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", SIZES)
def test_targets_and_contrast(browser: Browser, process: PageProcess, size: str, language: str) -> None:
    page = browser.open(size, {"en": "en-US", "zh": "zh-CN"}[language])
    page.goto(process.url)
    assert small_targets(page) == low_contrasts(page) == []
    log_in(page, process)
    page.wait_for_selector("#rows-motion dd")
    assert page.get_attribute("html", "lang") == language
    assert ("速度" in page.text_content("#rows-motion")) == (language == "zh")
    assert small_targets(page) == low_contrasts(page) == []
    assert page.evaluate("() => document.documentElement.scrollWidth <= window.innerWidth")
    page.context.close()


def test_a_small_target_and_a_low_contrast_are_found(page: Any) -> None:
    page.evaluate(
        """() => { const e = document.createElement('button'); e.textContent = 'x';
        e.style.cssText = 'width: 20px; color: #aaa; background: #fff'; document.body.prepend(e); }"""
    )
    assert len(small_targets(page)) == len(low_contrasts(page)) == 1


def test_nothing_but_loopback_is_asked_for(page: Any, browser: Browser) -> None:
    """All tests of this file together; the browser resolves no other name (see `OFFLINE`)."""
    assert browser.requested == {"127.0.0.1"}
    assert browser.errors == []


def test_language_changes_in_place(page: Any) -> None:
    page.click("#language")
    wait_for(page, "#rows-motion dt", "速度")
    page.click("#language")
    wait_for(page, "#rows-motion dt", "Speed")


def pane(page: Any, name: str) -> None:
    """Chooses what is shown in the place of the map."""
    page.click(f"[data-pane='{name}']")
    page.wait_for_selector(f"[data-pane='{name}'][aria-pressed=true]")


def colors_of(page: Any, selector: str) -> int:
    """Number of different colours in the picture of an element."""
    picture = cv2.imdecode(np.frombuffer(page.locator(selector).screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def test_points_machine_and_person_are_shown_in_3d(page: Any, browser: Browser) -> None:
    """At the stop: thousands of points, the person with its name; turned by the pointer; the map comes back."""
    set_paused(page, True)
    seek_to(page, 24.0)
    pane(page, "space")
    page.wait_for_function("() => Number(document.getElementById('space').dataset.points) > 3000")
    assert wait_for(page, "#space .hl-label", "^Person")
    assert page.locator("#map").is_hidden()
    assert colors_of(page, "#space") > 20
    before = page.locator("#space .hl-label").first.bounding_box()
    box = page.locator("#space").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"], steps=5)
    page.mouse.up()
    page.wait_for_timeout(500.0)
    assert page.locator("#space .hl-label").first.bounding_box() != before
    pane(page, "map")
    assert page.locator("#map").is_visible()
    assert page.locator("#space").is_hidden()
    assert browser.errors == []


def test_the_camera_image_has_boxes_of_the_obstacles(page: Any, browser: Browser) -> None:
    set_paused(page, True)
    seek_to(page, 24.0)
    pane(page, "camera/front")
    page.wait_for_function("() => Number(document.getElementById('camera').dataset.boxes) > 0")
    page.wait_for_selector("#camera-note", state="hidden")
    assert colors_of(page, "#camera-image") > 1000
    assert browser.errors == []


@pytest.mark.parametrize("size", SIZES)
def test_panes_have_targets_and_contrast(browser: Browser, process: PageProcess, size: str) -> None:
    page = browser.open(size, "zh-CN")
    log_in(page, process)
    for name in ("space", "camera/front"):
        pane(page, name)
        assert small_targets(page) == []
        assert low_contrasts(page) == []
        assert page.evaluate("() => document.documentElement.scrollWidth <= window.innerWidth")
    page.context.close()
