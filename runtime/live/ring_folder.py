"""Folder of the rings of a run in shared memory; those that a killed run left are removed at the next start."""

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from runtime.live.ring import make_ring

RINGS_PREFIX = "headland-rings-"
LEFT_S = 60.0  # a run locks its folder long before


@contextlib.contextmanager
def rings_in_memory(size_mib: Mapping[str, int]) -> Iterator[dict[str, Path]]:
    """One ring per process, in shared memory, in a folder that is locked while a process of this run lives."""
    shared = Path("/dev/shm")
    memory = shared if shared.is_dir() else Path(tempfile.gettempdir())
    remove_left_rings(memory)
    folder = Path(tempfile.mkdtemp(prefix=RINGS_PREFIX, dir=memory))
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(lock, fcntl.LOCK_SH)
        rings = {role: folder / role for role in size_mib}
        for role, path in rings.items():
            make_ring(path, size_mib[role] << 20)
        yield rings
    finally:
        os.close(lock)
        shutil.rmtree(folder)


def remove_left_rings(memory: Path) -> None:
    """Removes folders of rings of this user that a killed run left: unlocked, and at least `LEFT_S` old."""
    for folder in memory.glob(f"{RINGS_PREFIX}*"):
        with contextlib.suppress(OSError):  # another user's, locked, or removed meanwhile
            if folder.stat().st_uid != os.getuid() or time.time() - folder.stat().st_mtime < LEFT_S:
                continue
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(lock)
