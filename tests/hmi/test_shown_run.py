"""`headland run --page`: the drive is seen in the browser while it goes on, and takes no orders."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from messages.errors import HeadlandError
from runtime.page.running import running_drive
from tests.hmi.browser import Browser, PageProcess, log_in, needs_browser, row, wait_for
from tests.recordings import ROOT

COMMAND = ("run", "--mission", "line", "--page", "--json")


@needs_browser
@pytest.mark.slow
@pytest.mark.drive
def test_a_run_is_shown_while_it_goes_on(browser: Browser, tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    out = tmp_path / "run"
    command = [sys.executable, "-m", "runtime", *COMMAND, "--out", str(out)]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    text = ""
    for line in process.stderr:
        text += line
        if line.startswith("Ctrl+C"):
            break
    page = browser.open()
    shown = PageProcess(process, text)
    assert shown.stop_url == ""
    log_in(page, shown)
    wait_for(page, "#mode", "Automatic")
    wait_for(page, "#rows-motion [data-key=speed] dd", "^[1-9]")
    assert row(page, "machine", "park_brake") == "released"
    assert "no order key" in page.text_content("[data-hl=barred]")
    stdout, errors = process.communicate(timeout=300.0)
    assert process.returncode == 0, errors
    assert json.loads(stdout)["outcome"] == "finished"  # nothing but the result
    page.wait_for_selector("#lost:not([hidden])")  # the page has ended with the run
    page.context.close()
    with pytest.raises(HeadlandError, match=re.escape("nor one of `run --page`")):
        running_drive(out)
