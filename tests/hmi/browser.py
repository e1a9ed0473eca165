"""Chromium for tests of the page; a test is skipped, and counted, where Playwright or Chromium is missing."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.recordings import ROOT

PACKAGES = ROOT / ".browser"
CHROMIUM = shutil.which("chromium")
REASON = "needs a browser: make browser"
OFFLINE = ("--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
SIZES = {"phone": (390, 844), "tablet": (1280, 800), "desktop": (1920, 1080)}
LAST_LINE = "Ctrl+C"
PATIENCE_MS = 60_000.0

needs_browser = pytest.mark.skipif(CHROMIUM is None or not (PACKAGES / "playwright").is_dir(), reason=REASON)


class PageProcess:
    """A `headland page` with its addresses and the password of this start."""

    def __init__(self, process: "subprocess.Popen[str]", text: str) -> None:
        self.process = process
        self.url = _found(r"^page: (\S+)$", text)
        self.password = _found(r"password (\S+)", text, "")
        self.stop_url = _found(r"^emergency stop: (\S+)$", text, "")
        self.foxglove_url = _found(r"^foxglove: (\S+)$", text, "")


@contextmanager
def page_process(folder: Path, *arguments: str) -> Iterator[PageProcess]:
    """Starts `headland page` in a folder, with users and key of its own; ends it with SIGTERM."""
    command = [sys.executable, "-m", "runtime", "page", "--port", "0", "--state", str(folder / "state"), *arguments]
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    with (folder / "errors").open("w") as errors:
        process = subprocess.Popen(command, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        yield PageProcess(process, _first_lines(process, folder / "errors"))
    finally:
        process.terminate()
        try:
            process.wait(60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def add_user(folder: Path, user: str, password: str) -> None:
    """Adds a user (`NAME:ROLE`) to the state in a folder."""
    command = [sys.executable, "-m", "runtime", "page", "--state", str(folder / "state"), "--add-user", user]
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    subprocess.run(command, input=f"{password}\n", text=True, env=env, cwd=folder, check=True)


def _first_lines(process: "subprocess.Popen[str]", errors: Path) -> str:
    """What the page says at its start."""
    assert process.stdout is not None
    text = ""
    for line in process.stdout:
        text += line
        if line.startswith(LAST_LINE):
            return text
    raise AssertionError(f"the page did not start: {text}{errors.read_text()}")


def _found(pattern: str, text: str, default: str | None = None) -> str:
    match = re.search(pattern, text, re.MULTILINE)
    if match is None:
        assert default is not None, text
        return default
    return match[1]


class Browser:
    """Chromium that reaches this computer alone; `requested` are the hosts that pages asked for."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self.requested: set[str] = set()
        self.errors: list[str] = []

    def open(self, size: str = "tablet", language: str = "en-US", trusts_all: bool = False) -> Any:
        """New page with cookies of its own; `language` is the one that the browser prefers.

        With `trusts_all` it accepts any certificate, as a person does who has compared the fingerprint.
        """
        width, height = SIZES[size]
        context = self._browser.new_context(
            viewport={"width": width, "height": height}, locale=language, ignore_https_errors=trusts_all
        )
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("request", lambda request: self.requested.add(urlsplit(request.url).hostname or ""))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        return page


@contextmanager
def chromium() -> Iterator[Browser]:
    """Headless Chromium."""
    sys.path.insert(0, str(PACKAGES))
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(OFFLINE))
        try:
            yield Browser(browser)
        finally:
            browser.close()
            sys.path.remove(str(PACKAGES))


def log_in(page: Any, process: PageProcess, name: str = "operator", password: str | None = None) -> None:
    """Logs in on a page that shows the form."""
    page.goto(process.url)
    page.fill("input[name=name]", name)
    page.fill("input[name=password]", process.password if password is None else password)
    page.click("button[type=submit]")


def view(page: Any, name: str) -> None:
    """Opens a view by its link."""
    page.click(f"nav a[href^='/{'' if name == 'drive' else name}?']")
    page.wait_for_selector(f".hl-view-{name}")


def wait_for(page: Any, selector: str, pattern: str) -> str:
    """Waits until the text of an element matches a regular expression; returns it."""
    script = "([selector, pattern]) => new RegExp(pattern).test(document.querySelector(selector)?.textContent || '')"
    page.wait_for_function(script, arg=[selector, pattern])
    return str(page.text_content(selector))


def row(page: Any, section: str, key: str) -> str:
    """Value of a row of a section, waits until it is known."""
    return wait_for(page, f"#rows-{section} [data-key='{key}'] dd", "[^–]")
