"""Sends notifications by e-mail and to a webhook, in a thread of its own: the page never waits for it."""

import json
import queue
import smtplib
import ssl
import threading
import urllib.request
from collections.abc import Callable
from dataclasses import asdict
from email.message import EmailMessage
from functools import partial
from http.client import HTTPException

from hmi.notification.config import EmailConfig, NotificationConfig
from hmi.notification.need import Notification

TIMEOUT_S = 10.0
RETRY_S = (5.0, 30.0, 120.0, 600.0)  # after a failure; then it is given up
MAX_WAITING = 20


class NotificationSender:
    """Sends in the order of `put`; `error` says why the last attempt has failed, "" after a success."""

    def __init__(self, config: NotificationConfig, retry_s: tuple[float, ...] = RETRY_S) -> None:
        self.error = ""
        self._retry_s = retry_s
        self._ended = threading.Event()
        self._waiting: queue.Queue[Notification] = queue.Queue(MAX_WAITING)
        self._ways: list[Callable[[Notification], None]] = []
        if config.email is not None:
            self._ways.append(partial(send_email, config.email))
        if config.webhook is not None:
            self._ways.append(partial(send_webhook, config.webhook))
        if self._ways:
            threading.Thread(target=self._run, name="notification", daemon=True).start()

    def put(self, notification: Notification) -> None:
        """Takes a notification; with `MAX_WAITING` unsent ones it is dropped, and `error` says so."""
        if not self._ways:
            return
        try:
            self._waiting.put_nowait(notification)
        except queue.Full:
            self.error = f"{MAX_WAITING} notifications wait, the newest was dropped"

    def end(self) -> None:
        """Sends nothing more."""
        self._ended.set()

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                notification = self._waiting.get(timeout=0.5)
            except queue.Empty:
                continue
            left = [way for way in self._ways if not self._is_sent(way, notification)]
            for pause_s in self._retry_s:
                if not left or self._ended.wait(pause_s):
                    break
                left = [way for way in left if not self._is_sent(way, notification)]

    def _is_sent(self, way: Callable[[Notification], None], notification: Notification) -> bool:
        try:
            way(notification)
        except (OSError, HTTPException, ValueError) as error:
            self.error = str(error)[:300] or type(error).__name__
            return False
        self.error = ""
        return True


def send_email(config: EmailConfig, notification: Notification) -> None:
    """Sends a mail; raises OSError or SMTPException."""
    mail = EmailMessage()
    mail["Subject"] = f"{notification.machine}: {notification.mode}"
    mail["From"], mail["To"] = config.sender, ", ".join(config.recipients)
    mail.set_content(
        f"{notification.time}\n{notification.mode}\n\n{notification.cause}\n\n{notification.next_step}\n", cte="base64"
    )
    context = ssl.create_default_context()
    if config.security == "tls":
        server: smtplib.SMTP = smtplib.SMTP_SSL(config.host, config.port, timeout=TIMEOUT_S, context=context)
    else:
        server = smtplib.SMTP(config.host, config.port, timeout=TIMEOUT_S)
    with server:
        if config.security == "starttls":
            server.starttls(context=context)
        if config.user is not None and config.password_file is not None:
            server.login(config.user, config.password_file.read_text(encoding="utf-8").strip())
        server.send_message(mail)


def send_webhook(url: str, notification: Notification) -> None:
    """Posts JSON; raises OSError for no answer, or one that is not 2xx."""
    body = json.dumps(asdict(notification), ensure_ascii=False).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json; charset=utf-8"}, method="POST")
    with urllib.request.urlopen(request, timeout=TIMEOUT_S):
        pass
