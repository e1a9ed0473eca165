"""Which importer reads a recording: told from its content, whatever it is called."""

from pathlib import Path

from datasets.importers.candump import is_candump, open_candump
from datasets.importers.kitti import is_kitti, open_kitti
from datasets.importers.mcap_logs import open_mcap
from datasets.importers.pcd import is_pcd, open_pcd
from datasets.importers.recording import Recording
from datasets.importers.ros_bags import METADATA, ROS1_MAGIC, SQLITE_MAGIC, open_ros1_bag, open_ros2_bag
from datasets.records import MAGIC
from messages.errors import LogError

KNOWN = "MCAP, ROS 1 and ROS 2 bags, KITTI folders, PCD, candump"
HEAD_BYTES = 4096


def open_recording(path: Path, truth: Path | None = None) -> Recording:
    """A recording of any known format; `truth` names KITTI labels that lie elsewhere. Raises LogError."""
    if truth is not None and not truth.exists():
        raise LogError(f"{truth}: there is no such truth")
    recording = _open_folder(path, truth) if path.is_dir() else _open_file(path)
    if truth is not None and recording.description.truth_frame is None:
        raise LogError(f"{truth}: labels of KITTI go with a KITTI folder, not with {recording.description.format}")
    return recording


def _open_folder(path: Path, truth: Path | None) -> Recording:
    if (path / METADATA).is_file():
        return open_ros2_bag(path)
    if is_kitti(path):
        return open_kitti(path, truth)
    if any(is_pcd(_head(p)) for p in sorted(path.glob("*.pcd"))[:1]):
        return open_pcd(path)
    logs = sorted(p for p in path.glob("*.mcap") if _head(p).startswith(MAGIC))
    if len(logs) == 1:
        return open_mcap(logs[0])
    some = ", ".join(sorted(p.name for p in path.iterdir())[:6]) or "nothing"
    raise LogError(f"{path}: no recording that is known here ({KNOWN}); it holds {some}")


def _open_file(path: Path) -> Recording:
    head = _head(path)
    if not head:
        raise LogError(f"{path}: is empty, nothing was recorded")
    if head.startswith(MAGIC) or MAGIC.startswith(head):
        return open_mcap(path)
    if head.startswith(ROS1_MAGIC):
        return open_ros1_bag(path)
    if head.startswith(SQLITE_MAGIC):
        return open_ros2_bag(path)
    if is_pcd(head):
        return open_pcd(path)
    if is_candump(head):
        return open_candump(path)
    raise LogError(f"{path}: no recording that is known here ({KNOWN}); it begins with {head[:16]!r}")


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
