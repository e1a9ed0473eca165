"""Shared memory that a killed `live` left is removed; that of a living run, or of one that just starts, is not."""

import fcntl
import os
from pathlib import Path

from runtime.live.ring_folder import LEFT_S, RINGS_PREFIX, remove_left_rings


def rings(memory: Path, name: str, age_s: float) -> Path:
    """A folder with a ring, last changed `age_s` ago."""
    folder = memory / f"{RINGS_PREFIX}{name}"
    folder.mkdir()
    (folder / "control").write_bytes(bytes(8))
    stamp_s = folder.stat().st_mtime - age_s
    os.utime(folder, (stamp_s, stamp_s))
    return folder


def test_only_unlocked_old_rings_are_removed(tmp_path: Path) -> None:
    left = rings(tmp_path, "left", 2 * LEFT_S)
    living = rings(tmp_path, "living", 2 * LEFT_S)
    starting = rings(tmp_path, "starting", 0.0)
    users = tmp_path / "headland-notes"
    users.mkdir()
    os.utime(users, (0.0, 0.0))
    linked = tmp_path / f"{RINGS_PREFIX}linked"
    linked.symlink_to(users)
    lock = os.open(living, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_SH)
        remove_left_rings(tmp_path)
    finally:
        os.close(lock)
    assert not left.exists()
    for kept in (living, starting, users):
        assert kept.is_dir(), kept
    assert linked.is_symlink()
    remove_left_rings(tmp_path)
    assert not living.exists(), "its run has ended"
