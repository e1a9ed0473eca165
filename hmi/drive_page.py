"""Drive view in a browser: layout, controls, and the sections that have changed since the last update."""

import json
import time
from dataclasses import dataclass, field
from html import escape
from typing import Any

from nicegui import ui
from nicegui.client import Client

from hmi.access import Session
from hmi.config import PageConfig
from hmi.drive_view.controls import ORDERS
from hmi.drive_view.map_view import static_map
from hmi.log_in import stop_frame
from hmi.orders import OrderSender, SentOrder, outcome
from hmi.page_state import PageState
from hmi.replay_bar import ReplayBar
from hmi.seat_bar import SeatBar
from hmi.shown import ROWS
from hmi.texts import Texts
from messages.command import OrderStatus

SURE_S = 5.0  # within which the release of a stop is pressed a second time
ANSWER_SHOWN_S = 6.0
GO = ("start", "resume")
SECTIONS_BESIDE = ("motion", "work", "alarms", "obstacles", "position", "sensors", "machine")


@dataclass
class DrivePage:
    """One open page; `why_barred` is the key of the reason for which this page gives no orders, "" if it may."""

    client: Client
    session: Session
    texts: Texts
    config: PageConfig
    sender: OrderSender | None
    why_barred: str
    state: PageState
    _sent_sections: dict[str, str] = field(default_factory=dict)
    _sent_points: tuple[int, int] = (0, 0)
    _buttons: dict[str, tuple[ui.button, ui.label]] = field(default_factory=dict)
    _order: SentOrder | None = None
    _answer_s: float = 0.0
    _sure_until_s: float = 0.0

    def build(self, seat: SeatBar, replay: ReplayBar | None, source: str, stop_url: str | None) -> None:
        """Builds the layout."""
        self._seat, self._replay = seat, replay
        texts = self.texts
        ui.html(self._head(source), sanitize=False)
        ui.html(
            f'<div id="lost" class="hl-lost" role="alert" hidden>{escape(texts("page.lost"))}</div>', sanitize=False
        )
        with ui.element("main").classes("hl-main"):
            with ui.element("div").classes("hl-act"):
                ui.html(self._state_card(), sanitize=False)
                self._build_orders()
            with ui.element("div").classes("hl-map"):
                ui.html(self._map_card(), sanitize=False)
                if replay is not None:
                    replay.build()
            cards = "".join(self._rows_card(name) for name in SECTIONS_BESIDE)
            ui.html(cards, sanitize=False).classes("hl-info")
        ui.html(stop_frame(stop_url, texts), sanitize=False)

    def update(self, shown: dict[str, Any], state: PageState, is_restarted: bool) -> None:
        """Sends the sections that have changed, and sets the controls."""
        changes: dict[str, Any] = self._changes(shown)
        if is_restarted or state is not self.state:
            self.state, self._sent_points = state, (0, 0)
            changes["clear"] = True
        changes |= self._new_points(state)
        self.client.run_javascript(f"headland.update({json.dumps(changes, ensure_ascii=False)})")
        if not self.why_barred:
            self._set_controls(shown["unavailable"], self._seat.update(), state)
        if self._replay is not None:
            self._replay.update()

    def _changes(self, shown: dict[str, Any]) -> dict[str, Any]:
        """Sections that differ from what was sent; rows are together under one key."""
        changes: dict[str, Any] = {}
        if not self._sent_sections:
            changes["still"] = static_map(self.state.scene)
        for name, value in shown.items():
            text = json.dumps(value)
            if name == "unavailable" or self._sent_sections.get(name) == text:
                continue
            self._sent_sections[name] = text
            if name in ROWS:
                changes.setdefault("rows", {})[name] = value
            else:
                changes[name] = value
        return changes

    def _new_points(self, state: PageState) -> dict[str, Any]:
        """Points of track and worked area since the last update."""
        trail, edges = state.trail.points, state.coverage.edges
        sent_trail, sent_edges = self._sent_points
        self._sent_points = len(trail), len(edges)
        found = {"trail": trail[sent_trail:], "edges": edges[sent_edges:]}
        return {name: points for name, points in found.items() if points}

    def _build_orders(self) -> None:
        with ui.element("section").classes("hl-card"):
            ui.html(f"<h2>{escape(self.texts('section_title.controls'))}</h2>", sanitize=False)
            if self.why_barred:
                ui.label(self.texts(f"why.{self.why_barred}")).props('data-hl="barred"')
                return
            self._seat.build()
            with ui.element("div").classes("hl-orders"):
                for order in ORDERS:
                    self._build_order(order)
            self._answer = ui.label("").classes("hl-answer").props('role="status" data-hl="answer"')

    def _build_order(self, order: str) -> None:
        with ui.element("div").classes("hl-order"):
            button = ui.button(self.texts(f"order.{order}"), on_click=lambda: self._press(order), color=None)
            button.classes("hl-button" + (" hl-go" if order in GO else ""))
            note = ui.label("").classes("hl-note").props(f'data-hl="why-{order}"')
            button.props(f'unelevated no-caps data-hl="order-{order}" aria-describedby="{note.html_id}"')
        self._buttons[order] = button, note

    def _press(self, order: str) -> None:
        """Sends an order; the release of a stop at the second press."""
        if self._seat.why_not(is_action=True):
            return
        if order == "reset" and time.monotonic() > self._sure_until_s:
            self._sure_until_s = time.monotonic() + SURE_S
            return
        self._sure_until_s = 0.0
        status = self.state.fresh("order_status", OrderStatus)
        if self.sender is None or status is None:
            return
        valid_s = self.config.confirmation_valid_s if order == "confirm_clear" else self.config.order_valid_s
        self._order = self.sender.send(order, status, self.state.now_ns, valid_s)
        self._answer_s = time.monotonic()
        self._answer.set_text(self.texts("order.sent", order=self.texts(f"order.{order}")))

    def _set_controls(self, unavailable: dict[str, str], barred: str, state: PageState) -> None:
        is_sure = time.monotonic() <= self._sure_until_s
        for order, (button, note) in self._buttons.items():
            why = barred or unavailable.get(order, "")
            if button.enabled != (not why):
                button.set_enabled(not why)
            note.set_text(why)
            if order == "reset":
                button.set_text(self.texts("order.sure" if is_sure else "order.reset"))
                button.classes(add="hl-sure") if is_sure else button.classes(remove="hl-sure")
        self._show_answer(state)

    def _show_answer(self, state: PageState) -> None:
        if self._order is None:
            if time.monotonic() - self._answer_s > ANSWER_SHOWN_S:
                self._answer.set_text("")
            return
        found, order = outcome(self._order, state), self.texts(f"order.{self._order.order}")
        if found is None:
            return
        if found in ("accepted", "unanswered"):
            self._answer.set_text(self.texts(f"order.{found}", order=order))
        else:
            self._answer.set_text(self.texts("order.refused", order=order, reason=self.texts(f"refusal.{found}")))
        self._order, self._answer_s = None, time.monotonic()

    def _head(self, source: str) -> str:
        texts, session = self.texts, self.session
        user = texts("page.user", name=session.name, role=texts(f"role.{session.role}"))
        other = "en" if texts.language == "zh" else "zh"
        title, kind = escape(texts("page.title")), escape(texts(f"page.{source}"))
        return (
            f'<header class="hl-head"><h1>{title}</h1><span>{kind}</span>'
            f'<span class="hl-grow"></span><span>{escape(user)}</span>'
            f'<a id="language" href="/?lang={other}">{escape(texts("page.language"))}</a>'
            f'<form method="post" action="/log-out?lang={texts.language}"><button id="log-out" type="submit">'
            f"{escape(texts('page.log_out'))}</button></form></header>"
        )

    def _state_card(self) -> str:
        texts = self.texts
        return (
            '<section class="hl-card hl-state" aria-live="polite"><div id="state" class="hl-mode">'
            f'<span id="mode">{escape(texts("mode.no_data"))}</span></div>'
            f'<h2>{escape(texts("cause.title"))}</h2><p id="cause">{escape(texts("page.starting"))}</p>'
            f'<h2>{escape(texts("next.title"))}</h2><p id="next"></p></section>'
        )

    def _map_card(self) -> str:
        texts = self.texts
        tools = "".join(
            f'<button id="map-{name}" type="button" aria-label="{escape(texts(f"map.{name}"))}">{escape(sign)}</button>'
            for name, sign in (
                ("follow", texts("map.follow")), ("all", texts("map.all")), ("smaller", "−"), ("larger", "+"),
            )
        )  # fmt: skip
        return (
            f'<div class="hl-canvas"><canvas id="map" role="img" aria-label="{escape(texts("map.label"))}"></canvas>'
            f'<p id="map-waiting">{escape(texts("map.waiting"))}</p><div class="hl-map-tools">{tools}</div></div>'
            f'<div id="bar" class="hl-bar" role="img" aria-label="{escape(texts("bar.label"))}"></div>'
        )

    def _rows_card(self, name: str) -> str:
        title = escape(self.texts(f"section_title.{name}"))
        big = " hl-big" if name == "motion" else ""
        live = ' role="log" aria-live="polite"' if name == "alarms" else ""
        return (
            f'<section class="hl-card{big}"{live}><h2>{title}</h2><dl class="hl-rows" id="rows-{name}"></dl></section>'
        )
