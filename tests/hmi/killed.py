"""Python code that is killed while it writes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.recordings import ROOT


def lines_before_kill(code: str, path: Path, after_s: float) -> list[str]:
    """Complete lines that `code`, given the path, prints until it is killed some time after the first."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], env=env, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = [process.stdout.readline()]
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    lines += process.stdout.readlines()
    process.wait()
    return [line.rstrip("\n") for line in lines if line.endswith("\n")]
