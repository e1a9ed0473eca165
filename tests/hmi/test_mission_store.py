"""Stored missions: plain files, complete or absent after kill -9, and nothing outside their folder."""

import os
from pathlib import Path

import pytest

from hmi.plan_view.mission_store import ABOUT, MISSION, PLAN, MissionStore, file_name, plain_name
from hmi.plan_view.options import read_mission
from messages.errors import HeadlandError
from tests.hmi.killed import lines_before_kill
from tests.hmi.planned import planned_draft

STORING = """
import sys
from pathlib import Path
from hmi.plan_view.mission_store import MissionStore
from tests.hmi.planned import planned_draft
store = MissionStore(Path(sys.argv[1]))
for k in range(10_000):
    mission = store.store(planned_draft(store, "x" * 100_000), f"mission {k}", None, "anna")
    print(mission.id, flush=True)
    if k % 3 == 2:
        store.delete(mission.id)
        print("-" + mission.id, flush=True)
"""


@pytest.fixture
def store(tmp_path: Path) -> MissionStore:
    return MissionStore(tmp_path / "missions")


def test_a_stored_mission_has_its_files_and_what_was_said_of_it(store: MissionStore) -> None:
    stored = store.store(planned_draft(store), "north", "2.1", "anna")
    (found,) = store.all()
    assert found == stored
    assert found.about is not None
    assert (found.about.name, found.about.feature, found.about.author) == ("north", "2.1", "anna")
    assert found.field.read_text() == "field"
    assert read_mission(found.folder / MISSION)[0].name == "north"
    assert [path.name for path in store.folder.iterdir()] == [found.id]


def test_the_newest_is_first_and_a_change_of_the_folder_is_seen(store: MissionStore) -> None:
    first = store.store(planned_draft(store), "first", None, "anna")
    os.rename(first.folder, store.folder / "20200101-000000-abcdef")
    second = store.store(planned_draft(store), "second", None, "anna")
    assert [one.id for one in store.all()] == [second.id, "20200101-000000-abcdef"]
    assert store.all()[1].stored_at == "2020-01-01 00:00 UTC"
    store.delete(second.id)
    assert len(store.all()) == 1


def test_a_deleted_mission_is_gone_for_good(store: MissionStore) -> None:
    stored = store.store(planned_draft(store), "north", None, "anna")
    store.delete(stored.id)
    assert list(store.folder.iterdir()) == store.all() == []
    with pytest.raises(HeadlandError, match="not stored"):
        store.delete(stored.id)


@pytest.mark.parametrize(
    "name", ["", "..", "../x", "/etc", "20200101-000000-abcdef/..", ".draft-1", "a\0b", "x" * 9999]
)
def test_other_names_than_those_of_missions_are_refused(store: MissionStore, name: str) -> None:
    store.store(planned_draft(store), "north", None, "anna")
    for action in (store.find, store.delete):
        with pytest.raises(HeadlandError, match="not stored"):
            action(name)
    assert len(store.all()) == 1


def test_a_link_is_not_followed(store: MissionStore, tmp_path: Path) -> None:
    store.store(planned_draft(store), "north", None, "anna")
    (tmp_path / "precious").mkdir()
    (store.folder / "20200101-000000-abcdef").symlink_to(tmp_path / "precious")
    with pytest.raises(HeadlandError, match="not stored"):
        store.delete("20200101-000000-abcdef")
    assert (tmp_path / "precious").is_dir()


@pytest.mark.parametrize(
    ("broken", "content"),
    [(PLAN, None), *((name, text) for name in (MISSION, ABOUT) for text in (None, "", "{", "name: [1", "\0", "{}"))],
)
def test_a_damaged_mission_is_listed_and_only_deleted(store: MissionStore, broken: str, content: str | None) -> None:
    stored = store.store(planned_draft(store), "north", None, "anna")
    if content is None:
        (stored.folder / broken).unlink()
    else:
        (stored.folder / broken).write_text(content)
    (found,) = MissionStore(store.folder).all()
    assert found.about is None
    with pytest.raises(HeadlandError, match="damaged"):
        store.reopen(found)
    store.delete(found.id)
    assert store.all() == []


def test_drafts_that_nobody_holds_are_removed_at_the_next_start(store: MissionStore) -> None:
    held = planned_draft(store)
    left = store.folder / ".draft-of-a-killed-page"
    (left / "field").mkdir(parents=True)
    other = MissionStore(store.folder)
    draft = other.new_draft()
    assert held.is_dir()
    assert draft.is_dir()
    assert not left.exists()


def test_a_full_disk_keeps_the_draft(store: MissionStore, monkeypatch: pytest.MonkeyPatch) -> None:
    draft = planned_draft(store)

    def fail(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(HeadlandError, match="cannot be written \\(No space left"):
        store.store(draft, "north", None, "anna")
    assert draft.is_dir()
    assert store.all() == []


@pytest.mark.slow
def test_kill_during_store_and_delete_leaves_complete_missions_or_none(store: MissionStore) -> None:
    """12 kills at different moments: what was reported as stored is there, and what is listed is complete."""
    stored: set[str] = set()
    for trial in range(12):
        for line in lines_before_kill(STORING, store.folder, 0.013 * trial):
            stored.discard(line[1:]) if line.startswith("-") else stored.add(line)
        listed = MissionStore(store.folder).all()
        assert all(one.about is not None for one in listed)
        missing = stored - {one.id for one in listed}
        assert len(missing) <= 1  # the one that was being deleted
        stored -= missing
    MissionStore(store.folder).new_draft()
    assert len([path for path in store.folder.iterdir() if path.name.startswith(".")]) == 1


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("field.shp", "field.shp"), ("../../etc/passwd", "passwd"), ("..\\..\\boot.ini", "boot.ini"), ("..", "field"),
        ("", "field"), ("a\0b.kml", "a_b.kml"), (".hidden", "hidden"), ("田块 1.geojson", "田块_1.geojson"),
        ("<img src=x>.kml", "_img_src_x_.kml"), ("x" * 5000 + ".geojson", "x" * 40 + ".geojson"),
        ("田" * 500 + "." + "块" * 500, "田" * 40 + "." + "块" * 8),
    ],
)  # fmt: skip
def test_names_of_sent_files(sent: str, kept: str) -> None:
    assert file_name(sent) == kept
    assert len(kept.encode()) < 255


def test_names_of_missions_are_one_short_line() -> None:
    assert plain_name(" a\n\tb\x00\u202ec ") == "a bc"
    assert len(plain_name("x" * 1000)) == 80
