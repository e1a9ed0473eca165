"""Desk of the setup: a draft that the operator in control changes, and the versions of the shown machine."""

from configs.machine_setup import MachineSetup, leaves, with_values
from configs.mission import Work
from hmi.plan_view.mission_store import plain_name
from hmi.refusal import Refused
from hmi.setup_view.settings import section_of, value_from
from hmi.setup_view.store import SetupStore, SetupVersion


class SetupDesk:
    """Setup of one machine; it drives with `in_use`, which is version `used`, None for one that was started elsewhere.

    Every change raises HeadlandError with the reason for which it is not possible.
    """

    def __init__(self, store: SetupStore, in_use: MachineSetup, used: int | None) -> None:
        self.store = store
        self.show(in_use, used)

    def show(self, in_use: MachineSetup, used: int | None) -> None:
        """Shows another machine, without the draft of the one before."""
        self.in_use, self.used, self.machine = in_use, used, in_use.machine
        self.draft = in_use
        if used is None:
            self.store.newest(in_use)
        self.versions: list[SetupVersion] = self.store.versions(self.machine)
        self.open(self.newest)

    def work(self) -> Work:
        """Work mode of the newest version; raises HeadlandError."""
        return self.store.setup(self.machine, self.newest).work

    @property
    def newest(self) -> int:
        """Number of the newest version."""
        return self.versions[0].number

    @property
    def changes(self) -> dict[str, tuple[object, object]]:
        """Value of the shown version and of the draft, by key, where they differ."""
        draft = leaves(self.draft)
        return {key: (old, draft.get(key)) for key, old in self._shown_leaves.items() if draft.get(key) != old}

    def edit(self, key: str, text: str) -> None:
        """Changes a value of the draft, which stays valid."""
        before = leaves(self.draft)
        if key not in before or not section_of(key):
            raise Refused("no_setting", name=key[:80])
        self.draft = with_values(self.draft, {key: value_from(key, text, before[key])})

    def discard(self) -> None:
        """Draft as the newest version."""
        self.open(self.newest)

    def open(self, number: int) -> None:
        """Shows a version; what was not stored is dropped."""
        self.draft, self.shown = self.store.setup(self.machine, number), number
        self.versions = self.store.versions(self.machine)
        self._shown_leaves = leaves(self.draft)

    def keep(self, author: str, note: str) -> int:
        """Stores the draft as the newest version: a change, or an older version that is shown; its number."""
        if not self.changes and self.shown == self.newest:
            raise Refused("no_change")
        note = plain_name(note) or ", ".join(self.changes)[:200]
        if self.shown != self.newest:
            note = f"{self.shown} → {note}" if note else f"{self.shown} →"
        return self._put(self.draft, author, note)

    def put_calibrated(self, values: dict[str, float], author: str, note: str) -> int:
        """Stores the newest version with calibrated values; its number. A draft is not part of it."""
        newest = self.store.setup(self.machine, self.newest)
        return self._put(with_values(newest, dict(values)), author, note)

    def _put(self, setup: MachineSetup, author: str, note: str) -> int:
        number = self.store.put(setup, author, note)
        self.open(number)
        return number
