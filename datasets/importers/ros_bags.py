"""ROS 1 bags (one file) and ROS 2 bags (a folder with `metadata.yaml`), read by rosbags."""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import ReaderError as Reader2Error

from datasets.importers.mcap_logs import BAG_METADATA, ros_types
from datasets.importers.recording import Open, Recording
from datasets.importers.ros_messages import TRANSFORMS
from datasets.importers.streams import Item, recording_of
from messages.errors import LogError

NAME = "ROS 1 or 2 bag"
ROS1_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\0"


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a ROS 1 bag, the folder of a ROS 2 bag, or its database."""
    if head.startswith(ROS1_MAGIC):
        return open_ros1_bag
    folder = path.parent if head.startswith(SQLITE_MAGIC) else path
    return open_ros2_bag if (folder / BAG_METADATA).is_file() else None


def open_ros1_bag(path: Path, _: Path | None = None) -> Recording:
    """A ROS 1 bag; raises LogError, also for a truncated one (repaired by `rosbag reindex`)."""
    return recording_of(path, "ros1 bag", lambda: _items(path, lambda: Reader1(path), "ROS1_NOETIC"))


def open_ros2_bag(path: Path, _: Path | None = None) -> Recording:
    """A ROS 2 bag, by its folder or its database; raises LogError."""
    folder = path if path.is_dir() else path.parent
    return recording_of(path, "ros2 bag", lambda: _items(path, lambda: Reader2(folder), "ROS2_HUMBLE"))


def _items(path: Path, make: Callable[[], Any], types: str) -> Iterator[Item]:
    store = ros_types(types)
    decode = store.deserialize_ros1 if types.startswith("ROS1") else store.deserialize_cdr
    with _named(path), make() as reader:
        for connection, receive_ns, raw in reader.messages():
            kind = {"tf/msg/tfMessage": TRANSFORMS}.get(connection.msgtype, connection.msgtype)
            yield Item(connection.topic, kind, receive_ns, partial(decode, raw, kind))


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turns errors of rosbags into LogError with the file name."""
    try:
        yield
    except LogError:
        raise
    except (Reader1Error, Reader2Error, OSError, ValueError, KeyError, AssertionError, struct.error) as error:
        raise LogError(f"{path}: the bag cannot be read ({error})") from error
