"""`headland run --page`: the drive in the browser while it goes on; a process of its own that gives no orders."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from messages.message import Envelope
from runtime.live.ring import RingWriter
from runtime.live.ring_folder import rings_in_memory
from runtime.page.single_process import RING_MIB, ring_sink
from runtime.processes import PARENT
from runtime.run_folder import ROOT

END_S = 10.0


class ShownRun:
    """Ring with the messages of a drive, and the page that reads it once `begin` was called."""

    def __init__(self, ring: Path) -> None:
        self.rings = str(ring.parent)
        self._write = ring_sink(RingWriter(ring))
        self._page: subprocess.Popen[bytes] | None = None

    def begin(self, folder: Path) -> None:
        """Starts the page; `folder` has the conditions and the configuration of the drive by now."""
        env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1", PARENT: str(os.getpid())}
        command = [sys.executable, "-m", "runtime", "page", "--connect", str(folder), "--port", "0"]
        self._page = subprocess.Popen(command, env=env, stdout=sys.stderr.fileno())

    def write(self, envelope: Envelope) -> None:
        """Takes a message of the drive."""
        self._write(envelope)

    def end(self) -> None:
        """Ends the page."""
        if self._page is None:
            return
        self._page.terminate()
        try:
            self._page.wait(END_S)
        except subprocess.TimeoutExpired:
            self._page.kill()
            self._page.wait()


@contextmanager
def shown_run() -> Iterator[ShownRun]:
    """A drive that is shown until it ends."""
    with rings_in_memory({"simulation": RING_MIB}) as rings:
        run = ShownRun(rings["simulation"])
        try:
            yield run
        finally:
            run.end()
