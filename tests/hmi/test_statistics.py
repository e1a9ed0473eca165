"""Statistics: totals by day and field, right after kill -9, a second reading of a drive, and midnight."""

import sqlite3
import threading
from pathlib import Path

import numpy as np
import pytest

from datasets.reader import LogScan, decode, is_ours, read_metadata
from hmi.page_state import PageState
from hmi.scene import scene_of
from hmi.statistics.store import StatisticsStore, Totals
from messages.command import Mode
from messages.errors import HeadlandError
from messages.message import Envelope
from messages.truth import TrueMachine
from runtime.page.log_feed import LogFeed
from tests.hmi.drive_messages import SECOND_NS, demo_scene, odometry, supervisor
from tests.hmi.killed import lines_before_kill

STORING = """
import sys
from pathlib import Path
from hmi.statistics.store import StatisticsStore, Totals
store = StatisticsStore(Path(sys.argv[1]))
first = store.by_day()[0].totals.stops if store.by_day() else 0
for k in range(first + 1, 1_000_000):
    store.put("a drive", "2026-11-25", "north", Totals(10.0 * k, 1.0 * k, 2.0 * k, k))
    print(k, flush=True)
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "page" / "statistics.db"


def sums(store: StatisticsStore) -> dict[tuple[str, str], Totals]:
    return {(one.day, one.field): one.totals for one in store.by_day()}


def test_the_same_totals_are_counted_once(path: Path) -> None:
    """A page that was killed reads the drive from its beginning."""
    store = StatisticsStore(path)
    for totals in (Totals(10.0, 5.0, 2.0, 0), Totals(30.0, 9.0, 4.0, 1), Totals(30.0, 9.0, 4.0, 1)):
        store.put("a", "2026-11-25", "north", totals)
    store.close()
    again = StatisticsStore(path)
    again.put("a", "2026-11-25", "north", Totals(30.0, 9.0, 4.0, 1))
    assert sums(again) == {("2026-11-25", "north"): Totals(30.0, 9.0, 4.0, 1)}


def test_totals_do_not_shrink_when_a_log_lacks_the_last_seconds(path: Path) -> None:
    store = StatisticsStore(path)
    store.put("a", "2026-11-25", "north", Totals(30.0, 9.0, 4.0, 1))
    store.put("a", "2026-11-25", "north", Totals(20.0, 8.0, 5.0, 1))
    assert sums(store)["2026-11-25", "north"] == Totals(30.0, 9.0, 5.0, 1)


def test_a_drive_past_midnight_belongs_to_both_days(path: Path) -> None:
    store = StatisticsStore(path)
    store.put("a", "2026-11-25", "north", Totals(30.0, 9.0, 4.0, 1))
    store.put("a", "2026-11-26", "north", Totals(50.0, 19.0, 9.0, 3))
    store.put("a", "2026-11-26", "north", Totals(50.0, 19.0, 9.0, 3))
    found = sums(store)
    assert found["2026-11-25", "north"] == Totals(30.0, 9.0, 4.0, 1)
    assert found["2026-11-26", "north"] == Totals(20.0, 10.0, 5.0, 2)


def test_drives_of_a_day_add_up_by_field(path: Path) -> None:
    store = StatisticsStore(path)
    store.put("a", "2026-11-25", "north", Totals(30.0, 9.0, 4.0, 1))
    store.put("b", "2026-11-25", "north", Totals(3.0, 1.0, 1.0, 1))
    store.put("c", "2026-11-25", "south'; DROP TABLE drives; --", Totals(3.0, 1.0, 1.0, 0))
    store.put("d", "2026-11-25", "nothing", Totals())
    first, second = store.by_day()
    assert (first.field, first.drives, first.totals) == ("north", 2, Totals(33.0, 10.0, 5.0, 2))
    assert second.field == "south'; DROP TABLE drives; --"


@pytest.mark.parametrize("content", [b"not a database" * 100, b"SQLite format 3\0" + bytes(5000)])
def test_a_damaged_file_is_named_and_left_alone(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(HeadlandError, match=r"statistics\.db: cannot be used"):
        StatisticsStore(path)
    assert path.read_bytes() == content


def test_a_newer_version_is_refused(path: Path) -> None:
    StatisticsStore(path).close()
    with sqlite3.connect(path) as link:
        link.execute("PRAGMA user_version = 9")
    with pytest.raises(HeadlandError, match="version 9"):
        StatisticsStore(path)


def test_two_pages_write_at_once(path: Path) -> None:
    def write(drive: str) -> None:
        store = StatisticsStore(path)
        for k in range(1, 51):
            store.put(drive, "2026-11-25", "north", Totals(float(k), float(k), float(k), k))

    StatisticsStore(path).close()
    threads = [threading.Thread(target=write, args=(drive,)) for drive in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sums(StatisticsStore(path))["2026-11-25", "north"] == Totals(150.0, 150.0, 150.0, 150)


@pytest.mark.slow
def test_kill_while_storing_loses_at_most_what_was_not_yet_confirmed(path: Path) -> None:
    """15 kills: what was confirmed is there, and the columns of a row belong together."""
    confirmed = 0
    for trial in range(15):
        confirmed = int(lines_before_kill(STORING, path, 0.011 * trial)[-1])
        store = StatisticsStore(path)
        (found,) = store.by_day()
        store.close()
        k = found.totals.stops
        assert confirmed <= k <= confirmed + 1
        assert found.totals == Totals(10.0 * k, 1.0 * k, 2.0 * k, k)


def test_distance_and_stops_of_a_logged_drive_are_those_of_the_truth(log: Path) -> None:
    """Distance is that of the truth but for the last step that is not full, one stop for the person."""
    feed = LogFeed(log)
    text = read_metadata(log)["config"]["yaml"]
    state = PageState(scene_of(text, "log"), 0.1)
    feed.playback.seek(feed.playback.length_s)
    state.take(feed.now_ns, feed.poll())
    points = np.array([message.T_map_base[:2, 3] for message in _truth(log)])
    length_m = float(np.hypot(*np.diff(points[::4], axis=0).T).sum())
    assert length_m > 30.0
    assert state.distance_m == pytest.approx(length_m, abs=0.5)
    assert state.stops == 1


def _truth(path: Path) -> list[TrueMachine]:
    found = [decode(entry).message for entry in LogScan(path, ("truth_machine",)) if is_ours(entry)]
    return [message for message in found if isinstance(message, TrueMachine)]


def test_standing_adds_no_distance_and_stops_count_from_automatic_operation() -> None:
    state = PageState(demo_scene(), 0.25)

    def take(*messages: tuple[str, object]) -> None:
        state.take(0, [Envelope(topic, 0, 0, message) for topic, message in messages])  # type: ignore[arg-type]

    rng = np.random.default_rng(1)
    for _ in range(1000):
        take(("odom", odometry(*rng.uniform(-0.1, 0.1, 2))))
    assert state.distance_m == 0.0
    for x_m in np.arange(0.0, 100.0, 0.3):
        take(("odom", odometry(float(x_m), 0.0)))
    assert state.distance_m == pytest.approx(100.0, abs=0.6)
    take(("odom", odometry(np.nan, 0.0)))
    assert np.isfinite(state.distance_m)
    modes = (
        Mode.STANDBY, Mode.EMERGENCY_STOP, Mode.STANDBY, Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP,
        Mode.OBSTACLE_STOP, Mode.START_WARNING, Mode.AUTOMATIC, Mode.FAULT_STOP, Mode.STANDBY,
    )  # fmt: skip
    for k, mode in enumerate(modes):
        take(("supervisor", supervisor(mode, stamp_ns=k * SECOND_NS)))
    assert state.stops == 2
