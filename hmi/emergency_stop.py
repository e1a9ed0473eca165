"""Emergency stop: a plain HTML form with a port and process of its own, so that it works while the page hangs.

It needs no log-in and no key. Without JavaScript; the answer shows whether the machine has accepted the stop.
"""

import json
import socket
import ssl
import time
from collections.abc import Callable
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from hmi.symbols import SYMBOLS
from hmi.texts import Texts, texts_of

DATAGRAM = bytes(96) + json.dumps({"order": "emergency_stop"}).encode()
REPEAT_S = 0.02
ANSWER_S = 2.0  # a simulation on a slow computer is late as well
REQUEST_S = 5.0
MAX_BODY = 1024
CHECK_S = 1.0

SYMBOL = f'<svg viewBox="0 0 24 24" aria-hidden="true">{SYMBOLS["emergency_stop"]}</svg>'
PAGE = """<!DOCTYPE html>
<html lang="{lang}"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body {{ margin: 0; background: #fff; color: #111; font: 700 18px/1.3 sans-serif; }}
form {{ margin: 0; }}
button {{ display: block; width: 100%; height: 64px; border: 4px solid #111; border-radius: 8px; background: #a30014;
  color: #fff; font: 700 26px/1 sans-serif; cursor: pointer; }}
button svg {{ width: 36px; height: 36px; margin-right: 12px; vertical-align: middle; fill: none; stroke: currentColor;
  stroke-width: 2; }}
button:focus-visible {{ outline: 4px solid #111; outline-offset: -10px; }}
p {{ margin: 0; height: 24px; overflow: hidden; white-space: nowrap; text-overflow: ellipsis; text-align: center;
  font-size: 16px; }}
</style></head>
<body><form method="post" action="/stop?lang={lang}"><button type="submit" id="emergency-stop">{symbol}{press}</button>
</form>
<p role="status">{result}</p></body></html>
"""


class StopSender:
    """Sends emergency stops to the order port on the loopback interface."""

    def __init__(self, order_port: int) -> None:
        self._address = ("127.0.0.1", order_port)

    def stop(self) -> bool:
        """Sends the stop at once, then again; whether the machine has accepted the second one."""
        self._send()
        before = self.accepted()
        self._send()
        until_s = time.monotonic() + ANSWER_S
        while before is not None and time.monotonic() < until_s:
            time.sleep(REPEAT_S)
            after = self.accepted()
            if after is not None and after > before:
                return True
        return False

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.sendto(DATAGRAM, self._address)

    def accepted(self) -> int | None:
        """Number of orders that the machine has accepted since its start, None without an answer."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.settimeout(ANSWER_S)
            try:
                link.sendto(b"", self._address)
                return int(json.loads(link.recv(4096))["accepted"])
            except (OSError, ValueError, KeyError, TypeError):
                return None


def make_server(host: str, port: int, tls: ssl.SSLContext | None = None) -> ThreadingHTTPServer:
    """Server with its socket bound, for HTTPS with `tls`; raises OSError for a port that is taken, 0 is a free one."""
    ThreadingHTTPServer.allow_reuse_address = True
    server = ThreadingHTTPServer((host, port), _Handler)
    server.daemon_threads = True
    server.timeout = CHECK_S
    if tls is not None:  # the thread of a request shakes hands: a slow client holds up nobody else
        server.socket = tls.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
    return server


def serve(server: ThreadingHTTPServer, order_port: int, is_over: Callable[[StopSender], bool]) -> None:
    """Answers requests until `is_over`, which is asked once a second at most."""
    server.sender = sender = StopSender(order_port)  # type: ignore[attr-defined]
    checked_s = time.monotonic()
    while True:
        server.handle_request()
        if time.monotonic() - checked_s >= CHECK_S:
            checked_s = time.monotonic()
            if is_over(sender):
                return


class _Handler(BaseHTTPRequestHandler):
    timeout = REQUEST_S  # a slow client does not hold a thread for longer

    def do_GET(self) -> None:
        """The form; at /check with whether the machine answers, which moves and stops nothing."""
        is_check = urlsplit(self.path).path == "/check"
        answers = is_check and self.server.sender.accepted() is not None  # type: ignore[attr-defined]
        key = "stop.works" if answers else "stop.unanswered"
        self._answer(200, self._texts(key, time=time.strftime("%H:%M:%S")) if is_check else "")

    def do_POST(self) -> None:
        """Sends the stop, unless the form is on a page of another server."""
        length = self.headers.get("Content-Length", "0")
        self.rfile.read(min(MAX_BODY, int(length) if length.isdecimal() else 0))
        if is_foreign(self.headers.get("Origin"), self.headers.get("Host")):
            self._answer(403, "")
            return
        key = "stop.sent" if self.server.sender.stop() else "stop.unanswered"  # type: ignore[attr-defined]
        self._answer(200, self._texts(key, time=time.strftime("%H:%M:%S")))

    @property
    def _texts(self) -> Texts:
        return texts_of(parse_qs(urlsplit(self.path).query).get("lang", [""])[0])

    def _answer(self, code: int, result: str) -> None:
        texts = self._texts
        words = {"title": texts("stop.title"), "press": texts("stop.press"), "result": result}
        shown = {key: escape(word) for key, word in words.items()}
        body = PAGE.format(lang=texts.language, symbol=SYMBOL, **shown).encode()
        self.send_response(code)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Requests are not logged."""


def is_foreign(origin: str | None, host: str | None) -> bool:
    """Whether a request comes from a page of another server, by its `Origin` and `Host`."""
    return origin not in (None, "null") and urlsplit(origin or "").netloc != host
