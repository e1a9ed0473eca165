"""Application of the page: one state, one update of all open pages per period."""

import asyncio
import logging
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import RedirectResponse
from fastapi.staticfiles import StaticFiles
from nicegui import app as nicegui_app
from nicegui import ui

from hmi.access import Access, Session
from hmi.config import PageConfig
from hmi.drive_page import DrivePage
from hmi.drive_view.standing import RuleText
from hmi.feed import Feed
from hmi.log_in import COOKIE, add_log_in, language_of, session_of
from hmi.orders import OrderSender
from hmi.page_state import PageState
from hmi.replay_bar import ReplayBar
from hmi.scene import Scene
from hmi.seat_bar import SeatBar
from hmi.security import LOOPBACK, RequestChecks
from hmi.shown import shown_of
from hmi.texts import texts_of

STATIC = Path(__file__).parent / "static"
LOG = logging.getLogger(__name__)
CONNECT_S = 30.0  # for a browser to connect after it has loaded the page


@dataclass
class PageParts:
    """What a page is made of; `source` is `simulation`, `connected` or `replay`, `sender` None gives no orders."""

    feed: Feed
    scene: Scene
    config: PageConfig
    access: Access
    sender: OrderSender | None
    stop_url: str | None
    source: str
    rule_text_zh: RuleText


class PageApp:
    """Open pages and the state that all of them show."""

    def __init__(self, parts: PageParts) -> None:
        self.parts = parts
        self.state = PageState(parts.scene, parts.config.cell_m)
        self.pages: dict[str, DrivePage] = {}

    async def run(self) -> None:
        """Updates all pages once per period; after an error they say that what they show is old."""
        while True:
            began_s = time.monotonic()
            try:
                self.step()
            except Exception:
                LOG.exception("the pages are not updated")
            await asyncio.sleep(max(0.02, self.parts.config.period_s - (time.monotonic() - began_s)))

    def step(self) -> None:
        """Reads the feed and updates all pages; an error of one page closes that page only."""
        feed = self.parts.feed
        envelopes = feed.poll()
        is_restarted = feed.take_restart()
        if is_restarted:
            self.state = PageState(self.parts.scene, self.parts.config.cell_m)
        self.state.take(feed.now_ns, envelopes)
        shown: dict[str, dict[str, Any]] = {}
        for key, page in list(self.pages.items()):
            language = page.texts.language
            if language not in shown:
                shown[language] = shown_of(self.state, page.texts, self.parts.rule_text_zh, feed.playback)
            try:
                page.update(shown[language], self.state, is_restarted)
            except Exception:
                LOG.exception("a page is closed")
                self.pages.pop(key, None)

    async def open(self, request: Request) -> RedirectResponse | None:
        """Builds the page of a request, or sends it to the log-in."""
        session = session_of(request, self.parts.access)
        token = request.cookies.get(COOKIE)
        if session is None or token is None:
            return RedirectResponse(f"/log-in?lang={texts_of(language_of(request)).language}", 303)
        session.used_s = time.monotonic()
        page = self._build(session, token, request)
        await page.client.connected(CONNECT_S)
        self._join(page, token)
        return None

    def _build(self, session: Session, token: str, request: Request) -> DrivePage:
        parts, texts = self.parts, texts_of(language_of(request))
        why_barred = "replay" if parts.feed.playback is not None else "no_key" if parts.sender is None else ""
        client = ui.context.client
        ui.add_head_html('<link rel="stylesheet" href="/static/page.css"><script src="/static/page.js"></script>')
        ui.add_head_html(f"<script>document.documentElement.lang = '{texts.language}'</script>")
        page = DrivePage(client, session, texts, parts.config, parts.sender, why_barred, self.state)
        seat = SeatBar(parts.access, session, token, texts)
        replay = None if parts.feed.playback is None else ReplayBar(parts.feed.playback, texts)
        page.build(seat, replay, parts.source, parts.stop_url)
        return page

    def _join(self, page: DrivePage, token: str) -> None:
        """Updates the page until its browser leaves or its session ends."""
        page.session.pages += 1
        self.pages[page.client.id] = page

        def leave() -> None:
            if self.pages.pop(page.client.id, None) is not None:
                page.session.pages -= 1
                page.session.left_s = time.monotonic()

        def end_with_session() -> None:
            if self.parts.access.session(token, time.monotonic()) is not page.session:
                leave()
                page.client.run_javascript("location.href = '/log-in'")

        page.client.on_delete(leave)
        with page.client:
            ui.timer(1.0, end_with_session)


def make_app(parts: PageParts, hosts: frozenset[str] = LOOPBACK) -> FastAPI:
    """The web application; NiceGUI's own object holds its routes, so there is one per process."""
    page_app = PageApp(parts)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_log_in(app, parts.access, parts.stop_url)
    app.mount("/static", StaticFiles(directory=STATIC))

    @ui.page("/", title="Headland")
    async def drive(request: Request) -> RedirectResponse | None:
        return await page_app.open(request)

    nicegui_app.on_startup(lambda: asyncio.create_task(page_app.run()))
    ui.run_with(
        app, title="Headland", tailwind=False, dark=False, message_history_length=0, show_welcome_message=False,
        binding_refresh_interval=None, reconnect_timeout=10.0,
    )  # fmt: skip
    app.add_middleware(RequestChecks, hosts=hosts, frames=[parts.stop_url] if parts.stop_url else [])
    return app


def serve(app: FastAPI, listening: socket.socket) -> None:
    """Serves until SIGINT or SIGTERM."""
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=2)
    uvicorn.Server(config).run(sockets=[listening])
