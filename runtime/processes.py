"""Processes that end with the one that started them, also when it is killed: none writes on in its folder."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

PARENT = "HEADLAND_PARENT"  # process number of the starting process, for programs that it starts
PR_SET_PDEATHSIG = 1
_children: set[subprocess.Popen[str]] = set()


def run_headland(arguments: list[str], folder: Path) -> tuple[int, str]:
    """Runs a headland command in `folder` until it ends; exit code and standard error."""
    child = subprocess.Popen(
        [sys.executable, "-m", "runtime", *arguments], cwd=folder, env=os.environ | {PARENT: str(os.getpid())},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    _children.add(child)
    try:
        text = child.communicate()[1]
        return child.returncode, text
    finally:
        _children.discard(child)


def terminate_children() -> None:
    """Sends SIGTERM to all processes of `run_headland` and of `multiprocessing`."""
    pids = [child.pid for child in _children] + [worker.pid for worker in multiprocessing.active_children()]
    for pid in filter(None, pids):
        with suppress(OSError):
            os.kill(pid, signal.SIGTERM)


def begin_worker(parent: int | None) -> None:
    """Start of a worker process: it ends with its parent (None: not with it), which handles SIGINT for all."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if parent is not None:
        end_with_parent(parent)


def end_with_parent(parent: int | None = None, number: int = signal.SIGKILL) -> None:
    """Lets the kernel send a signal to this process when its parent ends; at once if it has ended already."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)
    if parent is not None and os.getppid() != parent:
        os.kill(os.getpid(), number)
