"""Notifications to servers of this computer: sent once for each stop, tried again, and never waited for."""

import base64
import json
import queue
import socket
import threading
import time
from collections.abc import Iterator
from email import message_from_string
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from configs.strict import CONFIGS, load, parse
from hmi.app import PageApp
from hmi.config import PageConfig
from hmi.notification.config import NotificationConfig
from hmi.notification.need import NeedWatch, Notification, needs_somebody
from hmi.notification.sender import MAX_WAITING, NotificationSender
from messages.command import Mode
from messages.errors import ConfigError
from messages.plan import MissionState
from tests.hmi.drive_messages import NOW_NS, SECOND_NS, mission, state_of, supervisor
from tests.hmi.mail_server import mail_server
from tests.hmi.test_page_app import GivenFeed, app  # noqa: F401  the fixture

GIVEN = Notification("tractor_e", "2026-11-25 12:00:00", "障碍停车", "Person in the path", "Operator: look there.")
EMAIL = {"host": "127.0.0.1", "security": "none", "sender": "farm@example.org", "recipients": ["anna@example.org"]}


class Hook(BaseHTTPRequestHandler):
    """Takes notifications by HTTP; refuses as many as the server says."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        server: Any = self.server
        server.refuses -= 1
        self.send_response(503 if server.refuses >= 0 else 204)
        self.end_headers()
        if server.refuses < 0:
            server.bodies.put(json.loads(body))

    def log_message(self, *_: Any) -> None:
        """Nothing is printed."""


@pytest.fixture(name="mail_server")
def running_mail_server() -> Iterator[Any]:
    with mail_server() as server:
        yield server


@pytest.fixture
def hook() -> Iterator[Any]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Hook) as server:
        server.bodies, server.refuses = queue.Queue(), 0  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        yield server
        server.shutdown()


@pytest.fixture
def silent_port() -> Iterator[int]:
    """Port that accepts connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def config(**changes: Any) -> NotificationConfig:
    return parse(NotificationConfig, {"after_s": 0.0, "language": "zh"} | changes, "page.yaml")


def url_of(port: int) -> str:
    return f"http://127.0.0.1:{port}/hook"


def test_a_mail_has_mode_cause_and_next_step(mail_server: Any) -> None:
    sender = NotificationSender(config(email=EMAIL | {"port": mail_server.server_address[1]}))
    sender.put(GIVEN)
    mail = message_from_string(mail_server.mails.get(timeout=10.0))
    assert (mail["From"], mail["To"]) == ("farm@example.org", "anna@example.org")
    subject = "".join(line.strip() for line in mail["Subject"].splitlines())
    assert "tractor_e" in subject
    text = base64.b64decode(mail.get_payload()).decode()
    for part in (GIVEN.time, GIVEN.mode, GIVEN.cause, GIVEN.next_step):
        assert part in text
    sender.end()


def test_a_webhook_that_refuses_is_tried_again(hook: Any) -> None:
    hook.refuses = 2
    sender = NotificationSender(config(webhook=url_of(hook.server_address[1])), retry_s=(0.05, 0.05))
    sender.put(GIVEN)
    assert hook.bodies.get(timeout=10.0)["cause"] == GIVEN.cause
    assert hook.refuses == -1
    sender.end()


def test_a_mail_is_not_sent_twice_because_the_webhook_fails(mail_server: Any, hook: Any) -> None:
    hook.refuses = 3
    both = config(email=EMAIL | {"port": mail_server.server_address[1]}, webhook=url_of(hook.server_address[1]))
    sender = NotificationSender(both, retry_s=(0.05, 0.05, 0.05))
    sender.put(GIVEN)
    assert hook.bodies.get(timeout=10.0)["machine"] == "tractor_e"
    assert mail_server.mails.qsize() == 1
    sender.end()


def test_a_server_that_is_not_there_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    sender = NotificationSender(config(webhook=url_of(port)), retry_s=())
    sender.put(GIVEN)
    until_s = time.monotonic() + 10.0
    while not sender.error and time.monotonic() < until_s:
        time.sleep(0.02)
    assert "refused" in sender.error
    sender.end()


def test_a_server_that_hangs_delays_nobody(silent_port: int) -> None:
    sender = NotificationSender(config(webhook=url_of(silent_port)))
    began_s = time.monotonic()
    for _ in range(MAX_WAITING + 5):
        sender.put(GIVEN)
    assert time.monotonic() - began_s < 0.5
    assert "dropped" in sender.error
    sender.end()


def test_without_a_way_no_thread_runs() -> None:
    before = threading.active_count()
    sender = NotificationSender(config())
    for _ in range(MAX_WAITING + 5):
        sender.put(GIVEN)
    assert (threading.active_count(), sender.error) == (before, "")


@pytest.mark.parametrize(
    ("mode", "reason", "is_needed"),
    [
        (Mode.FAULT_STOP, "brake.weak", True), (Mode.EMERGENCY_STOP, "", True), (Mode.OBSTACLE_STOP, "", True),
        (Mode.AUTOMATIC, "", False), (Mode.START_WARNING, "", False), (Mode.STANDBY, "", False),
        (Mode.STANDBY, "operator_command.unconfirmed", False), (Mode.STANDBY, "localization.none", True),
        (Mode.MANUAL, "", False), (Mode.FINISHED, "", False),
    ],
)  # fmt: skip
def test_who_is_called_in_which_mode(mode: Mode, reason: str, is_needed: bool) -> None:
    state = state_of(("mission", mission(MissionState.DRIVING)), ("supervisor", supervisor(mode, reason)))
    assert needs_somebody(state) is is_needed


def test_a_machine_that_falls_silent_needs_somebody_once_it_has_begun() -> None:
    later_ns = NOW_NS + 60 * SECOND_NS
    for state, is_needed in ((MissionState.DRIVING, True), (MissionState.WAITING, False)):
        messages = (("mission", mission(state)), ("supervisor", supervisor(Mode.AUTOMATIC)))
        assert needs_somebody(state_of(*messages, now_ns=later_ns)) is is_needed


def test_each_stop_is_notified_once_after_its_time() -> None:
    watch = NeedWatch(60.0)
    stop, drives = (
        state_of(("supervisor", supervisor(Mode.OBSTACLE_STOP))),
        state_of(("supervisor", supervisor(Mode.AUTOMATIC))),
    )
    assert [watch.is_due(stop, now_s) for now_s in (0.0, 59.0, 60.0, 61.0, 900.0)] == [False, False, True, False, False]
    assert not watch.is_due(drives, 901.0)
    assert [watch.is_due(stop, now_s) for now_s in (902.0, 961.0, 962.0)] == [False, False, True]


def test_the_page_tells_why_the_machine_stands(app: PageApp, hook: Any) -> None:  # noqa: F811
    app.notifications = NotificationSender(config(webhook=url_of(hook.server_address[1])))
    app._need = NeedWatch(0.0)
    feed = app.parts.drive.feed
    assert isinstance(feed, GivenFeed)
    feed.now_ns = NOW_NS
    feed.given += [("supervisor", supervisor(Mode.FAULT_STOP))]
    app.step()
    received = hook.bodies.get(timeout=10.0)
    assert (received["machine"], received["mode"]) == (app.parts.drive.scene.vehicle.name, "Fault stop")
    assert "A fault has stopped the machine" in received["cause"]
    assert "remove the cause" in received["next_step"]
    app.notifications.end()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"webhook": "ftp://example.org"}, "webhook"), ({"after_s": -1.0}, "after_s"), ({"language": "de"}, "language"),
        ({"email": EMAIL | {"port": 0}}, "port"), ({"email": EMAIL | {"port": 25, "recipients": []}}, "recipients"),
        ({"email": EMAIL | {"port": 25, "sender": "a\nBcc: b@example.org"}}, "sender"),
        ({"email": EMAIL | {"port": 25, "user": "farm"}}, "password_file"),
        ({"email": EMAIL | {"port": 25, "user": "farm", "password_file": "x"}}, "clear text"),
    ],
)  # fmt: skip
def test_configuration_names_what_is_wrong(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config(**change)


def test_nobody_is_called_unless_configured() -> None:
    shipped = load(PageConfig, Path(CONFIGS / "page.yaml")).notification
    assert (shipped.email, shipped.webhook) == (None, None)
