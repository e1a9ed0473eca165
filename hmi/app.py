"""Application of the page: one state, one update of all open pages per period."""

import asyncio
import logging
import socket
import time
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import RedirectResponse
from fastapi.staticfiles import StaticFiles
from nicegui import app as nicegui_app
from nicegui import ui

from hmi.calibration_page import CalibrationPage
from hmi.certificate import Certificate
from hmi.diagnosis.alarm_log import AlarmLog, clock_text
from hmi.diagnosis.bus_table import BusTable
from hmi.diagnosis.topic_table import TopicTable
from hmi.diagnosis_page import DiagnosisPage
from hmi.drive_page import DrivePage
from hmi.drive_view.standing import standing
from hmi.files import add_files
from hmi.log_in import COOKIE, add_log_in, language_of, session_of
from hmi.notification.need import NeedWatch, notification_of
from hmi.notification.sender import NotificationSender
from hmi.page_state import PageState
from hmi.parts import Moment, PageParts
from hmi.plan_page import PlanPage
from hmi.plan_view.progress import ProgressKeeper
from hmi.security import LOOPBACK, RequestChecks
from hmi.setup_page import SetupPage
from hmi.statistics.store import Totals
from hmi.statistics_page import StatisticsPage
from hmi.texts import texts_of
from hmi.upload.platform_report import DriveName
from hmi.view import VIEWS, View
from messages.command import OrderStatus
from messages.errors import HeadlandError

STATIC = Path(__file__).parent / "static"
LOG = logging.getLogger(__name__)
STORE_S = 1.0  # between two transactions of the statistics
PRESENT_S = 2.0  # an answer of the operator's page counts for so long
BEAT_S = 1.0  # of the machine, between two signed messages that the operator is there
CONNECT_S = 30.0  # for a browser to connect after it has loaded the page


class PageApp:
    """Open pages and the state that all of them show."""

    def __init__(self, parts: PageParts) -> None:
        self.parts = parts
        self.state = PageState(parts.drive.scene, parts.config.cell_m)
        self.alarms, self.topics, self.bus = AlarmLog(), TopicTable(), BusTable()
        self.pages: dict[str, View] = {}
        self._drive_error = ""
        self._stored: Totals | None = None
        self._stored_s = 0.0
        self._beat_ns = 0
        self._need = NeedWatch(parts.config.notification.after_s)
        self.notifications = NotificationSender(parts.config.notification)
        self._keeper: ProgressKeeper | None = None

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
        is_new = self._take_drive()
        feed, now_s = self.parts.drive.feed, time.monotonic()
        feed.watched = frozenset().union(*(page.watched for page in self.pages.values()))
        envelopes = list(feed.poll())
        if self.parts.calibration is not None:
            self.parts.calibration.take(envelopes)
        is_restarted = feed.take_restart() or is_new
        if is_restarted:
            self.state = PageState(self.parts.drive.scene, self.parts.config.cell_m)
            self._end_alarms()
        self.state.take(feed.now_ns, envelopes)
        self.alarms.take(self.state.new_faults, time.time())
        self.topics.take(feed.counts, now_s)
        self.bus.take(envelopes)
        self.parts.desk.follow(self.state)
        if now_s - self._stored_s >= STORE_S:
            self._stored_s = now_s
            self.store_statistics()
            self.store_progress()
            self.report(False)
        self._send_presence(now_s)
        self._notify(now_s)
        self._show_views(is_restarted)
        moment = Moment(self.parts, self.state, self.alarms, self.topics, self.bus, is_restarted, self._drive_error)
        for key, page in list(self.pages.items()):
            try:
                page.update(moment)
            except Exception:
                LOG.exception("a page is closed")
                self.pages.pop(key, None)

    def _send_presence(self, now_s: float) -> None:
        """Tells the machine that the page of the operator in control answers."""
        sender, status = self.parts.sender, self.state.fresh("order_status", OrderStatus)
        if self.parts.is_switching or sender is None or status is None or now_s - self.parts.present_s > PRESENT_S:
            return
        if abs(self.state.now_ns - self._beat_ns) >= BEAT_S * 1e9:
            self._beat_ns = self.state.now_ns
            sender.send("present", status, self.state.now_ns, self.parts.config.order_valid_s)

    def _notify(self, now_s: float) -> None:
        """Calls somebody when the machine needs one; not in a replay."""
        drive, config = self.parts.drive, self.parts.config.notification
        if drive.feed.playback is None and self._need.is_due(self.state, now_s):
            now = standing(self.state, texts_of(config.language), self.parts.rule_text_zh)
            self.notifications.put(notification_of(drive.scene.vehicle.name, clock_text(time.time()), now))
        self.parts.notification_error = self.notifications.error

    def _show_views(self, is_restarted: bool) -> None:
        """Gives the viewer topics to the Foxglove server; an error there does not reach the pages."""
        server, feed = self.parts.foxglove, self.parts.drive.feed
        if server is None:
            return
        try:
            if is_restarted:
                server.forget()
            server.put(feed.views(server.read), feed.now_ns)
        except Exception:
            LOG.exception("the viewer topics are not sent")

    def _take_drive(self) -> bool:
        """Shows a drive that has begun; whether there is one."""
        found = None if self.parts.drives is None else self.parts.drives.take()
        if found is None:
            return False
        self.parts.is_switching = False
        if isinstance(found, str):
            self._drive_error = found
            return False
        self.store_statistics()
        self.store_progress()
        self.report(True)
        self.parts.drive, self._drive_error, self._stored = found, "", None
        if self.parts.setup is not None and self.parts.calibration is not None and found.setup is not None:
            self.parts.calibration.end()
            self.parts.setup.show(found.setup, found.setup_number)
        self._keeper = None if found.stored is None else ProgressKeeper(found.stored)
        self.topics, self.bus = TopicTable(), BusTable()
        return True

    def _end_alarms(self) -> None:
        """Alarms of a drive that has ended remain in the history, those of another position in a log do not."""
        if self.parts.drive.feed.playback is None:
            self.alarms.end_all(time.time())
        else:
            self.alarms = AlarmLog()

    def store_statistics(self) -> None:
        """Stores the totals of the drive when they have changed; an error is shown, and it is tried again."""
        store, state, drive = self.parts.statistics, self.state, self.parts.drive
        totals = totals_of(state)
        if store is None or totals == self._stored:
            return
        try:
            store.put(drive.name, time.strftime("%Y-%m-%d"), drive.scene.site.name, totals)
            self._stored, self.parts.statistics_error = totals, ""
        except HeadlandError as error:
            self.parts.statistics_error = str(error)

    def report(self, is_last: bool) -> None:
        """Queues what the platform is to know; `is_last` at the end of the drive."""
        if self.parts.report is not None:
            name = DriveName(self.parts.drive.name, self.parts.drive.scene.site.name)
            day = time.strftime("%Y-%m-%d")
            self.parts.report.take(name, day, totals_of(self.state), self.alarms, time.monotonic(), is_last)

    def store_progress(self) -> None:
        """Stores how far the mission is driven; an error is shown, and it is tried again."""
        try:
            if self._keeper is not None:
                self._keeper.store(self.state)
            self.parts.progress_error = ""
        except HeadlandError as error:
            self.parts.progress_error = str(error)

    async def open(self, request: Request, kind: type[View]) -> RedirectResponse | None:
        """Builds the page of a request, or sends it to the log-in."""
        session = session_of(request, self.parts.access)
        token = request.cookies.get(COOKIE)
        if session is None or token is None:
            return RedirectResponse(f"/log-in?lang={texts_of(language_of(request)).language}", 303)
        session.used_s = time.monotonic()
        texts, client = texts_of(language_of(request)), ui.context.client
        ui.add_head_html('<link rel="stylesheet" href="/static/page.css"><script src="/static/page.js"></script>')
        ui.add_head_html('<script src="/static/controls.js"></script><script src="/static/surroundings.js"></script>')
        ui.add_head_html(f"<script>document.documentElement.lang = '{texts.language}'</script>")
        page = kind(self.parts, client, session, token, texts)
        page.build()
        await client.connected(CONNECT_S)
        self._join(page, token)
        return None

    def _join(self, page: View, token: str) -> None:
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


def totals_of(state: PageState) -> Totals:
    """Totals of a drive since its start."""
    return Totals(state.coverage.area_m2, state.engaged_s, state.distance_m, state.stops)


def make_app(parts: PageParts, hosts: frozenset[str] = LOOPBACK) -> FastAPI:
    """The web application; NiceGUI's own object holds its routes, so there is one per process."""
    page_app = PageApp(parts)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_log_in(app, parts.access, parts.stop_url, parts.url.startswith("https:"))
    add_files(app, parts)
    app.mount("/static", StaticFiles(directory=STATIC))

    def add_page(kind: type[View]) -> None:
        @ui.page(VIEWS[kind.NAME], title="Headland")
        async def show(request: Request) -> RedirectResponse | None:
            return await page_app.open(request, kind)

    for kind in (DrivePage, PlanPage, SetupPage, CalibrationPage, DiagnosisPage, StatisticsPage):
        add_page(kind)
    nicegui_app.on_startup(lambda: asyncio.create_task(page_app.run()))
    server = parts.foxglove
    if server is not None:
        nicegui_app.on_startup(lambda: asyncio.create_task(server.run()))
    nicegui_app.on_shutdown(page_app.store_statistics)
    nicegui_app.on_shutdown(lambda: page_app.report(True))
    ui.run_with(
        app, title="Headland", tailwind=False, dark=False, message_history_length=0, show_welcome_message=False,
        binding_refresh_interval=None, reconnect_timeout=10.0,
    )  # fmt: skip
    app.add_middleware(RequestChecks, hosts=hosts, frames=[parts.stop_url] if parts.stop_url else [])
    return app


def serve(app: FastAPI, listening: socket.socket, certificate: Certificate | None = None) -> None:
    """Serves until SIGINT or SIGTERM, by HTTPS with a certificate."""
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, timeout_graceful_shutdown=2,
        ssl_certfile=certificate.path if certificate else None, ssl_keyfile=certificate.key if certificate else None,
    )  # fmt: skip
    uvicorn.Server(config).run(sockets=[listening])
