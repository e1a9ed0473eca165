"""A field recorded in Chromium while the machine drives along its edge, and planned."""

import math
from pathlib import Path

import pytest

from tests.hmi.browser import Browser, add_user, log_in, needs_browser, page_process, row, view, wait_for

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
RADIUS_M, LONG_M, SHORT_M, HALF_M = 8.0, 30.0, 14.0, 3.0
BEND = f"{{section: turn, length_m: {0.5 * math.pi * RADIUS_M:.3f}, curvature_radpm: {1.0 / RADIUS_M}}}"
ROUND = f"""
name: round
site: demo
machine: tractor_e
implement: harrow_6m
start: {{x_m: 22.0, y_m: 10.0, heading_deg: 0.0}}
line:
  speed_kmh: 8
  legs:
    [{{length_m: {LONG_M}}}, {BEND}, {{length_m: {SHORT_M}}}, {BEND}, {{length_m: {LONG_M}}}, {BEND}, {{length_m: 8.0}}]
"""


def test_a_field_is_recorded_by_driving_along_its_edge(browser: Browser, tmp_path: Path) -> None:
    """Its right end at the edge, the implement drives on three sides; the outline is the line that it has drawn."""
    add_user(tmp_path, "anna:operate", PASSWORD)
    (tmp_path / "round.yaml").write_text(ROUND, encoding="utf-8")
    mission = ("--mission", str(tmp_path / "round.yaml"), "--scenario", "empty", "--stop-port", "0")
    with page_process(tmp_path, *mission) as process:
        page = browser.open()
        log_in(page, process, "anna", PASSWORD)
        page.click("[data-hl=seat-button]")
        for order in ("confirm_clear", "start"):
            page.click(f"[data-hl=order-{order}]:not([disabled])")
        wait_for(page, "#mode", "Automatic")
        view(page, "plan")
        page.select_option("#side", "right")
        page.click("#drive:not([disabled])")
        wait_for(page, "#hint", "Drive along the edge .*[1-9]")
        page.set_default_timeout(600_000.0)
        view(page, "drive")
        wait_for(page, "#mode", "Finished")
        view(page, "plan")
        wait_for(page, "#hint", "Drive along the edge")
        page.click("#close:not([disabled])")
        wait_for(page, "#hint", "^Drawn field$")
        page.click("#plan:not([disabled])")
        area_ha = float(row(page, "plan", "area").split("\u202f")[0])
    assert browser.errors == []
    assert area_ha == pytest.approx(1e-4 * enclosed_m2(), abs=0.008)


def enclosed_m2() -> float:
    """Area within the line of the right end, closed by a straight line from its end to its begin."""
    points, x, y, yaw = [], 22.0, 10.0, 0.0
    for length_m, bend in ((LONG_M, 0.0), (0, 1), (SHORT_M, 0.0), (0, 1), (LONG_M, 0.0), (0, 1), (8.0, 0.0)):
        count = round((length_m or 0.5 * math.pi * RADIUS_M) / 0.1)
        for _ in range(count):
            yaw += 0.5 * math.pi / count if bend else 0.0
            x, y = x + 0.1 * math.cos(yaw), y + 0.1 * math.sin(yaw)
            points.append((x + HALF_M * math.sin(yaw), y - HALF_M * math.cos(yaw)))
    pairs = zip(points, [*points[1:], points[0]], strict=True)
    return 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs))
