"""Files that are complete or not there; the file of a log: only complete writes, errors with path and free space."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from messages.errors import LogError

MB = 1_000_000


class LogFile:
    """A new file for appended records; its content is always a sequence of complete writes.

    After a failed write the file is truncated to the last complete one, and later writes are refused. Raises LogError,
    also for an existing path or less than `min_free_bytes` of free space.
    """

    def __init__(self, path: Path, min_free_bytes: int) -> None:
        self.path = path
        self._min_free = min_free_bytes
        self._size = 0
        self._failure: LogError | None = None
        try:
            self._file = path.open("wb" if path.is_char_device() else "xb", buffering=0)
        except FileExistsError as error:
            raise LogError(f"{path}: exists and is not overwritten; choose another path") from error
        except OSError as error:
            raise LogError(f"{path}: the log cannot be created ({error.strerror})") from error
        try:
            self.check_space()
        except LogError:
            self._file.close()
            path.unlink()
            raise

    def write(self, data: bytes) -> int:
        """Appends all of `data`."""
        if self._failure is not None:
            raise self._failure
        try:
            self._write_all(memoryview(data))
        except OSError as error:
            self._fail(error)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes written (name required by the mcap writer)."""
        return self._size

    def flush(self) -> None:
        """No effect: the file is unbuffered (method required by the mcap writer)."""

    def sync(self) -> None:
        """Synchronizes to disk; written data then survives a power failure."""
        try:
            os.fdatasync(self._file.fileno())
        except OSError as error:
            self._fail(error)

    def check_space(self) -> None:
        """Raises LogError below the minimum free space, which leaves room for the report."""
        free = _free_bytes(self.path)
        if free < self._min_free:
            raise LogError(
                f"{self.path}: {free / MB:.0f} MB are free on its disk and {self._min_free / MB:.0f} MB are kept free; "
                "free space or choose another path"
            )

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def _write_all(self, data: memoryview) -> None:
        while data:
            data = data[self._file.write(data) :]

    def _fail(self, error: OSError) -> None:
        """Truncates the file to its last complete write (possible on a full disk)."""
        if not self.path.is_char_device():
            os.ftruncate(self._file.fileno(), self._size)
        free = _free_bytes(self.path) / MB
        self._failure = LogError(
            f"{self.path}: the log cannot be written ({error.strerror}, {free:.0f} MB free on its disk); it is "
            f"readable up to byte {self._size}, but incomplete. Free space or choose another path"
        )
        raise self._failure from error


def check_room(folder: Path, seconds: float, mb_per_s: float, min_free_mb: float) -> None:
    """Raises LogError if the disk of a folder has no room for the log of a drive of about this duration."""
    free_mb, needed_mb = _free_bytes(folder / "log") / MB, seconds * mb_per_s + min_free_mb
    if free_mb < needed_mb:
        raise LogError(
            f"{folder}: {free_mb:.0f} MB are free on its disk, and a drive of about {seconds / 60.0:.0f} min needs "
            f"{needed_mb:.0f} MB ({min_free_mb:.0f} MB of it are kept free); free space or choose another --out"
        )


def _free_bytes(path: Path) -> int:
    stat = os.statvfs(path.parent)
    return stat.f_bavail * stat.f_frsize


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Path of a file that gets the name `path` when the context ends without an error, and is removed otherwise.

    It is in the folder `.NAME.incomplete` beside `path`, which a killed process leaves and the next one uses. Raises
    LogError if `path` exists, also when it appears meanwhile, and if another process writes it.
    """
    if path.is_char_device():
        yield path
        return
    folder = path.with_name(f".{path.name}.incomplete")
    lock, fresh = _locked(folder, path), folder / path.name
    try:
        fresh.unlink(missing_ok=True)
        _refuse_existing(path)
        yield fresh
        _refuse_existing(path)
        try:
            fresh.rename(path)
        except OSError as error:
            raise LogError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        fresh.unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()
        os.close(lock)


def _locked(folder: Path, path: Path) -> int:
    """Descriptor of the lock of a folder that is created for a new file."""
    try:
        folder.mkdir(exist_ok=True)
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise LogError(f"{path}: cannot be created ({error.strerror})") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise LogError(f"{path}: another process is writing it") from error
    return lock


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise LogError(f"{path}: exists and is not overwritten; choose another path")
