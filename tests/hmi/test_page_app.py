"""One update of the application: a drive follows another, its totals and alarms remain, errors are shown."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hmi.access import Access
from hmi.app import PageApp
from hmi.feed import Feed
from hmi.parts import Drive, Drives, PageParts
from hmi.plan_view.mission_store import StoredMission
from hmi.plan_view.progress import Progress
from hmi.statistics.store import StatisticsStore, Totals
from messages.errors import HeadlandError
from messages.message import Envelope, Message
from tests.hmi.drive_messages import demo_scene, fault, odometry
from tests.hmi.planned import desk_in
from tests.hmi.test_files import CONFIG, SESSION


class GivenFeed(Feed):
    """Feed of the messages that a test has given."""

    def __init__(self) -> None:
        super().__init__()
        self.given: list[tuple[str, Message]] = []

    def poll(self) -> list[Envelope]:
        found, self.given = self.given, []
        self.counts.update(topic for topic, _ in found)
        return [Envelope(topic, 0, 0, message) for topic, message in found]


class GivenDrives(Drives):
    """Drives that a test has given."""

    next: Drive | str | None = None

    def start(self, mission: StoredMission, progress: Progress | None = None) -> None:
        raise NotImplementedError

    def restart(self) -> None:
        raise NotImplementedError

    def start_trial(self) -> None:
        raise NotImplementedError

    def take(self) -> Drive | str | None:
        found, self.next = self.next, None
        return found


@pytest.fixture
def app(tmp_path: Path) -> Iterator[PageApp]:
    store = StatisticsStore(tmp_path / "statistics.db")
    parts = PageParts(
        Drive(GivenFeed(), demo_scene(), "first"), CONFIG, Access(SESSION, {}), None, None, "simulation", str,
        desk_in(tmp_path), tmp_path / "runs", store, GivenDrives(),
    )  # fmt: skip
    yield PageApp(parts)
    store.close()


def move(app: PageApp, length_m: int) -> None:
    """Gives the feed a straight way from the origin."""
    feed = app.parts.drive.feed
    assert isinstance(feed, GivenFeed)
    feed.given += [("odom", odometry(float(x_m), 0.0)) for x_m in range(length_m + 1)]


def distances(app: PageApp) -> float:
    assert app.parts.statistics is not None
    return sum(one.totals.distance_m for one in app.parts.statistics.by_day())


def test_a_drive_that_follows_keeps_totals_and_alarms_of_the_one_before(app: PageApp) -> None:
    move(app, 10)
    app.step()
    assert distances(app) == pytest.approx(10.0)
    app.parts.drive.feed.given.append(("fault/supervisor", fault(True)))  # type: ignore[attr-defined]
    move(app, 4)  # back to the origin at once, and on: less than a second after the last transaction
    app.step()
    total_m = app.state.distance_m
    drives = app.parts.drives
    assert isinstance(drives, GivenDrives)
    drives.next = Drive(GivenFeed(), demo_scene(), "second")
    app.step()
    assert app.parts.drive.name == "second"
    assert distances(app) == pytest.approx(total_m)
    assert app.state.distance_m == 0.0
    assert app.state.faults == {}
    (alarm,) = app.alarms.entries
    assert alarm.ended_s is not None
    assert app.topics.rows(0.0) == []


def test_a_drive_that_ends_by_itself_is_reported(app: PageApp) -> None:
    assert isinstance(app.parts.drives, GivenDrives)
    app.parts.drives.next = "the simulation has ended (exit code 1)"
    app.step()
    assert app.parts.drive.name == "first"
    assert app._drive_error == "the simulation has ended (exit code 1)"


def test_statistics_that_cannot_be_stored_are_reported_and_stored_later(
    app: PageApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: StatisticsStore, drive: str, day: str, field: str, totals: Totals) -> None:
        raise HeadlandError("statistics cannot be stored (disk full)")

    with monkeypatch.context() as patch:
        patch.setattr(StatisticsStore, "put", fail)
        move(app, 10)
        app.step()
    assert "disk full" in app.parts.statistics_error
    app.store_statistics()
    assert app.parts.statistics_error == ""
    assert distances(app) == pytest.approx(10.0)
