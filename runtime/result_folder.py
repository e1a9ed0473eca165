"""Results of `validate`: written beside those of an earlier run and put in their place when they are complete."""

import json
import os
import shlex
import shutil
import sys
from hashlib import file_digest
from pathlib import Path
from typing import Any

from messages.errors import HeadlandError
from runtime.run_folder import (
    FRESH_MANIFEST,
    MANIFEST,
    check_empty,
    link_latest,
    lock_folder,
    named_errors,
    read_manifest,
    remove_folders,
    unused_run,
    write_manifest,
)

INCOMPLETE = ".incomplete"
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
        self._verb, self._files = verb, Hashes()
        self._lock, self._created = lock_folder(self.path)
        try:
            self._prepare()
        except BaseException:
            remove_folders(self._created)
            os.close(self._lock)
            raise

    def __enter__(self) -> "ResultFolder":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def write(self, name: str, content: str | bytes) -> None:
        """Writes a new result; raises HeadlandError if it cannot be written."""
        with named_errors(self.path):
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
        with named_errors(self.path):
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
        if not self._files:
            (self.path / MANIFEST).unlink(missing_ok=True)
            remove_folders(self._created)

    def _prepare(self) -> None:
        """Removes what an interrupted run left outside of the folders of logs."""
        with named_errors(self.path):
            self._files = self._own_files()
            self._write_manifest(self._files)
            self.new.mkdir(exist_ok=True)
            for path in self.new.iterdir():
                if path.is_file():
                    path.unlink()

    def _own_files(self) -> Hashes:
        """Listed files that exist; raises HeadlandError for any other file, and for a changed one."""
        manifest = read_manifest(self.path)
        if manifest is None:
            check_empty(self.path)
            return {}
        listed: Hashes = manifest["files"]
        if manifest.get("verb", self._verb) != self._verb or not isinstance(listed, dict):
            raise HeadlandError(f"--out {self.path}: of another command ({manifest.get('verb')}); name another folder")
        own = (MANIFEST, FRESH_MANIFEST, INCOMPLETE)
        found = [name for name in _relative_files(self.path) if Path(name).parts[0] not in own]
        for name in found:
            if name not in listed:
                raise HeadlandError(f"--out {self.path}: contains {name}, not of a validation; name another folder")
            if (self.path / name).is_symlink() or _hash(self.path / name) not in listed[name]:
                raise HeadlandError(f"--out {self.path}: {name} was changed after it was written; move it")
        if self.new.is_symlink():
            raise HeadlandError(f"--out {self.path}: contains {INCOMPLETE}, a symbolic link; name another folder")
        return {name: listed[name] for name in found}

    def _write_manifest(self, files: Hashes) -> None:
        write_manifest(self.path, {"verb": self._verb, "files": files})


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
