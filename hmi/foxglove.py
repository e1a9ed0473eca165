"""Server of the Foxglove WebSocket protocol: viewer topics for Foxglove or Lichtblick; it takes no orders.

Protocol: https://github.com/foxglove/ws-protocol, `docs/spec.md`. Loopback interface only.
"""

import asyncio
import json
import logging
import secrets
import socket
import struct
from base64 import b64encode
from collections import deque
from collections.abc import Iterable
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from hmi.feed import ViewMessage
from hmi.security import LOOPBACK

PROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
DATA, TIME = 1, 2  # first byte of a binary message
MAX_CLIENTS = 4
QUEUE_BYTES = 8 << 20  # of a client that reads slowly; the oldest message is dropped
REQUEST_BYTES = 1 << 16
CLOSE_S = 1.0
MAX_WARNED = 10
LOG = logging.getLogger(__name__)


class FoxgloveServer:
    """Clients, and the newest message of each topic, which a client gets when it subscribes.

    Pages of `origins` may connect, and programs that send no `Origin`.
    """

    def __init__(self, listening: socket.socket, origins: Iterable[str], name: str) -> None:
        self._listening, self._origins, self._name = listening, frozenset(origins), name
        self._session = secrets.token_hex(8)
        self._clients: list[_Client] = []
        self._channels: dict[tuple[str, str], dict[str, Any]] = {}  # by topic and schema
        self._newest: dict[int, ViewMessage] = {}  # by channel
        self._warned: set[str] = set()

    async def run(self) -> None:
        """Serves until it is cancelled."""
        async with serve(
            self._talk, sock=self._listening, subprotocols=PROTOCOLS, process_request=self._check, compression=None,
            max_size=REQUEST_BYTES, close_timeout=CLOSE_S, server_header=None,
        ):  # fmt: skip
            await asyncio.Future()

    @property
    def read(self) -> frozenset[str] | None:
        """Topics to which somebody has subscribed, None without a client."""
        if not self._clients:
            return None
        channels = self._channels.values()
        return frozenset(one["topic"] for one in channels if any(one["id"] in c.subscriptions for c in self._clients))

    def put(self, messages: Iterable[ViewMessage], now_ns: int) -> None:
        """Sends messages to those who have subscribed, and the present time."""
        for message in messages:
            number = self._channel_of(message)
            if message.data is not None:
                self._newest[number] = message
                for client in self._clients:
                    client.put(number, message)
        for client in self._clients if self._newest else ():  # there is no time before the first message
            client.put_frame(struct.pack("<BQ", TIME, max(0, now_ns)))

    def forget(self) -> None:
        """What was sent is void: another drive, or another position in a log."""
        self._newest.clear()

    def _channel_of(self, message: ViewMessage) -> int:
        key = (message.topic, message.schema_name)
        if key not in self._channels:
            self._channels[key] = channel = {
                "id": len(self._channels) + 1, "topic": message.topic, "encoding": "protobuf",
                "schemaName": message.schema_name, "schema": b64encode(message.schema).decode(),
                "schemaEncoding": "protobuf",
            }  # fmt: skip
            for client in self._clients:
                client.put_words({"op": "advertise", "channels": [channel]})
        number: int = self._channels[key]["id"]
        return number

    def _check(self, link: ServerConnection, request: Request) -> Response | None:
        """Refuses requests for another host (DNS rebinding), and from pages that are not permitted."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].partition(":")[0] not in LOOPBACK:
            return link.respond(HTTPStatus.FORBIDDEN, "request for another host\n")
        for origin in origins:
            if origin not in self._origins:
                self._warn(origin)
                return link.respond(HTTPStatus.FORBIDDEN, "origin is not in foxglove_origins of configs/page.yaml\n")
        if len(self._clients) >= MAX_CLIENTS:
            return link.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_CLIENTS} clients are connected\n")
        return None

    def _warn(self, origin: str) -> None:
        """Names a refused origin once."""
        if origin not in self._warned and len(self._warned) < MAX_WARNED:
            self._warned.add(origin)
            LOG.warning("--foxglove: origin %r is refused; see foxglove_origins in configs/page.yaml", origin[:100])

    async def _talk(self, link: ServerConnection) -> None:
        client = _Client(link)
        client.put_words({
            "op": "serverInfo", "name": self._name, "capabilities": ["time"], "metadata": {},
            "sessionId": self._session,
        })  # fmt: skip
        client.put_words({"op": "advertise", "channels": list(self._channels.values())})
        self._clients.append(client)
        sending = asyncio.create_task(client.send())
        try:
            async for request in link:
                if not self._take(client, request):
                    await link.close(1008, "not a request of the protocol")
        except ConnectionClosed:
            pass
        finally:
            self._clients.remove(client)
            sending.cancel()

    def _take(self, client: "_Client", request: str | bytes) -> bool:
        """Subscribes and unsubscribes; whether the request is one of the protocol. Others have no effect."""
        try:
            values = json.loads(request) if isinstance(request, str) else {}
            op = values.get("op")
            if op == "subscribe":
                for one in values["subscriptions"]:
                    self._subscribe(client, one["id"], one["channelId"])
            elif op == "unsubscribe":
                client.unsubscribe(set(values["subscriptionIds"]))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return False
        return True

    def _subscribe(self, client: "_Client", subscription: object, number: object) -> None:
        if type(subscription) is not int or type(number) is not int or not 0 <= subscription < 1 << 32:
            raise ValueError("numbers are needed")
        if not 1 <= number <= len(self._channels) or number in client.subscriptions:
            return
        client.subscriptions[number] = subscription
        if number in self._newest:
            client.put(number, self._newest[number])


class _Client:
    """What a client has subscribed to (subscription by channel), and what waits to be sent to it."""

    def __init__(self, link: ServerConnection) -> None:
        self._link = link
        self.subscriptions: dict[int, int] = {}
        self._words: deque[str] = deque()
        self._frames: deque[bytes] = deque()
        self._bytes = 0
        self._news = asyncio.Event()

    def unsubscribe(self, subscriptions: set[int]) -> None:
        """Ends subscriptions; unknown ones have no effect."""
        for number in [number for number, one in self.subscriptions.items() if one in subscriptions]:
            del self.subscriptions[number]

    def put(self, number: int, message: ViewMessage) -> None:
        """Queues a message of a channel, if the client has subscribed to it."""
        subscription = self.subscriptions.get(number)
        if subscription is not None and message.data is not None:
            self.put_frame(struct.pack("<BIQ", DATA, subscription, max(0, message.stamp_ns)) + message.data)

    def put_frame(self, frame: bytes) -> None:
        """Queues a binary message; the oldest ones are dropped where there are too many."""
        self._frames.append(frame)
        self._bytes += len(frame)
        while self._bytes > QUEUE_BYTES:
            self._bytes -= len(self._frames.popleft())
        self._news.set()

    def put_words(self, values: dict[str, Any]) -> None:
        """Queues a JSON message, of which there are as many as topics."""
        self._words.append(json.dumps(values))
        self._news.set()

    async def send(self) -> None:
        """Sends what waits until the connection is closed; a client that reads slowly holds up this call alone."""
        try:
            while True:
                await self._news.wait()
                self._news.clear()
                while self._words or self._frames:
                    if self._words:
                        await self._link.send(self._words.popleft())
                        continue
                    frame = self._frames.popleft()
                    self._bytes -= len(frame)
                    await self._link.send(frame)
        except ConnectionClosed:
            pass
