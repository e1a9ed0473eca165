"""Run folder: command, resolved configuration, console output, log, results and report."""

import json
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from configs.strict import Config
from messages.errors import HeadlandError

ROOT = Path(__file__).resolve().parent.parent
RUNS = Path("runs")


class RunFolder:
    """Folder `runs/<stamp>-<verb>/`; its `result.jsonl` is complete with the end marker that `finish` writes.

    Raises HeadlandError if the folder is not empty or cannot be written.
    """

    def __init__(self, verb: str, out: Path | None) -> None:
        self.path = (out or unused_run(verb)).absolute()
        if self.path.exists() and any(self.path.iterdir()):
            raise HeadlandError(f"--out {self.path}: not empty; name another folder or remove it")
        self._events = 0
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            (self.path / "command").write_text(shlex.join(sys.argv) + "\n", encoding="utf-8")
        except OSError as error:
            raise HeadlandError(f"{self.path}: cannot write the run folder ({error})") from error
        if out is None:
            link_latest(self.path)

    def record(self, kind: str, values: dict[str, Any]) -> None:
        """Appends one record to `result.jsonl`."""
        self._events += 1
        with (self.path / "result.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"record": kind} | values) + "\n")

    def finish(self) -> None:
        """Writes the end marker."""
        self.record("end", {"records": self._events})


def unused_run(verb: str) -> Path:
    """Unused folder `runs/<stamp>-<verb>`, numbered if two runs start within one second."""
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{verb}"
    candidates = (RUNS / (name if k == 0 else f"{name}-{k}") for k in range(1000))
    return next(path for path in candidates if not path.exists())


def link_latest(target: Path) -> None:
    """Points `runs/latest` to a run folder."""
    link = RUNS / "latest"
    fresh = link.with_name(f".{link.name}.{target.name}")
    fresh.symlink_to(target.name)
    fresh.replace(link)


def versions() -> dict[str, str]:
    """Commit, with `+changes` for a modified tree, and SHA-256 of the lock file."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    commit = git("rev-parse", "HEAD") or "unknown"
    changed = "+changes" if git("status", "--porcelain", "--untracked-files=no") else ""
    return {"commit": commit + changed, "lock": sha256((ROOT / "requirements.txt").read_bytes()).hexdigest()}


def resolved(**sections: Config) -> str:
    """Resolved configuration of a run as YAML text."""
    return yaml.safe_dump({k: v.model_dump(mode="json") for k, v in sections.items()}, sort_keys=False)
