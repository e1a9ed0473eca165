"""Stored missions: a folder of plain files each, complete or absent after kill -9."""

import fcntl
import math
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from configs.strict import Config, load
from hmi.plan_view.options import read_mission
from hmi.plan_view.progress import Progress, read_progress
from hmi.refusal import Refused
from messages.errors import HeadlandError

MISSION, FIELD, PLAN, ABOUT = "mission.yaml", "field", "plan.json", "about.yaml"
ID = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")
DRAFT, DELETED = ".draft-", ".deleted-"
SEED = 1  # of the planner: a stored mission is driven as it was planned
MAX_LISTED = 200
MAX_NAME = 80
READ_S = 1.0


class About(Config):
    """File `about.yaml` of a stored mission: its name, the field of its file, and who stored it."""

    name: str
    feature: str | None = None
    author: str


@dataclass(frozen=True)
class StoredMission:
    """A stored mission: its folder, and what `about.yaml` says of it; None for one that cannot be read."""

    id: str
    folder: Path
    about: About | None

    @property
    def field(self) -> Path:
        """Field file, or the folder of several."""
        return field_of(self.folder)

    @property
    def stored_at(self) -> str:
        """Date and time (UTC) of storing, which is the beginning of `id`."""
        day, clock = self.id[:8], self.id[9:15]
        return f"{day[:4]}-{day[4:6]}-{day[6:]} {clock[:2]}:{clock[2:4]} UTC"


class MissionStore:
    """Missions of `state/page/missions/`; a folder of a mission appears, and disappears, at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._locks: dict[Path, int] = {}
        self._listed: list[StoredMission] = []
        self._listed_ns = -1
        self._progress: dict[str, Progress] = {}
        self._progress_s = -math.inf

    def new_draft(self) -> Path:
        """New folder for a field and its plan, removed at the next start unless it is stored."""
        self._remove_left()
        draft = self.folder / f"{DRAFT}{secrets.token_hex(8)}"
        (draft / FIELD).mkdir(parents=True)
        self._locks[draft] = os.open(draft, os.O_RDONLY)
        fcntl.flock(self._locks[draft], fcntl.LOCK_EX | fcntl.LOCK_NB)
        return draft

    def remove_draft(self, draft: Path) -> None:
        """Removes a draft."""
        shutil.rmtree(draft, ignore_errors=True)
        self._unlock(draft)

    def store(self, draft: Path, name: str, feature: str | None, author: str) -> StoredMission:
        """A planned draft becomes a stored mission; raises HeadlandError. The draft is kept if that fails."""
        now = time.gmtime()
        about = About(name=name, feature=feature, author=author)
        mission_id = f"{time.strftime('%Y%m%d-%H%M%S', now)}-{secrets.token_hex(3)}"
        try:
            (draft / ABOUT).write_text(about.model_dump_json() + "\n", encoding="utf-8")  # JSON is YAML
            _synchronize([path for path in draft.rglob("*") if path.is_file()])
            draft.rename(self.folder / mission_id)
            _synchronize([self.folder])
        except OSError as error:
            raise HeadlandError(f"{self.folder}: cannot be written ({error.strerror or error})") from error
        self._unlock(draft)
        return StoredMission(mission_id, self.folder / mission_id, about)

    def all(self) -> list[StoredMission]:
        """Stored missions, the newest first."""
        if not self.folder.is_dir():
            return []
        changed_ns = self.folder.stat().st_mtime_ns
        if changed_ns != self._listed_ns:
            names = sorted((path.name for path in self.folder.iterdir() if ID.fullmatch(path.name)), reverse=True)
            self._listed, self._listed_ns = [self._read(name) for name in names[:MAX_LISTED]], changed_ns
        return self._listed

    def interrupted(self) -> dict[str, Progress]:
        """Progress of the missions that were interrupted, by id; read once in `READ_S`."""
        now_s = time.monotonic()
        if now_s - self._progress_s >= READ_S:
            self._progress_s, self._progress = now_s, {}
            for mission in self.all():
                with suppress(HeadlandError):
                    found = read_progress(mission.folder)
                    if found is not None and mission.about is not None:
                        self._progress[mission.id] = found
        return self._progress

    def find(self, mission_id: str) -> StoredMission:
        """A stored mission; raises HeadlandError for one that is not there."""
        path = self.folder / mission_id
        if not ID.fullmatch(mission_id) or path.is_symlink() or not path.is_dir():
            raise HeadlandError(f"mission {mission_id[:60]!r}: is not stored")
        return self._read(mission_id)

    def delete(self, mission_id: str) -> None:
        """Removes a stored mission; raises HeadlandError."""
        folder = self.find(mission_id).folder
        gone = self.folder / f"{DELETED}{secrets.token_hex(8)}"
        try:
            folder.rename(gone)
        except OSError as error:
            raise HeadlandError(f"{folder}: cannot be deleted ({error.strerror or error})") from error
        shutil.rmtree(gone, ignore_errors=True)

    def reopen(self, mission: StoredMission) -> Path:
        """Draft with the files of a stored mission; raises HeadlandError for one that is damaged."""
        if mission.about is None:
            raise Refused("damaged")
        draft = self.new_draft()
        try:
            shutil.copytree(mission.folder, draft, dirs_exist_ok=True)
        except (OSError, shutil.Error) as error:
            self.remove_draft(draft)
            raise HeadlandError(f"mission {mission.id}: cannot be read ({error})") from error
        return draft

    def _read(self, mission_id: str) -> StoredMission:
        folder, about = self.folder / mission_id, None
        with suppress(HeadlandError):
            read_mission(folder / MISSION)
            if (folder / PLAN).is_file() and field_of(folder).exists():
                about = load(About, folder / ABOUT)
        return StoredMission(mission_id, folder, about)

    def _remove_left(self) -> None:
        """Removes drafts and deleted missions that no process holds any more."""
        for path in [*self.folder.glob(f"{DRAFT}*"), *self.folder.glob(f"{DELETED}*")]:
            if path in self._locks:
                continue
            with suppress(OSError):
                lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(path)
                finally:
                    os.close(lock)

    def _unlock(self, draft: Path) -> None:
        if (lock := self._locks.pop(draft, None)) is not None:
            os.close(lock)


def field_of(folder: Path) -> Path:
    """The field file of a mission, or the folder of its files where there are several."""
    files = sorted((folder / FIELD).iterdir()) if (folder / FIELD).is_dir() else []
    return files[0] if len(files) == 1 else folder / FIELD


def plain_name(text: str, most: int = MAX_NAME) -> str:
    """Text on one line, of printable characters, at most `most`."""
    return "".join(c for c in " ".join(text.split()) if c.isprintable())[:most].strip()


def file_name(text: str) -> str:
    """Name for a file that a browser has sent: without folders, other than letters, digits, `.`, `-` and `_`."""
    name = re.sub(r"[^\w.-]", "_", text.replace("\\", "/").rpartition("/")[2])
    stem, dot, ending = name.rpartition(".")
    return (f"{stem[:40]}.{ending[:8]}" if dot else name[:40]).lstrip(".") or "field"


def _synchronize(paths: Iterable[Path]) -> None:
    """Writes files and folders to the disk."""
    for path in paths:
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
