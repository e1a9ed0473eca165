"""A process that reads or plans a field, with its stage, result and end."""

import asyncio
import json
import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

Task = Literal["read", "plan"]
PARENT = "HEADLAND_PARENT"  # process number of the page: the process ends with it
MAX_LINE = 64 << 20


class FieldJob:
    """One run of `command TASK FOLDER [FEATURE]`, which prints one JSON object per line."""

    def __init__(self, command: tuple[str, ...], task: Task) -> None:
        self._command, self.task = command, task
        self.stage = ""
        self._began_s = time.monotonic()
        self.is_cancelled = False
        self._process: asyncio.subprocess.Process | None = None

    @property
    def elapsed_s(self) -> float:
        """Time since the start."""
        return time.monotonic() - self._began_s

    async def run(self, folder: Path, feature: str | None, limit_s: float) -> dict[str, Any]:
        """Result: `{"done": ...}` or `{"error": text}`; empty if it was cancelled or the process has died."""
        words = [*self._command, self.task, str(folder), *([] if feature is None else [feature])]
        self._process = await asyncio.create_subprocess_exec(
            *words, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, limit=MAX_LINE,
            start_new_session=True, env=os.environ | {PARENT: str(os.getpid())},
        )  # fmt: skip
        try:
            return await asyncio.wait_for(self._result(), limit_s)
        except TimeoutError:
            return {"error": f"no result within {limit_s:.0f} s"}
        finally:
            self._kill()
            await self._process.wait()

    def cancel(self) -> None:
        """Ends the process at once."""
        self.is_cancelled = True
        self._kill()

    async def _result(self) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        found: dict[str, Any] = {}
        async for line in self._process.stdout:
            with suppress(ValueError):
                said = json.loads(line)
                self.stage = str(said.get("stage", self.stage))
                found = said if "done" in said or "error" in said else found
        return {} if self.is_cancelled else found

    def _kill(self) -> None:
        """The process, and those that it has started."""
        if self._process is not None and self._process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
