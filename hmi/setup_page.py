"""Setup in a browser: vehicle, implement, mounts, corrections and work mode, and the versions that were stored."""

from collections.abc import Mapping
from typing import Any

from nicegui import ui

from hmi.access import SETTERS
from hmi.drive_view.controls import check_standing
from hmi.parts import Moment
from hmi.refusal import Refused
from hmi.setup_view.desk import SetupDesk
from hmi.setup_view.settings import MOUNTS, SECTIONS, mounts_of, settings_of, shown_text, unit_of
from hmi.view import View

SETTINGS = ("setting", "value", "unit")
AXES = ("sensor", "x", "y", "z", "roll", "pitch", "yaw")
VERSIONS = ("version", "stored_at", "author", "note", "state", "")
MAX_VALUE = 200  # characters


class SetupPage(View):
    """Setup view; what it shows is the state of the desk, which all pages share."""

    NAME = "setup"
    _section = SECTIONS[0]
    _moment: Moment | None = None

    def build_main(self) -> None:
        """Builds the tables and the controls."""
        with ui.element("div").classes("hl-all"):
            with ui.element("section").classes("hl-card"):
                self.seat.build()
                ui.html(
                    '<p id="why" class="hl-note"></p><p id="answer" class="hl-answer" role="alert"></p>'
                    '<p id="used" class="hl-answer" role="status"></p>' + self._controls_html(), sanitize=False
                )  # fmt: skip
            cards = self.card("settings", self.select("section", "setup.section") + self._table("settings", SETTINGS))
            cards += self.table_card(MOUNTS, AXES) + self.table_card("versions", VERSIONS)
            ui.html(cards, sanitize=False)

    def _controls_html(self) -> str:
        note = f'<label>{self.texts("setup.note")}<input id="note" maxlength="80" autocomplete="off"></label>'
        store = self.button("store", "setup.store", " hl-go", taken_from="note")
        return (
            f'{note}<div class="hl-pair">{store}{self.button("discard", "setup.discard")}'
            f"{self.button('apply', 'setup.apply')}</div>"
        )

    def _table(self, name: str, columns: tuple[str, ...]) -> str:
        """Table without a card of its own."""
        card = self.table_card(name, columns)
        return card[card.index("</h2>") + 5 : card.rindex("</section>")]

    def update(self, moment: Moment) -> None:
        """Sends what has changed."""
        self._moment = moment
        desk, barred = self.parts.setup, self._why_not()
        if desk is None:
            self.send(moment, {
                "texts": {"why": barred, "answer": "", "used": ""}, "tables.settings": [], f"tables.{MOUNTS}": [],
                "tables.versions": [], "controls": self._controls(None, barred),
            })  # fmt: skip
            return
        self.send(moment, {
            "texts": {"why": barred, "answer": self.answer or moment.drive_error, "used": self._state(desk)},
            "tables.settings": self._settings(desk, barred),
            f"tables.{MOUNTS}": self._mounts(desk, barred),
            "tables.versions": self._versions(desk, barred),
            "controls": self._controls(desk, barred),
        })  # fmt: skip

    async def act(self, action: str, values: Mapping[str, Any]) -> None:
        """Changes the desk."""
        value, key = values.get("value"), values.get("key")
        value = value[:MAX_VALUE] if isinstance(value, str) else ""
        key = key[:MAX_VALUE] if isinstance(key, str) else ""
        desk = self.parts.setup
        if action == "section":
            self._section = value if value in SECTIONS else self._section
            return
        if desk is None:
            raise Refused("no_machine")
        if self.session.role not in SETTERS:
            raise Refused("no_role")
        match action:
            case "edit":
                desk.edit(key, value)
            case "discard":
                desk.discard()
            case "open" if value.isdecimal() and len(value) < 10:
                desk.open(int(value))
            case "store":
                desk.keep(self.session.name, value)
            case "apply" if self.is_sure("apply"):
                self._apply(desk)

    def _apply(self, desk: SetupDesk) -> None:
        """Begins the drive once more with the newest version, at standstill alone."""
        if self.parts.drives is None or self._moment is None:
            raise Refused("no_simulation")
        check_standing(self._moment.state)
        if desk.used == desk.newest:
            raise Refused("no_change")
        self.parts.drives.restart()
        self.parts.is_switching = True

    def _why_not(self) -> str:
        barred = self.seat.update()
        if self.parts.setup is None:
            return self.texts("why.replay")
        return barred or ("" if self.session.role in SETTERS else self.texts("refused.no_role"))

    def _state(self, desk: SetupDesk) -> str:
        """Machine, and whether it drives with the newest version."""
        texts = self.texts
        used = texts("setup.used_other") if desk.used is None else texts("setup.used", number=desk.used)
        waits = texts("setup.waits", number=desk.newest) if desk.used not in (None, desk.newest) else ""
        shown = "" if desk.shown == desk.newest else texts("setup.shows_old", number=desk.shown)
        return f"{desk.machine}. " + " ".join(one for one in (used, waits, shown) if one)

    def _settings(self, desk: SetupDesk, barred: str) -> list[list[Any]]:
        rows = []
        for key, value in settings_of(desk.draft, self._section).items():
            name = self.texts.named("setting", key.partition(".")[2].replace(".", "_"))
            rows.append([name, self._cell(desk, key, value, name, barred), unit_of(key)])
        return rows

    def _mounts(self, desk: SetupDesk, barred: str) -> list[list[Any]]:
        rows = []
        for sensor, axes in mounts_of(desk.draft).items():
            name = self.sensor_name(sensor)
            cells = zip(AXES[1:], axes, strict=True)
            rows.append(
                [
                    name,
                    *(
                        self._cell(desk, k, v, f"{name}, {self.texts(f'column.{axis}')}", barred)
                        for axis, (k, v) in cells
                    ),
                ]
            )
        return rows

    def _cell(self, desk: SetupDesk, key: str, value: Any, label: str, barred: str) -> dict[str, Any]:
        cell = {
            "input": shown_text(value), "key": key, "label": label, "off": bool(barred),
            "level": "warning" if key in desk.changes else "",
        }  # fmt: skip
        if isinstance(value, bool):
            cell["choices"] = [[one, self.texts(f"setup.{one}")] for one in ("yes", "no")]
        return cell

    def _versions(self, desk: SetupDesk, barred: str) -> list[list[Any]]:
        rows = []
        for one in desk.versions:
            state = [self.texts("setup.in_use")] if one.number == desk.used else []
            state += [self.texts("setup.shown")] if one.number == desk.shown else []
            author = self.texts("setup.files") if one.author == "configs" else one.author
            button = {"text": self.texts("setup.open"), "action": "open", "value": str(one.number), "off": bool(barred)}
            rows.append([str(one.number), one.stored_at, author, one.note, " · ".join(state), button])
        return rows

    def _controls(self, desk: SetupDesk | None, barred: str) -> dict[str, Any]:
        off, asks = bool(barred), self.asks("apply")
        is_old = desk is not None and desk.shown != desk.newest
        is_new = not off and desk is not None and (is_old or bool(desk.changes))
        waits = desk is not None and desk.used not in (None, desk.newest) and self.parts.drives is not None
        store = self.texts("setup.restore" if is_old else "setup.store")
        apply = self.texts("plan.sure" if asks else "setup.apply")
        return {
            "section": {"value": self._section, "choices": [[one, self.texts(f"setup.{one}")] for one in SECTIONS]},
            "note": {"off": not is_new},
            "store": {"off": not is_new, "text": store},
            "discard": {"off": not is_new},
            "apply": {"off": off or not waits, "text": apply, "sure": asks},
        }
