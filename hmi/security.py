"""Checks of every request: own host, own origin, and what a browser may load."""

from collections.abc import Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hmi.emergency_stop import is_foreign

LOOPBACK = frozenset({"127.0.0.1", "localhost"})
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; frame-src {frames}; frame-ancestors 'none'; base-uri 'self'; "
    "form-action 'self'"
)


class RequestChecks:
    """Refuses requests for another host (DNS rebinding), and any but GET from pages of another server (CSRF).

    WebSocket connections from pages of other servers are refused as well. `frames` are addresses that a page may embed.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str], frames: Iterable[str]) -> None:
        self._app, self._hosts = app, frozenset(hosts)
        self._policy = POLICY.format(frames=" ".join(frames) or "'none'")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a permitted request on, and adds the headers to its answer."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif self._is_permitted(scope):
            await self._app(scope, receive, self._with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await send({"type": "http.response.start", "status": 403, "headers": [(b"content-type", b"text/plain")]})
            await send({"type": "http.response.body", "body": b"request from another origin or for another host\n"})

    def _is_permitted(self, scope: Scope) -> bool:
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if host.rpartition(":")[0] not in self._hosts and host not in self._hosts:
            return False
        if scope["type"] == "http" and scope["method"] in ("GET", "HEAD"):
            return True
        return origin is None or (origin != "null" and not is_foreign(origin, host))

    def _with_headers(self, send: Send) -> Send:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = self._policy
                headers["X-Content-Type-Options"] = "nosniff"
            await send(message)

        return send_with_headers
