"""ROS 2 bags: a folder with `metadata.yaml`, read by rosbags; its files row by row where that fails or is absent."""

import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path

from rosbags.rosbag2 import Reader, ReaderError

from datasets.importers.mcap_logs import BAG_METADATA, entries_of
from datasets.importers.recording import Open, Recording, Skipped
from datasets.importers.ros_types import ROS2, decoder_of
from datasets.importers.streams import Item, recording_of
from messages.errors import LogError

NAME = "ROS 2 bag"
MAGIC = b"SQLite format 3\0"
# Successive unreadable rows after which the end of a database is assumed.
MAX_BAD_ROWS = 10_000
NEXT_ROW = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id LIMIT 1"
BAD_BAG = (ReaderError, OSError, ValueError, KeyError, IndexError, AssertionError, RuntimeError, struct.error)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens the folder of a ROS 2 bag, or a database, also without metadata as after a crash of the recorder."""
    if path.is_dir():
        return open_ros2_bag if (path / BAG_METADATA).is_file() or any(path.glob("*.db3")) else None
    return open_ros2_bag if head.startswith(MAGIC) else None


def open_ros2_bag(path: Path, _: Path | None = None) -> Recording:
    """A ROS 2 bag, by its folder or its database; raises LogError."""
    folder = path if path.is_dir() else path.parent
    note = f"the bag has no {BAG_METADATA}: its files are read row by row"
    if (folder / BAG_METADATA).is_file():
        try:
            return recording_of(path, NAME, lambda: _by_metadata(folder))
        except BAD_BAG as error:
            note = f"the bag is damaged ({error}): its files are read row by row"
    files = sorted([*path.glob("*.db3"), *path.glob("*.mcap")]) if path.is_dir() else [path]
    if not files:
        raise LogError(f"{path}: the bag has no file *.db3 or *.mcap; {note}")
    return recording_of(path, NAME, lambda: _row_by_row(files), (note,))


def _by_metadata(folder: Path) -> Iterator[Item]:
    with Reader(folder) as reader:
        for connection, receive_ns, raw in reader.messages():
            is_text = connection.msgdef.format.name == "MSG"
            definition = str(connection.msgdef.data) if is_text else ""
            yield _item(connection.topic, connection.msgtype, definition, receive_ns, bytes(raw))


def _item(topic: str, kind: str, definition: str, receive_ns: int, data: bytes) -> Item:
    return Item(topic, kind, receive_ns, lambda: decoder_of(ROS2, kind, definition)(data))


def _row_by_row(files: list[Path]) -> Iterator[Item | Skipped]:
    for file in files:
        try:
            yield from entries_of(file) if file.suffix == ".mcap" else _rows(file)
        except LogError as error:
            if len(files) == 1:
                raise
            yield Skipped(0, file.name, NAME, str(error))


def _rows(file: Path) -> Iterator[Item | Skipped]:
    """Messages by row; of a file cut inside a page the missing bytes of that page read as zeros."""
    try:
        database = sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)
        database.execute("PRAGMA writable_schema = ON")  # else a cut file is refused as a whole
        topics = {k: (name, kind) for k, name, kind in database.execute("SELECT id, name, type FROM topics")}
    except sqlite3.Error as error:
        raise LogError(f"{file}: no ROS 2 bag: the table of topics cannot be read ({error})") from error
    definitions = _definitions(database)
    at, bad, receive_ns = 0, 0, 0
    while bad < MAX_BAD_ROWS:
        try:
            row = database.execute(NEXT_ROW, (at,)).fetchone()
        except (sqlite3.Error, OverflowError):
            at, bad = at + 1, bad + 1
            continue
        if row is None:
            break
        yield from (Skipped(receive_ns, file.name, NAME, "a row cannot be read") for _ in range(bad))
        at, bad = row[0] + 1, 0
        if row[1] not in topics or not isinstance(row[2], int) or not isinstance(row[3], bytes):
            yield Skipped(receive_ns, file.name, NAME, "a row is no message of a topic")
            continue
        (name, kind), receive_ns = topics[row[1]], row[2]
        yield _item(name, kind, definitions.get(kind, ""), receive_ns, row[3])
    if bad:
        yield Skipped(receive_ns, file.name, NAME, f"the rows after {at - bad} cannot be read")
    database.close()


def _definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Message definitions by type; early versions of the format have none."""
    query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
    try:
        return dict(database.execute(query))
    except sqlite3.Error:
        return {}
