"""Cut, damaged and mixed recordings: no traceback, the readable part is kept, losses are in the table."""

import contextlib
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import Writer as Bag2

from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from datasets.importers.ros_types import ROS1, ROS2, ros_types
from datasets.importers.write_recording import write_recording
from datasets.reader import read_log
from messages.errors import LogError
from messages.sensors import ImuSample
from tests.datasets.test_import_table import LOG, VIEW

IMU, TEXT = "sensor_msgs/msg/Imu", "std_msgs/msg/String"
COUNT, NS = 400, 10**9
STORES: dict[str, Any] = {ROS1: ros_types(ROS1), ROS2: ros_types(ROS2)}


def imu(ros: str, k: int) -> bytes:
    """Serialized sample number k: the x rate is k."""
    store = STORES[ros]
    kind = store.types
    stamp = kind["builtin_interfaces/msg/Time"](100 + k // 100, k % 100 * 10_000_000)
    header = kind["std_msgs/msg/Header"](**({"stamp": stamp, "frame_id": "imu"} | ({"seq": k} if ros == ROS1 else {})))
    vector, nine = kind["geometry_msgs/msg/Vector3"], np.zeros(9)
    level = kind["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    message = kind[IMU](header, level, nine, vector(float(k), 0.0, 0.0), nine, vector(0.0, 0.0, 9.8), nine)
    return bytes(store.serialize_ros1(message, IMU) if ros == ROS1 else store.serialize_cdr(message, IMU))


def write_ros1(path: Path, compression: Bag1.CompressionFormat | None) -> Path:
    """A bag of 400 samples in about 9 chunks."""
    bag = Bag1(path)
    if compression is not None:
        bag.set_compression(compression)
    bag.chunk_threshold = 1 << 14
    with bag:
        connection = bag.add_connection("/imu", IMU, typestore=STORES[ROS1])
        for k in range(COUNT):
            bag.write(connection, 100 * NS + k * NS // 100, imu(ROS1, k))
    return path


def write_ros2(path: Path) -> Path:
    with Bag2(path, version=8) as bag:
        connection = bag.add_connection("/imu", IMU, typestore=STORES[ROS2])
        for k in range(COUNT):
            bag.write(connection, 100 * NS + k * NS // 100, imu(ROS2, k))
    return path


def samples(source: Recording) -> list[int]:
    """Numbers of the samples read."""
    return [round(m.rate_radps[0]) for _, _, m in source.read() if isinstance(m, ImuSample)]


def lost(source: Recording) -> int:
    return sum(row.skipped or 0 for row in source.table())


def cut(share: float) -> Callable[[bytes], bytes]:
    return lambda data: data[: int(share * len(data))]


def overwritten(share: float, length: int) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        at = int(share * len(data))
        return data[:at] + np.random.default_rng(length).bytes(length) + data[at + length :]

    return change


def unindexed(data: bytes) -> bytes:
    """As after a crash of the recorder: the header has no position of the index, the end is missing."""
    at = data.index(b"index_pos=") + len(b"index_pos=")
    return data[:at] + bytes(8) + data[at + 8 : int(0.8 * len(data))]


# name → damage and the least share of the samples that must be left
DAMAGES: dict[str, tuple[Callable[[bytes], bytes], float]] = {
    "cut at 90 %": (cut(0.9), 0.7),
    "cut at 50 %": (cut(0.5), 0.35),
    "cut at 35 %": (cut(0.35), 0.02),
    "unindexed": (unindexed, 0.6),
    "40 bytes of noise at 30 %": (overwritten(0.3, 40), 0.6),
    "5000 bytes of noise at 50 %": (overwritten(0.5, 5000), 0.5),
    "zeros at 40 %": (lambda d: d[: int(0.4 * len(d))] + bytes(2000) + d[int(0.4 * len(d)) + 2000 :], 0.5),
    "a part twice": (lambda d: d[: int(0.6 * len(d))] + d[int(0.4 * len(d)) :], 0.6),
    "a part missing": (lambda d: d[: int(0.4 * len(d))] + d[int(0.5 * len(d)) :], 0.6),
    "followed by noise": (lambda d: d + np.random.default_rng(1).bytes(3000), 1.0),
}
COMPRESSIONS = {"none": None, "bz2": Bag1.CompressionFormat.BZ2, "lz4": Bag1.CompressionFormat.LZ4}


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_ros1_bag(tmp_path: Path, name: str, compression: str) -> None:
    path = write_ros1(tmp_path / "x.bag", COMPRESSIONS[compression])
    change, least = DAMAGES[name]
    path.write_bytes(change(path.read_bytes()))
    source = open_recording(path)
    found = [k for k in samples(source) if k in range(COUNT)]
    assert len(set(found)) >= least * COUNT * (1.0 if compression == "none" else 0.7)
    if least < 1.0:
        assert lost(source) > 0 or found == list(range(COUNT)), "only the index is damaged"
        assert any("read in file order" in note for note in source.description.notes)
    if compression != "none":  # without a checksum noise may be values of a message
        assert len(found) == sum(row.read for row in source.table())


def test_intact_ros1_bag_without_losses(tmp_path: Path) -> None:
    for name, compression in COMPRESSIONS.items():
        source = open_recording(write_ros1(tmp_path / f"{name}.bag", compression))
        assert samples(source) == list(range(COUNT))
        assert (lost(source), source.description.notes) == (0, ())


def test_ros1_bag_cut_everywhere(tmp_path: Path) -> None:
    data = write_ros1(tmp_path / "x.bag", Bag1.CompressionFormat.LZ4).read_bytes()
    before = -1
    for length in range(len(data) // 40, len(data), len(data) // 40):
        (tmp_path / "cut.bag").write_bytes(data[:length])
        found: list[int] = []
        with contextlib.suppress(LogError):  # nothing readable before the first chunk
            found = samples(open_recording(tmp_path / "cut.bag"))
        assert found == list(range(len(found)))
        assert len(found) >= before
        before = len(found)
    assert before > 0.9 * COUNT


def test_ros1_bag_without_any_chunk_refused(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / "x.bag", None)
    for data in (
        path.read_bytes()[:4200],
        b"#ROSBAG V2.0\n",
        b"#ROSBAG V2.0\n" + bytes(5000),
        b"#ROSBAG V1.2\n" + bytes(99),
    ):
        path.write_bytes(data)
        with pytest.raises(LogError, match=r"x\.bag"):
            samples(open_recording(path))


def test_types_by_the_definition_in_the_bag(tmp_path: Path) -> None:
    """A sensor_msgs/Range of a later ROS has a variance, which the known definition lacks."""
    kind = "sensor_msgs/msg/Range"
    known = STORES[ROS1].generate_msgdef(kind)[0]
    text = known.replace("float32 range\n", "float32 range\nfloat32 variance\n", 1)
    assert text != known
    raw = bytes(4) + (100).to_bytes(4, "little") + bytes(4) + b"\1\0\0\0u" + b"\1"
    raw += np.array([0.5, 0.1, 5.0, 2.5, 0.01], "<f4").tobytes()
    with Bag1(tmp_path / "x.bag") as bag:
        connection = bag.add_connection("/range", kind, msgdef=text, md5sum="0" * 32)
        bag.write(connection, 100 * NS, raw)
    message: Any
    ((_, topic, message),) = open_recording(tmp_path / "x.bag").read()
    assert (topic, message.range_m) == ("ultrasonic/range", 2.5)


# --- ROS 2


def test_ros2_bag_without_metadata(tmp_path: Path) -> None:
    """As after a crash of the recorder: the database alone, by its folder and by itself."""
    folder = write_ros2(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    for path in (folder, next(folder.glob("*.db3"))):
        source = open_recording(path)
        assert samples(source) == list(range(COUNT))
        assert "metadata.yaml" in source.description.notes[0]


@pytest.mark.parametrize("has_metadata", [True, False])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_cut_ros2_database(tmp_path: Path, has_metadata: bool, share: float) -> None:
    folder = write_ros2(tmp_path / "bag")
    database = next(folder.glob("*.db3"))
    database.write_bytes(cut(share)(database.read_bytes()))
    if not has_metadata:
        (folder / "metadata.yaml").unlink()
    source = open_recording(folder)
    found = samples(source)
    assert sum(k != expected for k, expected in zip(found, range(COUNT), strict=False)) <= 12, "one page is torn"
    assert len(found) >= (share - 0.15) * COUNT
    assert lost(source) > 0


def test_noise_in_ros2_database(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag")
    database = next(folder.glob("*.db3"))
    data = database.read_bytes()
    page = 4096 * (len(data) // 4096 // 2)
    database.write_bytes(data[:page] + np.random.default_rng(1).bytes(4096) + data[page + 4096 :])
    source = open_recording(folder)
    found = samples(source)
    assert set(found) <= set(range(COUNT))
    assert len(found) > 0.8 * COUNT
    assert lost(source) > 0


def test_wrong_rows_of_ros2_database_are_skipped(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag")
    database = next(folder.glob("*.db3"))
    (folder / "metadata.yaml").unlink()
    with sqlite3.connect(database) as connection:
        connection.execute("UPDATE messages SET topic_id = 99 WHERE id = 3")
        connection.execute("UPDATE messages SET data = 'text' WHERE id = 5")
        connection.execute("UPDATE messages SET timestamp = 'soon' WHERE id = 7")
        connection.execute("UPDATE messages SET data = zeroblob(10) WHERE id = 9")
        connection.execute("DELETE FROM messages WHERE id = 11")
    source = open_recording(database)
    assert samples(source) == [k for k in range(COUNT) if k not in (2, 4, 6, 8, 10)]
    assert lost(source) == 4


def test_ros2_bag_with_a_missing_file(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag")
    metadata = folder / "metadata.yaml"
    database = next(folder.glob("*.db3"))
    metadata.write_text(metadata.read_text().replace(f"- {database.name}", f"- {database.name}\n  - lost.db3", 1))
    assert samples(open_recording(folder)) == list(range(COUNT))
    metadata.write_text("rosbag2_bagfile_information: [1, 2\n")
    assert samples(open_recording(folder)) == list(range(COUNT))
    database.unlink()
    with pytest.raises(LogError, match=r"no file \*\.db3"):
        open_recording(folder)


def test_databases_that_are_no_bags_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE fields (id INTEGER)")
    with pytest.raises(LogError, match=r"x\.db3: no ROS 2 bag: the table of topics cannot be read"):
        open_recording(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(LogError, match=r"x\.db3: no ROS 2 bag"):
        open_recording(path)


def test_ros2_bag_of_two_files_and_one_of_noise(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    database = next(folder.glob("*.db3"))
    shutil.copy(database, folder / "z.db3")
    assert samples(open_recording(folder)) == 2 * list(range(COUNT))
    (folder / "z.db3").write_bytes(b"SQLite format 3\0" + np.random.default_rng(1).bytes(5000))
    source = open_recording(folder)
    assert samples(source) == list(range(COUNT))
    assert any("z.db3" in note for note in source.description.notes)


# --- the imported log


def test_log_of_a_damaged_bag_names_the_losses(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / "x.bag", Bag1.CompressionFormat.BZ2)
    path.write_bytes(cut(0.6)(path.read_bytes()))
    source = open_recording(path)
    write_recording(source, tmp_path / "out.mcap", LOG, VIEW)
    copy = open_recording(tmp_path / "out.mcap")
    assert len(samples(copy)) == len(list(read_log(tmp_path / "out.mcap"))) == len(samples(source))
    assert [row.skipped for row in copy.table()] == [row.skipped for row in source.table()]
    assert any("bytes lost" in note for note in copy.description.notes)
