"""Waits for a file that another process writes."""

import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path


def after_file(pattern: str, delay_s: float) -> Callable[[subprocess.Popen[str], Path], None]:
    """Waits until the process has written a file of this name, and some time more."""

    def wait(process: subprocess.Popen[str], folder: Path) -> None:
        def files() -> set[tuple[int, int]]:  # a file of an earlier run may be moved
            found = set()
            for path in folder.rglob(pattern):
                with suppress(FileNotFoundError):
                    if path.is_file():
                        found.add((path.stat().st_ino, path.stat().st_mtime_ns))
            return found

        before = files()
        while process.poll() is None and not files() - before:
            time.sleep(0.02)
        time.sleep(delay_s)

    return wait
