"""Pictures of each view of the operator's page, in both languages and three sizes (docs/hmi.md).

    ./headland benchmark screenshots [--out docs/hmi] [--quality 55]

One simulated drive (seed 1) in headless Chromium: a lidar is calibrated at standstill, a field is planned along an AB
line, a row is driven, and an emergency stop ends it. The machine's day and times of the clock are in the pictures.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hmi.view import VIEWS
from tests.hmi.browser import SIZES, Browser, PageProcess, add_user, chromium, log_in, page_process, view, wait_for
from tests.hmi.planned import geojson, row_mission

PASSWORD = "correct horse"
LANGUAGES = {"en": "en-US", "zh": "zh-CN"}
DRIVEN = r"^1\d\D"  # m, when the pictures of the drive are taken
SETTLED_MS, PATIENCE_MS = 1500.0, 300_000.0


class Pictures:
    """Pages of all sizes and languages with one session, which has control."""

    def __init__(self, browser: Browser, process: PageProcess, out: Path, quality: int) -> None:
        self._url, self._out, self._quality = process.url, out, quality
        self.operator = browser.open("tablet")
        self.operator.set_default_timeout(PATIENCE_MS)
        log_in(self.operator, process, "anna", PASSWORD)
        self.operator.click("[data-hl=seat-button]")
        wait_for(self.operator, "[data-hl=seat]", "You have control")
        cookies = self.operator.context.cookies()
        self._pages: dict[str, Any] = {}
        for size in SIZES:
            for language, locale in LANGUAGES.items():
                page = browser.open(size, locale)
                page.set_default_timeout(PATIENCE_MS)
                page.goto(f"{process.url}log-in?lang={language}")
                self._take(page, f"log-in-{size}-{language}")
                page.context.add_cookies(cookies)
                self._pages[f"{size}-{language}"] = page

    def take(self, name: str, shown: str, of_view: str = "", pane: str = "") -> None:
        """Opens a view, by default that of the picture, on one page after the other, chooses a pane in the place of the
        map, waits for an element, and takes its picture."""
        for key, page in self._pages.items():
            page.goto(f"{self._url.rstrip('/')}{VIEWS[of_view or name]}?lang={key[-2:]}")
            if pane:
                page.click(f"[data-pane='{pane}']")
            page.wait_for_selector(shown)
            page.wait_for_timeout(SETTLED_MS)
            self._take(page, f"{name}-{key}")
            page.goto("about:blank")

    def _take(self, page: Any, name: str) -> None:
        image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        if image is None or not cv2.imwrite(
            str(self._out / f"{name}.webp"), image, [cv2.IMWRITE_WEBP_QUALITY, self._quality]
        ):
            raise OSError(f"{self._out / name}.webp: cannot be written")


def main() -> int:
    """Takes all pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/hmi"))
    parser.add_argument("--quality", type=int, default=55, help="of WebP, 1 to 100")
    arguments = parser.parse_args()
    if not subprocess.run(["fc-list", ":lang=zh"], capture_output=True, check=True).stdout:
        sys.exit("screenshots: no font for Chinese; Debian has fonts-noto-cjk")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "row.yaml").write_text(row_mission(2), encoding="utf-8")
        (folder / "field.geojson").write_bytes(geojson())
        add_user(folder, "anna:setup", PASSWORD)
        words = ("--mission", str(folder / "row.yaml"), "--scenario", "empty", "--stop-port", "0")
        with page_process(folder, *words) as process, chromium() as browser:
            pictures = Pictures(browser, process, arguments.out, arguments.quality)
            calibrate(pictures)
            plan(pictures, folder / "field.geojson")
            drive(pictures)
    total = sum(path.stat().st_size for path in arguments.out.glob("*.webp"))
    print(f"{len(list(arguments.out.glob('*.webp')))} pictures, {total * 1e-6:.2f} MB")
    return 0


def calibrate(pictures: Pictures) -> None:
    """Views `calibration` and `setup`: the mount of a lidar is found at standstill and stored."""
    page = pictures.operator
    view(page, "calibration")
    page.select_option("#wizard", "lidar_mount.front")
    page.click("#record:not([disabled])")
    wait_for(page, "#recorded", r"Recording: [1-9]\d")
    page.click("#evaluate")
    wait_for(page, "#verdict", "Verified")
    pictures.take("calibration", "#plot circle")
    for _ in range(2):
        page.click("#accept:not([disabled])")
    view(page, "setup")
    wait_for(page, "#table-versions tbody tr:first-child", "^2")
    pictures.take("setup", "#table-versions tbody td")


def plan(pictures: Pictures, field: Path) -> None:
    """View `plan`: a field is planned along an AB line and stored."""
    page = pictures.operator
    view(page, "plan")
    page.wait_for_selector("#field-file:not([disabled])")
    page.set_input_files("#field-file", str(field))
    wait_for(page, "#hint", "^corner field$")
    page.select_option("#headland_passes", "2")
    page.click("#ab:not([disabled])")
    wait_for(page, "#hint", "0 of 2")
    box = page.locator("#map").bounding_box()
    for k, x in enumerate((0.35, 0.65)):
        page.locator("#map").click(position={"x": x * box["width"], "y": 0.7 * box["height"]})
        wait_for(page, "#hint", f"{k + 1} of 2|^corner field$")
    page.click("#plan:not([disabled])")
    page.wait_for_selector("#rows-plan [data-key=length]")
    page.click("#store:not([disabled])")
    page.wait_for_selector("#table-missions tbody td")
    pictures.take("plan", "#table-missions tbody td")


def drive(pictures: Pictures) -> None:
    """Views `drive`, `diagnosis` and `statistics`: a row is driven until an emergency stop."""
    page = pictures.operator
    view(page, "drive")
    for order in ("confirm_clear", "start"):
        page.click(f"[data-hl=order-{order}]:not([disabled])")
        wait_for(page, "[data-hl=answer]", "accepted")
    wait_for(page, "#rows-work [data-key=driven] dd", DRIVEN)
    pictures.take("drive", "#rows-machine [data-key=hitch]")
    pictures.take("3d", "#space[data-points]", "drive", "space")
    pictures.take("camera", "#camera[data-boxes]", "drive", "camera/front")
    page.frame_locator("iframe.hl-stop").locator("#emergency-stop").click()
    wait_for(page, "#mode", "Emergency stop")
    for name, table in (("diagnosis", "alarm_log"), ("statistics", "statistics")):
        pictures.take(name, f"#table-{table} tbody td")


if __name__ == "__main__":
    raise SystemExit(main())
