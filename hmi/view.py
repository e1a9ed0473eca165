"""Base of the views: head with navigation, emergency stop, events of the browser, and sections that have changed."""

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from html import escape
from types import MappingProxyType
from typing import Any, ClassVar

from nicegui import ui
from nicegui.client import Client
from nicegui.events import GenericEventArguments

from hmi.access import Session
from hmi.diagnosis.alarm_log import AlarmLog
from hmi.drive_view.standing import fault_text
from hmi.log_in import stop_frame
from hmi.parts import Moment, PageParts
from hmi.refusal import Refused
from hmi.seat_bar import SeatBar
from hmi.texts import Texts
from messages.errors import HeadlandError

VIEWS = {
    "drive": "/", "plan": "/plan", "setup": "/setup", "calibration": "/calibration", "diagnosis": "/diagnosis",
    "statistics": "/statistics",
}  # fmt: skip
MAX_ANSWER = 500
SURE_S = 5.0  # within which a press has to be repeated


class View(ABC):
    """One open page in a browser."""

    NAME: ClassVar[str]

    def __init__(self, parts: PageParts, client: Client, session: Session, token: str, texts: Texts) -> None:
        self.parts, self.client, self.session, self.texts = parts, client, session, texts
        self.seat = SeatBar(parts.access, session, token, texts)
        self._sent: dict[str, str] = {}
        self._sure, self._sure_until_s = "", 0.0
        self._answer = ""

    def build(self) -> None:
        """Builds the page."""
        ui.html(self._head(), sanitize=False)
        lost = escape(self.texts("page.lost"))
        ui.html(f'<div id="lost" class="hl-lost" role="alert" hidden>{lost}</div>', sanitize=False)
        ui.html('<div id="light" class="hl-light" role="alert" hidden></div>', sanitize=False)
        with ui.element("main").classes(f"hl-main hl-view-{self.NAME}"):
            self.build_main()
        ui.html(stop_frame(self.parts.stop_url, self.texts), sanitize=False)
        self.client.layout.on("headland", self._take)

    @abstractmethod
    def build_main(self) -> None:
        """Builds what is between head and emergency stop."""

    @abstractmethod
    def update(self, moment: Moment) -> None:
        """Shows a moment."""

    async def act(self, action: str, values: Mapping[str, Any]) -> None:  # noqa: B027  a view may have no controls
        """Does what a control of the browser asks for, after the checks of session and seat; raises HeadlandError."""

    def watch(self, pane: str) -> None:  # noqa: B027  a view may have none
        """Shows another pane, for whoever may see the page."""

    @property
    def watched(self) -> frozenset[str]:
        """Topics of scans and images that the page shows."""
        return frozenset()

    def send(self, moment: Moment, sections: dict[str, Any], news: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Sends the sections that have changed, and `news`; an empty update shows the browser that the page lives."""
        changes: dict[str, Any] = dict(news)
        for name, value in (sections | self._signals(moment.alarms)).items():
            text = json.dumps(value)
            if self._sent.get(name) != text:
                self._sent[name] = text
                group, dot, key = name.partition(".")
                if dot:
                    changes.setdefault(group, {})[key] = value
                else:
                    changes[name] = value
        self.client.run_javascript(f"headland.update({json.dumps(changes, ensure_ascii=False)})")

    def _signals(self, alarms: AlarmLog) -> dict[str, Any]:
        """Sound and flashing text of what waits to be acknowledged; none in a replay."""
        if self.parts.drive.feed.playback is not None:
            return {}
        waiting = alarms.waiting
        return {"sound": alarms.sound_number, "light": fault_text(waiting.fault, self.texts) if waiting else ""}

    def is_sure(self, key: str) -> bool:
        """Whether this press of a control repeats the one before it within `SURE_S`."""
        is_second = self.asks(key)
        self._sure, self._sure_until_s = ("", 0.0) if is_second else (key, time.monotonic() + SURE_S)
        return is_second

    def asks(self, key: str) -> bool:
        """Whether a control waits for the second press."""
        return self._sure == key and time.monotonic() <= self._sure_until_s

    def say(self, error: HeadlandError) -> None:
        """Shows why something was not done."""
        if isinstance(error, Refused):
            self._answer = self.texts(f"refused.{error.key}", **error.values)
        else:
            self._answer = str(error)[:MAX_ANSWER]
        for name in [one for one in self._sent if one == "controls" or one.startswith("tables.")]:
            del self._sent[name]  # a control shows what the browser has chosen

    @property
    def answer(self) -> str:
        """Why the last request was not done, "" if it was."""
        return self._answer

    async def _take(self, event: GenericEventArguments) -> None:
        """An event of the browser: of an operator in control, or it has no effect."""
        values = event.args
        if not isinstance(values, dict) or not isinstance(values.get("action"), str):
            return
        if values["action"] == "watch":
            self.watch(str(values.get("value")))
            return
        if values["action"] == "present":
            if not self.seat.why_not():
                self.parts.present_s = time.monotonic()
            return
        self._answer = self.seat.why_not(is_action=True)
        if self._answer:
            return
        try:
            await self.act(values["action"], values)
        except HeadlandError as error:
            self.say(error)

    def card(self, name: str, content: str, more: str = "") -> str:
        """Card with a title."""
        title = escape(self.texts(f"section_title.{name}"))
        return f'<section class="hl-card{more}"><h2>{title}</h2>{content}</section>'

    def rows_card(self, name: str, more: str = "") -> str:
        """Card with labelled values, which are sent under `rows.NAME`."""
        live = ' role="log" aria-live="polite"' if name == "alarms" else ""
        return self.card(name, f'<dl class="hl-rows" id="rows-{name}"{live}></dl>', more)

    def table_card(self, name: str, columns: tuple[str, ...], before: str = "") -> str:
        """Card with a table below `before`, its rows are sent under `tables.NAME`."""
        heads = "".join(f'<th scope="col">{escape(self.texts(f"column.{one}") if one else "")}</th>' for one in columns)
        empty = escape(self.texts(f"empty.{name}"))
        return self.card(
            name,
            f'{before}<div class="hl-scroll">'
            f'<table id="table-{name}"><thead><tr>{heads}</tr></thead><tbody></tbody></table>'
            "</div>"
            f'<p id="empty-{name}">{empty}</p>',
        )

    def button(self, action: str, text: str, more: str = "", taken_from: str = "") -> str:
        """Button that sends an action, with the values of the inputs `taken_from`; until the first update it is off."""
        source = f' data-from="{taken_from}"' if taken_from else ""
        return (
            f'<button type="button" id="{action}" data-action="{action}"{source} class="hl-primary{more}" disabled>'
            f"{escape(self.texts(text))}</button>"
        )

    def select(self, name: str, label: str) -> str:
        """Selection whose change is the action `name`."""
        return f'<label>{escape(self.texts(label))}<select id="{name}" data-change="{name}"></select></label>'

    def sensor_name(self, key: str) -> str:
        """Name of a sensor by its key in the setup, such as `vehicle.sensors.lidar.front`."""
        kind, _, name = key.partition(".sensors.")[2].partition(".")
        return f"{self.texts.named('sensor_kind', kind)} {self.texts.named('place', name)}".strip()

    def map_card(self, tools: tuple[str, ...], content: str) -> str:
        """Canvas of the map with its tools."""
        texts, signs = self.texts, {"smaller": "−", "larger": "+"}
        buttons = "".join(
            f'<button id="map-{name}" type="button" aria-label="{escape(texts(f"map.{name}"))}">'
            f"{escape(signs.get(name) or texts(f'map.{name}'))}</button>"
            for name in tools
        )
        return (
            f'<div id="map-pane" class="hl-canvas">'
            f'<canvas id="map" role="img" aria-label="{escape(texts("map.label"))}"></canvas>'
            f'{content}<div class="hl-map-tools">{buttons}</div></div>'
        )

    def _head(self) -> str:
        texts, session = self.texts, self.session
        user = texts("page.user", name=session.name, role=texts(f"role.{session.role}"))
        other = "en" if texts.language == "zh" else "zh"
        on, off = escape(texts("sound.on")), escape(texts("sound.off"))
        links = "".join(
            f'<a href="{path}?lang={texts.language}"{" aria-current=page" if name == self.NAME else ""}>'
            f"{escape(texts(f'view.{name}'))}</a>"
            for name, path in VIEWS.items()
        )
        return (
            f'<header class="hl-head"><h1>{escape(texts("page.title"))}</h1>'
            f"<span>{escape(texts(f'page.{self.parts.source}'))}</span>"
            f'<nav aria-label="{escape(texts("view.label"))}">{links}</nav><span class="hl-grow"></span>'
            f'<span class="hl-user">{escape(user)}</span>'
            f'<button id="sound" type="button" data-on="{on}" data-off="{off}">{on}</button>'
            f'<a id="language" href="{VIEWS[self.NAME]}?lang={other}">{escape(texts("page.language"))}</a>'
            f'<form method="post" action="/log-out?lang={texts.language}"><button id="log-out" type="submit">'
            f"{escape(texts('page.log_out'))}</button></form></header>"
        )
