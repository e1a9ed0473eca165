"""Diagnosis in a browser: history of alarms with acknowledgement, live topics, and files of the runs."""

import time
from collections.abc import Mapping
from html import escape
from typing import Any

from nicegui import ui
from nicegui.client import Client

from hmi.access import SERVICE, Session
from hmi.diagnosis.alarm_log import Alarm, AlarmLog, clock_text
from hmi.diagnosis.audit import audit_rows
from hmi.diagnosis.node_table import node_rows
from hmi.diagnosis.remedy import remedy
from hmi.diagnosis.self_test import SelfTest
from hmi.drive_view.alarms import LEVELS
from hmi.drive_view.row import number
from hmi.drive_view.standing import fault_text
from hmi.page_state import PageState
from hmi.parts import Moment, PageParts
from hmi.texts import Texts
from hmi.view import View
from messages.faults import Severity

ALARMS = ("began", "device", "cause", "remedy", "response", "ended", "count", "acknowledged")
AUDIT = ("order", "number")
SELF_TEST = ("control", "state")
BUS = ("direction", "identifier", "frame", "number", "values")
TOPICS = ("topic", "rate", "expected", "age", "state")
NODES = ("node", "steps", "mean", "longest")
RUNS = ("run", "command", "complete", "files")
SHOWN_ALARMS = 100


class DiagnosisPage(View):
    """Diagnosis view."""

    NAME = "diagnosis"
    _alarms: AlarmLog | None = None
    _state: PageState | None = None

    def __init__(self, parts: PageParts, client: Client, session: Session, token: str, texts: Texts) -> None:
        super().__init__(parts, client, session, token, texts)
        self._self_test = SelfTest()

    def build_main(self) -> None:
        """Builds the tables."""
        with ui.element("div").classes("hl-all"):
            with ui.element("section").classes("hl-card"):
                self.seat.build()
                ui.html(
                    '<p id="why" class="hl-note"></p><p id="answer" class="hl-answer" role="alert"></p>', sanitize=False
                )
            tables = [("alarm_log", ALARMS), ("audit", AUDIT), ("topics", TOPICS), ("nodes", NODES), ("runs", RUNS)]
            if self.session.role == SERVICE:
                tables.insert(3, ("bus", BUS))
            cards = "".join(self.table_card(name, columns) for name, columns in tables)
            ui.html(self._test_card() + cards, sanitize=False)

    def update(self, moment: Moment) -> None:
        """Sends what has changed."""
        self._alarms = moment.alarms
        barred = self.seat.update()
        self._step_test(moment.state)
        cannot_test = barred or ("" if self.parts.sender is not None else self.texts("why.no_key"))
        bus = {"tables.bus": self._bus(moment)} if self.session.role == SERVICE else {}
        entries = sorted(moment.alarms.entries, key=_urgency)[:SHOWN_ALARMS]
        self.send(moment, {
            "texts": {"why": barred, "answer": self.answer or self._unsent()},
            "tables.alarm_log": [self._alarm(one, barred) for one in entries],
            "tables.audit": audit_rows(moment.state, self.texts),
            "tables.topics": self._topics(moment),
            "tables.nodes": node_rows(moment.state),
            "tables.runs": self._runs(),
            "controls": {"self_test": {"off": bool(cannot_test)}},
            "tables.self_test": self._test_rows(),
        } | bus)  # fmt: skip

    async def act(self, action: str, values: Mapping[str, Any]) -> None:
        """Acknowledges an alarm, or begins the self-test of the controls."""
        if action == "self_test":
            self._self_test.begin()
        number_text = str(values.get("value", ""))
        if self._alarms is not None and action == "acknowledge" and number_text.isdecimal() and len(number_text) < 10:
            self._alarms.acknowledge(int(number_text), self.session.name)

    def _test_card(self) -> str:
        """Button and results of the self-test; that of the emergency stop is shown by its own process."""
        button = self.button("self_test", "diagnosis.self_test")
        note = f'<p class="hl-note">{escape(self.texts("diagnosis.self_test_note"))}</p>'
        return self.table_card("self_test", SELF_TEST, note + button)

    def _step_test(self, state: PageState) -> None:
        sender = self.parts.sender
        if sender is not None and not self.parts.is_switching:
            self._self_test.step(state, sender, self.parts.config.order_valid_s)

    def _test_rows(self) -> list[list[Any]]:
        texts, rows = self.texts, []
        for order, found in self._self_test.results.items():
            if found in ("", "accepted", "unanswered"):
                text = texts(f"self_test.{found or 'waits'}")
            else:
                text = texts("self_test.refused", reason=texts(f"refusal.{found}"))
            level = {"": "plain", "accepted": "good"}.get(found, "alarm")
            rows.append(
                [texts(f"order.{order}"), {"text": f"{texts(f'level.{level}')} {text}".strip(), "level": level}]
            )
        return rows

    def _bus(self, moment: Moment) -> list[list[Any]]:
        texts = self.texts
        return [
            [texts("bus.sent" if one.is_sent else "bus.received"), f"{one.identifier:08X}",
             one.name or texts("bus.unknown"), str(one.count), one.values]
            for one in moment.bus.rows()
        ]  # fmt: skip

    def _unsent(self) -> str:
        error = self.parts.notification_error
        return self.texts("diagnosis.unsent", error=error) if error else ""

    def _alarm(self, alarm: Alarm, barred: str) -> list[Any]:
        texts, fault = self.texts, alarm.fault
        level = LEVELS[fault.severity]
        ended: str = texts("alarm.active") if alarm.ended_s is None else clock_text(alarm.ended_s)
        latched = f" · {texts('alarm.latched')}" if fault.is_latched else ""
        response = fault.response.name.lower()
        seen: Any = alarm.acknowledged_by or {
            "text": texts("alarm.acknowledge"), "action": "acknowledge", "value": str(alarm.number), "off": bool(barred)
        }  # fmt: skip
        is_active = alarm.ended_s is None
        cause = f"{texts(f'level.{level}')} {fault_text(fault, texts)}".strip()
        return [
            clock_text(alarm.began_s), texts.named("source_name", fault.source),
            {"text": cause, "level": level if is_active else "plain"},
            remedy(fault.code, texts), f"{texts(f'response.{response}')}{latched}", ended, str(alarm.count), seen,
        ]  # fmt: skip

    def _topics(self, moment: Moment) -> list[list[Any]]:
        texts, rows = self.texts, []
        for one in moment.topics.rows(time.monotonic()):
            expected = "" if one.expected_hz is None else number(one.expected_hz, 1, "Hz")
            state = {
                "text": texts("topic.late" if one.is_late else "topic.current"),
                "level": "warning" if one.is_late else "good",
            }
            rows.append([one.topic, number(one.rate_hz, 1, "Hz"), expected, number(one.age_s, 1, "s"), state])
        return rows

    def _runs(self) -> list[list[Any]]:
        texts, rows = self.texts, []
        for run in self.parts.run_list():
            links = [
                {"text": f"{name} ({_size(size)})", "href": f"/runs/{run.name}/{name}"}
                for name, size in run.files.items()
            ]
            complete = texts("run.complete" if run.is_complete else "run.incomplete")
            rows.append([run.name, run.verb, complete, {"links": links}])
        return rows


def _urgency(alarm: Alarm) -> tuple[bool, bool, int]:
    """Order of the table: what waits to be acknowledged, what is active, then the newest."""
    waits = not alarm.acknowledged_by and alarm.fault.severity is Severity.ALARM
    return not waits, alarm.ended_s is not None, -alarm.number


def _size(size: int) -> str:
    return number(size / 1e6, 1, "MB") if size >= 100_000 else number(size / 1e3, 1, "kB")
