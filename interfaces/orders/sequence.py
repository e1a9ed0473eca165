"""Highest sequence number of each key, and whether operation is forbidden; on disk before an order takes effect."""

import json
from pathlib import Path

from messages.errors import HeadlandError

FORBIDDEN = "forbidden"  # file that is there while operation is forbidden


class SequenceStore:
    """One file per public key in `folder`; None keeps the numbers in memory only (a simulation)."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._known: dict[str, int] = {}
        self.is_forbidden = folder is not None and (folder / FORBIDDEN).exists()

    def last(self, key: str) -> int:
        """Highest number so far, -1 before the first; raises HeadlandError for a file that cannot be read."""
        if key not in self._known:
            self._known[key] = -1 if self._folder is None else _read(self._folder / f"{key}.json")
        return self._known[key]

    def advance(self, key: str, sequence: int) -> None:
        """Stores a number; raises HeadlandError if it cannot be written."""
        if self._folder is not None:
            _write(self._folder / f"{key}.json", sequence)
        self._known[key] = sequence

    def set_forbidden(self, is_forbidden: bool) -> None:
        """Forbids or permits operation; raises HeadlandError if it cannot be stored, and it is forbidden then."""
        self.is_forbidden = True
        if self._folder is not None:
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                if is_forbidden:
                    (self._folder / FORBIDDEN).touch()
                else:
                    (self._folder / FORBIDDEN).unlink(missing_ok=True)
            except OSError as error:
                raise HeadlandError(f"{self._folder / FORBIDDEN}: cannot be written ({error.strerror})") from error
        self.is_forbidden = is_forbidden


def _read(path: Path) -> int:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["sequence"]
    except FileNotFoundError:
        return -1
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise HeadlandError(f"{path}: sequence number cannot be read ({error})") from error
    if type(found) is not int:
        raise HeadlandError(f"{path}: sequence {found!r} is not a whole number")
    return found


def _write(path: Path, sequence: int) -> None:
    """Replaces the file at once; not forced to the disk, as that may take longer than the supervisor's period.

    After a power cut an earlier number may be read; the session has then changed and refuses all earlier orders.
    """
    fresh = path.with_suffix(".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.write_text(json.dumps({"sequence": sequence}), encoding="utf-8")
        fresh.replace(path)
    except OSError as error:
        raise HeadlandError(f"{path}: sequence number cannot be written ({error})") from error
