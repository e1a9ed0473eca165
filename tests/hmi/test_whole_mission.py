"""A whole mission in Chromium: planned, driven, stopped by a person, cut off by kill -9, continued, counted."""

import os
import signal
import sqlite3
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import MultiPoint, union_all

from datasets.reader import LogScan, decode, is_ours
from hmi.plan_view.progress import PROGRESS
from hmi.scene import Scene, scene_of
from messages.truth import TrueMachine
from tests.hmi.accessibility import low_contrasts, small_targets
from tests.hmi.browser import Browser, PageProcess, add_user, log_in, needs_browser, page_process, view, wait_for
from tests.hmi.planned import corner_field, geojson

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
SIDE_M = 60.0  # one pass around it, 380 m with lane and yard
DRIVE_MS = 900_000.0
PERSON = """
name: a person crosses the headland pass
operator_commands: []
objects:
  - name: person
    object: adult
    place: {frame: path, path_m: 175.0, left_m: 10.0, heading_deg: -90.0}
    behaviour: {kind: cross, when: {path_m: 160.0}, speed_mps: 0.8, distance_m: 26.0}
    expected_stops: 1
"""


def seated(browser: Browser, process: PageProcess) -> Any:
    """The operator in control, on the drive view."""
    page = browser.open()
    log_in(page, process, "anna", PASSWORD)
    page.click("[data-hl=seat-button]")
    wait_for(page, "[data-hl=seat]", "You have control")
    return page


def order(page: Any, name: str) -> None:
    """Presses an order when it is available, and waits until it is accepted."""
    page.wait_for_selector(f"[data-hl=order-{name}]:not([disabled])")
    page.click(f"[data-hl=order-{name}]")
    wait_for(page, "[data-hl=answer]", "accepted")


def start_mission(page: Any, button: str, length: str) -> None:
    """Starts the only stored mission with a button that is pressed twice, and opens the drive view."""
    page.locator("#table-missions").get_by_role("button", name=button).click()
    page.locator("#table-missions").get_by_text("Press again").click()
    view(page, "drive")
    wait_for(page, "#rows-work [data-key=driven] dd", length)  # no longer that of the drive before
    wait_for(page, "#mode", "Standby")


def wait_in_drive(page: Any, selector: str, pattern: str) -> str:
    """Waits for a text, as long as a drive takes; confirms what the machine asks for on the way."""
    until_s = time.monotonic() + DRIVE_MS * 1e-3
    page.context.set_default_timeout(5_000.0)
    while True:
        try:
            found = wait_for(page, selector, pattern)
        except Exception:  # Playwright is loaded late, so its TimeoutError has no name here
            if time.monotonic() > until_s:
                shown = [page.text_content(one) for one in ("#mode", "#cause", "#rows-work")]
                raise AssertionError(f"not {pattern} in time: {shown}") from None
            if "out of view" in (page.text_content("#cause") or ""):
                order(page, "confirm_clear")
        else:
            page.context.set_default_timeout(60_000.0)
            return found


def kill_all(process: PageProcess) -> None:
    """kill -9 of the page and of all processes that it has started."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and (entry / "stat").exists():
            parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    found = [process.process.pid]
    for pid in found:
        found += [child for child, parent in parents.items() if parent == pid]
    assert len(found) >= 4  # page, drives, simulation, emergency stop
    for pid in found:
        os.kill(pid, signal.SIGKILL)
    process.process.wait()


def truth(run: Path) -> tuple[list[TrueMachine], Scene]:
    """True motion in the log of a run, also of one that was killed, and its scene."""
    log = LogScan(run / "log.mcap", frozenset({"truth_machine"}))
    found = [decode(entry).message for entry in log if is_ours(entry)]
    assert all(isinstance(one, TrueMachine) for one in found)
    return found, scene_of((run / "config.yaml").read_text(), str(run))  # type: ignore[return-value]


def worked_m2(drive: list[TrueMachine], scene: Scene) -> float:
    """Area of the field that the working line of the implement has swept."""
    half_m, swept, last = 0.5 * scene.implement.working_width_m, [], None
    for one in drive:
        center = one.p_implement_map_m[:2]
        left = half_m * np.array([-np.sin(one.implement_yaw_rad), np.cos(one.implement_yaw_rad)])
        line = np.stack([center - left, center + left])
        if not one.is_working or last is None:
            last = line if one.is_working else None
        elif np.abs(line - last).max() > 0.05:
            swept.append(MultiPoint(np.vstack([last, line])).convex_hull)
            last = line
    return float(union_all(swept).intersection(scene.field).area)


def way_m(drive: list[TrueMachine]) -> float:
    """Length of the true way of a drive."""
    return float(np.hypot(*np.diff([one.T_map_base[:2, 3] for one in drive], axis=0).T).sum())


def test_a_mission_is_driven_over_a_power_cut(browser: Browser, tmp_path: Path) -> None:
    """Log in, load an L-shaped field, choose the implement, plan, start; a person appears, the stop is explained and
    ends; pause, kill -9 of everything, start again, confirm, continue at the same place, finish; statistics right."""
    add_user(tmp_path, "anna:operate", PASSWORD)
    (tmp_path / "field.geojson").write_bytes(geojson(corner_field(SIDE_M)))
    (tmp_path / "person.yaml").write_text(PERSON)
    given = ("--mission", "yard", "--field", str(tmp_path / "field.geojson"), "--stop-port", "0")
    with page_process(tmp_path, *given, "--scenario", str(tmp_path / "person.yaml")) as process:
        page = seated(browser, process)
        view(page, "plan")
        page.wait_for_selector("#field-file:not([disabled])")
        page.set_input_files("#field-file", str(tmp_path / "field.geojson"))
        wait_for(page, "#hint", "^corner field$")
        page.select_option("#implement", "harrow_12m")
        page.click("#plan:not([disabled])")
        page.wait_for_selector("#rows-plan [data-key=length]", timeout=180_000.0)  # beside other tests
        page.fill("#mission-name", "corner")
        page.click("#store")
        page.locator("#table-missions tbody tr", has_text="corner").wait_for()
        start_mission(page, "Start simulation", r"/ 3[78]\d\D")
        for name in ("confirm_clear", "start"):
            order(page, name)
        wait_in_drive(page, "#mode", "Obstacle stop")
        assert "erson" in wait_for(page, "#cause", "erson")
        wait_for(page, "#next", "continues by itself|confirm that nobody")
        wait_in_drive(page, "#mode", "Automatic")
        page.wait_for_timeout(8_000.0)
        order(page, "pause")
        wait_for(page, "#mode", "Standby")
        page.wait_for_timeout(4_000.0)
        driven = wait_for(page, "#rows-work [data-key=driven] dd", ".")
        first = max((tmp_path / "runs").glob("*-page*"))
        assert list((tmp_path / "state" / "missions").glob(f"*/{PROGRESS}"))
        kill_all(process)
    with page_process(tmp_path, *given) as process:
        page = seated(browser, process)
        assert "corner" in wait_for(page, "#interrupted", r"Interrupted mission: corner, \d+")
        assert small_targets(page) == low_contrasts(page) == []
        page.click("#interrupted")
        page.wait_for_selector(".hl-view-plan")
        page.locator("#table-missions").get_by_role("button", name="Continue at").wait_for()
        assert small_targets(page) == low_contrasts(page) == []
        start_mission(page, "Continue at", r"/ [12]\d\d\D")
        order(page, "start")
        wait_for(page, "#cause", "Nobody has confirmed")
        order(page, "confirm_clear")
        wait_for(page, "#mode", "Automatic")
        wait_in_drive(page, "#mode", "Finished")
        page.wait_for_timeout(3_000.0)
        second = max((tmp_path / "runs").glob("*-page*"))
        view(page, "plan")
        wait_for(page, "#table-missions", "corner")
        page.wait_for_function("() => !document.querySelector('#table-missions').textContent.includes('Continue at')")
        assert browser.errors == []
    (before, scene), (after, scene_again) = truth(first), truth(second)
    stood, stands = before[-1].T_map_base[:2, 3], after[0].T_map_base[:2, 3]
    assert np.hypot(*(stood - stands)) < 0.1, (driven, stood, stands)
    areas = [worked_m2(before, scene), worked_m2(after, scene_again)]
    lengths = [way_m(drive) for drive in (before, after)]
    with sqlite3.connect(tmp_path / "state" / "statistics.db") as link:
        ((area_m2, distance_m, stops),) = link.execute(
            "SELECT SUM(area_m2), SUM(distance_m), SUM(stops) FROM drives WHERE field = 'corner field'"
        )
    assert area_m2 == pytest.approx(sum(areas), rel=0.01)
    assert distance_m == pytest.approx(sum(lengths), rel=0.01)
    assert stops == 1
    print(f"worked {area_m2:.0f} m², true {sum(areas):.0f} m²; driven {distance_m:.1f} m, true {sum(lengths):.1f} m")
