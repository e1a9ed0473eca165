"""Drive view in a browser: layout, orders, and what the machine does."""

import time
from html import escape
from typing import Any

from nicegui import ui
from nicegui.client import Client

from hmi.access import Session
from hmi.drive_view import surroundings
from hmi.drive_view.controls import CONTROLS, NUDGES
from hmi.drive_view.map_view import path_map, static_map
from hmi.orders import SentOrder, outcome
from hmi.page_state import PageState
from hmi.parts import Moment, PageParts
from hmi.replay_bar import ReplayBar
from hmi.shown import ROWS
from hmi.symbols import sprite, symbol
from hmi.texts import Texts
from hmi.view import VIEWS, View
from messages.command import OrderStatus

ANSWER_SHOWN_S = 6.0
SCANS_S = 0.18  # between two updates of 3-D view or camera
GO = ("start", "resume")
MORE = {"motion": " hl-big"}
SECTIONS_BESIDE = ("motion", "work", "alarms", "obstacles", "position", "sensors", "machine")


class DrivePage(View):
    """Drive view; `why_barred` is the key of the reason for which no page gives orders, "" if they may."""

    NAME = "drive"

    def __init__(self, parts: PageParts, client: Client, session: Session, token: str, texts: Texts) -> None:
        super().__init__(parts, client, session, token, texts)
        playback = parts.drive.feed.playback
        self.why_barred = "replay" if playback is not None else "no_key" if parts.sender is None else ""
        self._replay = None if playback is None else ReplayBar(playback, texts)
        self._state: PageState | None = None
        self._sent_points = (0, 0)
        self._sent_paths = 0
        self._buttons: dict[str, tuple[ui.button, ui.label]] = {}
        self._order: SentOrder | None = None
        self._answer_s = 0.0
        self._pane, self._sent_stamps, self._sent_scans_s = surroundings.MAP, tuple[int, ...](), 0.0

    def build_main(self) -> None:
        """Builds state, orders, map and values."""
        ui.html(sprite(), sanitize=False)
        with ui.element("div").classes("hl-act"):
            ui.html(self._state_card(), sanitize=False)
            self._build_orders()
        with ui.element("div").classes("hl-map"):
            bar = f'<div id="bar" class="hl-bar" role="img" aria-label="{escape(self.texts("bar.label"))}"></div>'
            waiting = f'<p id="map-waiting">{escape(self.texts("map.waiting"))}</p>'
            shown = self.map_card(("follow", "all", "smaller", "larger"), waiting) + self._panes() + bar
            ui.html(self._pane_buttons() + shown, sanitize=False)
            if self._replay is not None:
                self._replay.build()
        cards = "".join(self.rows_card(name, MORE.get(name, "")) for name in SECTIONS_BESIDE)
        ui.html(cards, sanitize=False).classes("hl-info")

    def update(self, moment: Moment) -> None:
        """Sends the sections that have changed, and sets the controls."""
        state, shown = moment.state, moment.shown(self.texts)
        sections: dict[str, Any] = {}
        for name, value in shown.items():
            if name != "unavailable":
                sections[f"rows.{name}" if name in ROWS else name] = value
        news: dict[str, Any] = {}
        if moment.is_restarted or state is not self._state:
            self._state, self._sent_points, self._sent_paths = state, (0, 0), 0
            news = {"clear": True, "still": static_map(state.scene), "paths": []}
        if state.paths_taken != self._sent_paths:  # a path has tens of thousands of points: not in every update
            self._sent_paths, news["paths"] = state.paths_taken, path_map(state)
        sections["texts"] = {"interrupted": self._interrupted()}
        self.send(moment, sections, news | self._new_points(state) | self._surroundings(state))
        if not self.why_barred:
            self._set_controls(shown["unavailable"], self.seat.update(), state)
        if self._replay is not None:
            self._replay.update()

    def watch(self, pane: str) -> None:
        """Shows map, 3-D view or a camera in the place of the map."""
        if pane in surroundings.panes(self.parts.drive.scene.vehicle):
            self._pane, self._sent_stamps = pane, ()

    @property
    def watched(self) -> frozenset[str]:
        """Topics of the pane."""
        return surroundings.watched(self._pane, self.parts.drive.scene.vehicle)

    def _surroundings(self, state: PageState) -> dict[str, Any]:
        """New scans or images of the pane."""
        stamps, now_s = surroundings.stamps(state, self._pane), time.monotonic()
        if stamps == self._sent_stamps or not stamps or now_s - self._sent_scans_s < SCANS_S:
            return {}
        self._sent_stamps, self._sent_scans_s = stamps, now_s
        if self._pane == surroundings.SPACE:
            return {"space": surroundings.space(state, self.texts)}
        found = surroundings.camera(state, self._pane, self.texts)
        return {} if found is None else {"camera": found}

    def _pane_buttons(self) -> str:
        names, found = {surroundings.MAP: self.texts("pane.map"), surroundings.SPACE: self.texts("pane.space")}, ""
        for pane in surroundings.panes(self.parts.drive.scene.vehicle):
            name = names.get(pane) or self.sensor_name(f"vehicle.sensors.{pane.replace('/', '.')}")
            is_chosen = "true" if pane == surroundings.MAP else "false"
            found += f'<button type="button" data-pane="{pane}" aria-pressed="{is_chosen}">{escape(name)}</button>'
        return f'<div class="hl-panes" role="group" aria-label="{escape(self.texts("pane.label"))}">{found}</div>'

    def _panes(self) -> str:
        """3-D view and camera image, hidden until they are chosen."""
        keys = "waiting", "failed", "space_label", "camera_label"
        waiting, failed, space, camera = (escape(self.texts(f"pane.{key}")) for key in keys)
        return (
            f'<div id="space" class="hl-canvas" role="img" aria-label="{space}" hidden>'
            f'<p id="space-note" data-failed="{failed}">{waiting}</p></div><div id="camera" class="hl-canvas" hidden>'
            f'<canvas id="camera-image" role="img" aria-label="{camera}"></canvas>'
            f'<p id="camera-note">{waiting}</p></div>'
        )

    def _interrupted(self) -> str:
        """The newest mission that was interrupted, while no stored one is driven."""
        parts, store = self.parts, self.parts.desk.store
        if parts.drives is None or parts.drive.stored is not None:
            return ""
        for mission in store.all():
            progress = store.interrupted().get(mission.id)
            if progress is not None and mission.about is not None:
                return self.texts("page.interrupted", name=mission.about.name, share=f"{progress.share:.0%}")
        return ""

    def _new_points(self, state: PageState) -> dict[str, Any]:
        """Points of track and worked area since the last update."""
        trail, edges = state.trail.points, state.coverage.edges
        sent_trail, sent_edges = self._sent_points
        self._sent_points = len(trail), len(edges)
        found = {"trail": trail.since(sent_trail), "edges": edges.since(sent_edges)}
        return {name: points for name, points in found.items() if points}

    def _build_orders(self) -> None:
        with ui.element("section").classes("hl-card"):
            ui.html(f"<h2>{escape(self.texts('section_title.controls'))}</h2>", sanitize=False)
            if self.why_barred:
                ui.label(self.texts(f"why.{self.why_barred}")).props('data-hl="barred"')
                return
            self.seat.build()
            with ui.element("div").classes("hl-orders"):
                for order in CONTROLS:
                    self._build_order(order)
            self._answer_label = ui.label("").classes("hl-answer").props('role="status" data-hl="answer"')

    def _build_order(self, order: str) -> None:
        with ui.element("div").classes("hl-order"):
            button = ui.button(self.texts(f"order.{order}"), on_click=lambda: self._press(order), color=None)
            button.classes("hl-button" + (" hl-go" if order in GO else ""))
            note = ui.label("").classes("hl-note").props(f'data-hl="why-{order}"')
            with button:
                ui.html(symbol(order), sanitize=False).classes("hl-symbol-box")
            button.props(f'unelevated no-caps data-hl="order-{order}" aria-describedby="{note.html_id}"')
        button.set_enabled(False)  # until the first update: a press before it would be lost
        self._buttons[order] = button, note

    def _press(self, order: str) -> None:
        """Sends an order; the release of a stop at the second press."""
        if self.seat.why_not(is_action=True):
            return
        is_second = self.is_sure(order)
        if order == "reset" and not is_second:
            return
        sender, state, config = self.parts.sender, self._state, self.parts.config
        status = None if state is None else state.fresh("order_status", OrderStatus)
        if self.parts.is_switching or sender is None or state is None or status is None:
            return
        valid_s = config.confirmation_valid_s if order == "confirm_clear" else config.order_valid_s
        kind = "nudge" if order in NUDGES else order
        self._order = sender.send(kind, status, state.now_ns, valid_s, NUDGES.get(order))
        self._answer_s = time.monotonic()
        self._answer_label.set_text(self.texts("order.sent", order=self.texts(f"order.{order}")))

    def _set_controls(self, unavailable: dict[str, str], barred: str, state: PageState) -> None:
        is_sure = self.asks("reset")
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
                self._answer_label.set_text("")
            return
        found, order = outcome(self._order, state), self.texts(f"order.{self._order.order}")
        if found is None:
            return
        if found in ("accepted", "unanswered"):
            self._answer_label.set_text(self.texts(f"order.{found}", order=order))
        else:
            self._answer_label.set_text(self.texts("order.refused", order=order, reason=self.texts(f"refusal.{found}")))
        self._order, self._answer_s = None, time.monotonic()

    def _state_card(self) -> str:
        texts = self.texts
        return (
            '<section class="hl-card hl-state" aria-live="polite"><div id="state" class="hl-mode">'
            f'<span id="mode">{escape(texts("mode.no_data"))}</span></div>'
            f'<h2>{escape(texts("cause.title"))}</h2><p id="cause">{escape(texts("page.starting"))}</p>'
            f'<h2>{escape(texts("next.title"))}</h2><p id="next"></p>'
            f'<a id="interrupted" class="hl-link" href="{VIEWS["plan"]}?lang={texts.language}"></a></section>'
        )
