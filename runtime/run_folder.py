"""Run folder: manifest, lock, command, resolved configuration, console output, log, results and report."""

import argparse
import fcntl
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import yaml

from configs.strict import Config
from datasets.parts import files_of
from messages.errors import HeadlandError

ROOT = Path(__file__).resolve().parent.parent
RUNS = Path("runs")
MANIFEST, FRESH_MANIFEST = "manifest.json", ".manifest.json.new"
NOT_OF_THE_COMMAND = ("out", "json", "cores", "module", "verb")  # they do not change what a command makes


class RunFolder:
    """Folder `runs/<stamp>-<verb>/` of one run, locked while the run works in it.

    `manifest.json` has the command and the names of all files that the run made; no other file is changed, moved or
    removed. The folder is new, empty, or of an interrupted run of the same command: its files are then moved into
    `interrupted-N/`, or kept if the command `resumes`. `result.jsonl` is complete with the end marker that `finish`
    writes. Raises HeadlandError for any other folder, before anything is written.
    """

    def __init__(
        self, verb: str, out: Path | None, command: Mapping[str, Any] | None = None, resumes: bool = False
    ) -> None:
        self.path = (out or unused_run(verb)).absolute()
        self._is_named, self._resumes = out is not None, resumes
        self._manifest: dict[str, Any] = {"verb": verb, "command": dict(command or {}), "is_complete": False}
        self._files: list[str] = []
        self._has_begun = False
        self._events = 0
        self._lock, self._created = lock_folder(self.path)
        try:
            self._recognize()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Releases the lock; a folder that was made for this run and is still empty is removed."""
        if not self._has_begun:
            remove_folders(self._created)
        os.close(self._lock)

    def file(self, name: str) -> Path:
        """Path of a file or folder that this run makes; raises HeadlandError if another one has this name."""
        if not self._has_begun:
            self._begin()
        path = self.path / name
        if name not in self._files:
            if os.path.lexists(path):
                raise HeadlandError(f"{path}: exists and was not made by this run; move it or name another --out")
            self._files.append(name)
            self._write_manifest()
        return path

    def record(self, kind: str, values: Mapping[str, Any]) -> None:
        """Appends one record to `result.jsonl`; raises HeadlandError if it cannot be written."""
        self._events += 1
        path = self.file("result.jsonl")
        with named_errors(self.path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"record": kind, **values}) + "\n")

    def finish(self) -> None:
        """Writes the end marker; the folder is then complete and accepts no other run."""
        self.record("end", {"records": self._events})
        self._manifest["is_complete"] = True
        self._write_manifest()

    def _recognize(self) -> None:
        """Raises HeadlandError unless the folder is empty or has the manifest of this command."""
        found = read_manifest(self.path)
        if found is None:
            check_empty(self.path)
            self._check_writable()
            return
        if any(found.get(key) != json.loads(json.dumps(self._manifest[key])) for key in ("verb", "command")):
            words = f"--out {self.path}: of another command ({found.get('verb', 'validate')})"
            raise HeadlandError(f"{words}; name another folder")
        if found.get("is_complete"):
            raise HeadlandError(f"--out {self.path}: this run is complete; name another folder")
        self._files = [name for name in found["files"] if name == Path(name).name]
        self._check_writable()

    def _check_writable(self) -> None:
        with named_errors(self.path):
            (self.path / FRESH_MANIFEST).touch()
            (self.path / FRESH_MANIFEST).unlink()

    def _begin(self) -> None:
        """Moves the files of an interrupted run aside, then writes the first files of this one."""
        self._has_begun = True
        if not self._resumes and self._files:
            self._set_aside()
        if "command" not in self._files:
            path = self.file("command")
            with named_errors(self.path):
                path.write_text(shlex.join(sys.argv) + "\n", encoding="utf-8")
        if not self._is_named:
            link_latest(self.path)

    def _set_aside(self) -> None:
        number = next(k for k in range(1, 1_000_000) if not (self.path / f"interrupted-{k}").exists())
        with named_errors(self.path):
            aside = self.path / f"interrupted-{number}"
            aside.mkdir()
            for name in self._files:
                for path in files_of(self.path / name):
                    if os.path.lexists(path):
                        path.rename(aside / path.name)
        self._files = []
        sys.stderr.write(f"headland: the files of the interrupted run are in {aside}\n")

    def _write_manifest(self) -> None:
        write_manifest(self.path, self._manifest | {"files": self._files})


def command_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """What makes a command the same one again: its arguments without folder and form of output."""
    values = ((key, value) for key, value in vars(arguments).items() if key not in NOT_OF_THE_COMMAND)
    return {key: str(value) if isinstance(value, Path) else value for key, value in sorted(values)}


def lock_folder(path: Path) -> tuple[int, list[Path]]:
    """Creates and locks a folder: descriptor of the lock, and the created folders; raises HeadlandError."""
    with named_errors(path):
        if path.exists() and not path.is_dir():
            raise HeadlandError(f"--out {path}: is a file, not a folder")
        created = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
        lock = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException as error:
            os.close(lock)
            if isinstance(error, BlockingIOError):
                raise HeadlandError(f"--out {path}: another run is writing to this folder") from error
            raise
    return lock, created


def remove_folders(created: list[Path]) -> None:
    """Removes created folders that are still empty, the innermost first."""
    with suppress(OSError):
        for folder in created:
            folder.rmdir()


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of a folder, None without one; raises HeadlandError for one that is not Headland's."""
    path = folder / MANIFEST
    if not os.path.lexists(path):
        return None
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise HeadlandError(f"{path}: cannot be read ({error!r}); name another folder") from error
    if not isinstance(values, dict) or not isinstance(values.get("files"), list | dict):
        raise HeadlandError(f"{path}: not written by Headland; name another folder")
    return values


def write_manifest(folder: Path, values: Mapping[str, Any]) -> None:
    """Replaces the manifest at once; raises HeadlandError."""
    with named_errors(folder):
        fresh = folder / FRESH_MANIFEST
        fresh.write_text(json.dumps(values, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        fresh.replace(folder / MANIFEST)


def check_empty(folder: Path) -> None:
    """Raises HeadlandError that names a file for a folder without manifest that is not empty."""
    other = next((name for name in sorted(os.listdir(folder)) if name != FRESH_MANIFEST), None)
    if other is not None:
        raise HeadlandError(f"--out {folder}: contains {other} and is no folder of this command; name another folder")


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Turns an OSError into a HeadlandError that names the folder."""
    try:
        yield
    except OSError as error:
        raise HeadlandError(f"{path}: cannot be written ({error.strerror or error})") from error


def unused_run(verb: str) -> Path:
    """Unused folder `runs/<stamp>-<verb>`, numbered if two runs start within one second."""
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{verb}"
    candidates = (RUNS / (name if k == 0 else f"{name}-{k}") for k in range(1000))
    return next(path for path in candidates if not path.exists())


def link_latest(target: Path) -> None:
    """Points `runs/latest` to a run folder, unless a person has put something else there."""
    link = RUNS / "latest"
    if link.exists() and not link.is_symlink():
        return
    fresh = link.with_name(f".{link.name}.{target.name}")
    with named_errors(link):
        fresh.unlink(missing_ok=True)
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
    values = {name: section.model_dump(mode="json") for name, section in sections.items()}
    return str(yaml.dump(values, Dumper=yaml.CSafeDumper, sort_keys=False))
