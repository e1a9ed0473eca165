"""Results of `validate`: written beside those of an earlier run and put in their place when they are complete."""

import fcntl
import json
import os
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import file_digest
from pathlib import Path
from typing import Any

from messages.errors import HeadlandError
from runtime.run_folder import link_latest, unused_run

MANIFEST, INCOMPLETE = "manifest.json", ".incomplete"
Hashes = dict[str, list[str]]


class ResultFolder:
    """Folder with results; new ones are written below `new`, and `replace` moves them into `path`.

    `manifest.json` lists all files with their SHA-256. A file that it does not list, or that was changed, is never
    replaced or removed: HeadlandError names it. An interrupted run leaves `new` for the next one to complete.
    """

    def __init__(self, verb: str, out: Path | None) -> None:
        self._is_named = out is not None
        self.path = (out or unused_run(verb)).absolute()
        self.new = self.path / INCOMPLETE
        self._had_folder = self.path.exists()
        with _named_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.path, os.O_RDONLY)
        try:
            self._prepare()
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> "ResultFolder":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def write(self, name: str, content: str | bytes) -> None:
        """Writes a new result; raises HeadlandError if it cannot be written."""
        with _named_errors(self.path):
            path = self.new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)

    def write_records(self, records: list[dict[str, Any]]) -> None:
        """Writes `command`, and `result.jsonl` with an end marker."""
        lines = [*records, {"record": "end", "records": len(records)}]
        self.write("result.jsonl", "".join(json.dumps(line) + "\n" for line in lines))
        self.write("command", shlex.join(sys.argv) + "\n")

    def replace(self, folders: set[str]) -> None:
        """Puts the new results in place of the earlier ones; files in other folders than `folders` are removed."""
        with _named_errors(self.path):
            found = [n for n in _relative_files(self.new) if str(Path(n).parent) in {".", *folders}]
            new = {name: [_hash(self.new / name)] for name in found}
            before = {n: h for n, h in self._files.items() if n not in new and str(Path(n).parent) in folders}
            # while files are moved, both contents of each are known as results
            self._write_manifest({n: self._files.get(n, []) + new.get(n, []) for n in {*self._files, *new}})
            for name in sorted(new):
                (self.path / name).parent.mkdir(parents=True, exist_ok=True)
                (self.new / name).replace(self.path / name)
            for name in sorted({*self._files} - {*new} - {*before}):
                (self.path / name).unlink(missing_ok=True)
                _remove_empty(self.path, (self.path / name).parent)
            self._write_manifest(before | new)
            shutil.rmtree(self.new)
            if not self._is_named:
                link_latest(self.path)

    def discard(self) -> None:
        """Removes the new results, and the folder if it was made for them."""
        shutil.rmtree(self.new, ignore_errors=True)
        if not self._had_folder:
            _remove_empty(self.path.parent, self.path)

    def _prepare(self) -> None:
        """Locks the folder, then removes what an interrupted run left outside of the folders of logs."""
        with _named_errors(self.path):
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise HeadlandError(f"{self.path}: another validation writes to this folder") from error
            self._files = self._own_files()
            self.new.mkdir(exist_ok=True)
            for path in self.new.iterdir():
                if path.is_file():
                    path.unlink()

    def _own_files(self) -> Hashes:
        """Listed files that exist; raises HeadlandError for any other file, and for a changed one."""
        manifest = self.path / MANIFEST
        listed: Hashes = {}
        if manifest.is_file():
            try:
                listed = json.loads(manifest.read_text(encoding="utf-8"))["files"]
            except (ValueError, KeyError, TypeError) as error:
                raise HeadlandError(f"{manifest}: cannot be read ({error!r}); name another folder") from error
        found = [name for name in _relative_files(self.path) if Path(name).parts[0] not in (MANIFEST, INCOMPLETE)]
        for name in found:
            if name not in listed:
                raise HeadlandError(f"--out {self.path}: contains {name}, not of a validation; name another folder")
            if (self.path / name).is_symlink() or _hash(self.path / name) not in listed[name]:
                raise HeadlandError(f"--out {self.path}: {name} was changed after it was written; move it")
        if self.new.is_symlink():
            raise HeadlandError(f"--out {self.path}: contains {INCOMPLETE}, a symbolic link; name another folder")
        return {name: listed[name] for name in found}

    def _write_manifest(self, files: Hashes) -> None:
        temporary = self.path / f"{INCOMPLETE}/{MANIFEST}"
        temporary.write_text(json.dumps({"files": files}, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        temporary.replace(self.path / MANIFEST)


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    """Turns an OSError into a HeadlandError that names the folder."""
    try:
        yield
    except OSError as error:
        raise HeadlandError(f"{path}: cannot write the results ({error.strerror or error})") from error


def _relative_files(folder: Path) -> list[str]:
    """All files below a folder, and links to folders, relative to it."""
    found = []
    for top, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(top, name))]
        found += [os.path.relpath(os.path.join(top, name), folder) for name in (*files, *links)]
    return sorted(found)


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def _remove_empty(top: Path, folder: Path) -> None:
    """Removes a folder and those above it, below `top`, while they are empty."""
    while folder != top and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
