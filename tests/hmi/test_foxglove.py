"""Foxglove server: real WebSocket clients, with messages of a ring, of a log that is played, and of a simulation."""

import asyncio
import base64
import json
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from datasets.codec import proto_from
from datasets.reader import LogScan
from hmi.feed import Feed, ViewMessage
from hmi.foxglove import MAX_CLIENTS, QUEUE_BYTES, FoxgloveServer
from messages.command import Mode
from messages.message import Message
from messages.sensors import LidarScan
from runtime.live.ring import RingWriter, make_ring
from runtime.live.serialization import pack
from runtime.page.live_feed import LiveFeed
from runtime.page.views import machine_views
from tests.hmi.browser import page_process
from tests.hmi.drive_messages import NOW_NS, SECOND_NS, demo_scene, fault, map_pose, odometry, supervisor

ORIGIN = "https://viewer.example.org"
PROTOCOL = "foxglove.websocket.v1"
PLAIN: dict[str, Any] = {"subprotocols": [PROTOCOL], "compression": None, "max_size": None, "close_timeout": 0.2}
POINTS = 50
PATIENCE_S = 60.0


class Client:
    """A client; `channels` are advertised by topic, `times_ns` are the times that the server has sent."""

    def __init__(self, link: ClientConnection) -> None:
        self.link = link
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.times_ns: list[int] = []

    async def next(self) -> tuple[str, int, bytes] | None:
        """Topic, time and bytes of the next frame if it has data; subscriptions have the numbers of their channels."""
        frame = await asyncio.wait_for(self.link.recv(), PATIENCE_S)
        if isinstance(frame, str):
            values = json.loads(frame)
            if values["op"] == "serverInfo":
                self.info = values
            else:
                assert values["op"] == "advertise"
                self.channels |= {one["topic"]: one for one in values["channels"]}
            return None
        if frame[0] == 2:
            self.times_ns.append(int.from_bytes(frame[1:9], "little"))
            return None
        assert frame[0] == 1
        number, stamp_ns = int.from_bytes(frame[1:5], "little"), int.from_bytes(frame[5:13], "little")
        topic = next(topic for topic, channel in self.channels.items() if channel["id"] == number)
        return topic, stamp_ns, frame[13:]

    async def until_advertised(self, topic: str) -> None:
        while topic not in self.channels:
            assert await self.next() is None

    async def until_closed(self) -> None:
        while True:
            await self.next()

    async def data(self) -> tuple[str, int, bytes]:
        while True:
            found = await self.next()
            if found is not None:
                return found

    async def subscribe(self, *topics: str) -> None:
        numbers = [self.channels[topic]["id"] for topic in topics]
        await self.link.send(
            json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in numbers]})
        )

    async def unsubscribe(self, topic: str) -> None:
        await self.link.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [self.channels[topic]["id"]]}))


class Stand:
    """A server with the feed of a ring."""

    def __init__(self, folder: Path) -> None:
        make_ring(folder / "ring", 8 << 20)
        self.ring = RingWriter(folder / "ring")
        self.feed = LiveFeed({"ring": folder / "ring"}, views=machine_views(demo_scene()))
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"ws://127.0.0.1:{self.listening.getsockname()[1]}"
        self.server = FoxgloveServer(self.listening, [ORIGIN], "test")
        self.polled: list[str] = []

    def step(self, *messages: tuple[str, Message]) -> None:
        """One update of the page after messages."""
        for one in messages:
            self.ring.write(pack(one))
        self.polled = [envelope.topic for envelope in self.feed.poll()]
        self.server.put(self.feed.views(self.server.read), self.feed.now_ns)

    async def until_read(self, *topics: str) -> None:
        """Waits until the server knows the subscriptions."""
        async with asyncio.timeout(PATIENCE_S):
            while self.server.read != frozenset(topics):
                await asyncio.sleep(0.01)

    async def until_left(self) -> None:
        """Waits until no client is connected."""
        async with asyncio.timeout(PATIENCE_S):
            while self.server.read is not None:
                await asyncio.sleep(0.01)

    @asynccontextmanager
    async def client(self, origin: str | None = None) -> AsyncIterator[Client]:
        """A client that the server, and at the next update the feed, know of."""
        number = len(self.server._clients)
        async with connect(self.url, origin=origin, max_queue=1, **PLAIN) as link:
            async with asyncio.timeout(PATIENCE_S):
                while len(self.server._clients) == number:
                    await asyncio.sleep(0.01)
            self.step()
            yield Client(link)


def run(folder: Path, steps: Callable[[Stand], Awaitable[None]]) -> None:
    """Runs the steps of a test while the server serves."""

    async def serve() -> None:
        stand = Stand(folder)
        serving = asyncio.create_task(stand.server.run())
        try:
            await steps(stand)
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)

    asyncio.run(serve())


def scan(stamp_ns: int = NOW_NS) -> LidarScan:
    """Scan with `POINTS` points on a line."""
    points_m = np.linspace((1.0, 0.0, 0.0), (10.0, 0.0, 0.0), POINTS, dtype=np.float32)
    return LidarScan(
        stamp_ns, np.full((1, POINTS), 100, np.uint16), np.zeros(1), np.zeros(POINTS), points_m,
        np.zeros(POINTS, np.uint8), np.zeros(POINTS, np.float32),
    )  # fmt: skip


def test_a_client_gets_the_topics_that_it_subscribes_to(tmp_path: Path) -> None:
    async def steps(stand: Stand) -> None:
        async with stand.client() as client:
            assert client.link.subprotocol == PROTOCOL
            stand.step(("odom", odometry(1.0, 2.0)), ("map_pose", map_pose()))
            await client.until_advertised("/view/frames")
            assert client.info["capabilities"] == ["time"]
            assert {"/view/machine", "/view/implement", "/view/site", "/view/odom"} <= client.channels.keys()
            await client.subscribe("/view/odom")
            await stand.until_read("/view/odom")
            assert (await client.data())[:2] == ("/view/odom", NOW_NS)  # the newest one at once
            later_ns = NOW_NS + SECOND_NS
            stand.step(("odom", odometry(3.0, 4.0, stamp_ns=later_ns)), ("map_pose", map_pose(stamp_ns=later_ns)))
            topic, stamp_ns, data = await client.data()
            assert (topic, stamp_ns) == ("/view/odom", later_ns)
            channel = client.channels[topic]
            shown = proto_from(channel["schemaName"], _schema(channel)).FromString(data)
            assert (shown.x_m, shown.y_m) == (3.0, 4.0)
            await client.unsubscribe("/view/odom")
            await stand.until_read()
            stand.step(("odom", odometry(5.0, 6.0, stamp_ns=later_ns + SECOND_NS)))
            while client.times_ns[-1:] != [later_ns + SECOND_NS]:
                assert await client.next() is None
        assert client.times_ns == sorted(client.times_ns)

    run(tmp_path, steps)


def test_a_scan_is_decoded_for_a_subscription_alone(tmp_path: Path) -> None:
    async def steps(stand: Stand) -> None:
        async with stand.client() as client:
            stand.step(("lidar/front", scan()))
            assert stand.polled == []
            await client.until_advertised("/view/lidar/front")
            await client.subscribe("/view/lidar/front")
            await stand.until_read("/view/lidar/front")
            stand.step()
            stand.step(("lidar/front", scan(NOW_NS + SECOND_NS)))
            assert stand.polled == ["lidar/front"]
            topic, stamp_ns, data = await client.data()
            assert (topic, stamp_ns) == ("/view/lidar/front", NOW_NS + SECOND_NS)
            assert len(PointCloud.FromString(data).data) >= POINTS * 12
        await stand.until_left()
        stand.step()
        stand.step(("lidar/front", scan(NOW_NS + 2 * SECOND_NS)))
        assert stand.polled == []

    run(tmp_path, steps)


def test_what_came_once_before_the_client_is_not_missed(tmp_path: Path) -> None:
    async def steps(stand: Stand) -> None:
        stand.step(("fault/supervisor", fault(True)))
        async with stand.client() as client:
            await client.until_advertised("/view/log")
            await client.subscribe("/view/log")
            assert (await client.data())[0] == "/view/log"

    run(tmp_path, steps)


def test_a_slow_client_loses_the_oldest_messages_and_delays_nobody(tmp_path: Path) -> None:
    size, number = 1 << 20, 100

    async def steps(stand: Stand) -> None:
        def put(stamp_ns: int) -> None:
            stand.server.put([ViewMessage("/view/x", "X", b"", stamp_ns, bytes(size))], stamp_ns)

        put(0)
        async with stand.client() as slow, stand.client() as fast:
            for client in (slow, fast):
                await client.until_advertised("/view/x")
                await client.subscribe("/view/x")
                assert (await client.data())[1] == 0
            for k in range(1, number + 1):
                put(k)
                assert (await fast.data())[1] == k
            got = [(await slow.data())[1]]
            while got[-1] != number:
                got.append((await slow.data())[1])
        assert got == sorted(got)
        assert QUEUE_BYTES // size - 1 <= len(got) < number // 2  # what was queued, and what the sockets hold

    run(tmp_path, steps)


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ({"origin": "https://other.example.org"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "http://127.0.0.1:1"}, 403),
        ({"additional_headers": {"Host": "rebound.example.org"}}, 403),
        ({"subprotocols": None}, 400),
        ({"subprotocols": ["other"]}, 400),
    ],
)
def test_foreign_pages_and_hosts_are_refused(tmp_path: Path, words: dict[str, Any], status: int) -> None:
    async def steps(stand: Stand) -> None:
        with pytest.raises(InvalidStatus) as refused:
            async with connect(stand.url, **(PLAIN | words)):
                pass
        assert refused.value.response.status_code == status
        async with stand.client(ORIGIN) as client:  # configured
            assert client.link.subprotocol == PROTOCOL

    run(tmp_path, steps)


def test_clients_are_limited(tmp_path: Path) -> None:
    async def steps(stand: Stand) -> None:
        clients = [await connect(stand.url, **PLAIN) for _ in range(MAX_CLIENTS)]
        await asyncio.gather(*(client.recv() for client in clients))
        with pytest.raises(InvalidStatus) as refused:
            await connect(stand.url, **PLAIN)
        assert refused.value.response.status_code == 503
        await asyncio.gather(*(client.close() for client in clients))
        await stand.until_left()
        async with stand.client() as client:
            assert await client.next() is None

    run(tmp_path, steps)


@pytest.mark.parametrize(
    "request_text",
    [
        "no json", "[]", '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [{"id": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1e400, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": "1"}]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}', "[" * 60000, "x" * 100_000,
    ],
)  # fmt: skip
def test_a_request_that_is_none_ends_its_connection_alone(tmp_path: Path, request_text: str) -> None:
    async def steps(stand: Stand) -> None:
        stand.step(("supervisor", supervisor(Mode.STANDBY)))
        async with stand.client() as other, stand.client() as client:
            await client.link.send(request_text)
            with pytest.raises(ConnectionClosed):
                await client.until_closed()
            stand.step(("odom", odometry(0.0, 0.0)))
            await other.until_advertised("/view/odom")
            await other.link.send(b"\1\0\0\0\0orders")  # no effect
            await other.link.send('{"op": "advertise", "channels": []}')
            await other.subscribe("/view/odom", "/view/odom")
            assert (await other.data())[0] == "/view/odom"

    run(tmp_path, steps)


def test_without_views_a_feed_has_none() -> None:
    class Empty(Feed):
        def poll(self) -> list[Any]:
            return []

    assert list(Empty().views(frozenset())) == []


def test_a_page_plays_the_viewer_topics_of_a_log(log: Path, tmp_path: Path) -> None:
    logged: dict[str, set[bytes]] = {}
    for entry in LogScan(log):
        if entry.topic.startswith("/view/"):
            logged.setdefault(entry.topic, set()).add(entry.data)

    async def play(url: str) -> dict[str, set[bytes]]:
        async with connect(url, **PLAIN) as link:
            client, seen = Client(link), dict[str, set[bytes]]()
            wanted = {"/view/lidar/front", "/view/frames", "/view/machine"}
            for topic in wanted:
                await client.until_advertised(topic)
            await client.subscribe(*wanted)
            while wanted - seen.keys() or len(seen["/view/frames"]) < 5:
                topic, _, data = await client.data()
                seen.setdefault(topic, set()).add(data)
            return seen

    with page_process(tmp_path, "--replay", str(log), "--foxglove", "0") as process:
        seen = asyncio.run(play(process.foxglove_url))
    assert all(found <= logged[topic] for topic, found in seen.items())


@pytest.mark.slow
@pytest.mark.drive
def test_a_page_shows_its_simulation(tmp_path: Path) -> None:
    async def read(url: str) -> None:
        async with connect(url, **PLAIN) as link:
            client = Client(link)
            await client.until_advertised("/view/lidar/front")
            await client.subscribe("/view/lidar/front")
            topic, stamp_ns, data = await client.data()
            cloud = PointCloud.FromString(data)
            assert topic == "/view/lidar/front"
            assert cloud.frame_id == "lidar/front"
            assert len(cloud.data) > 0
            assert stamp_ns == cloud.timestamp.seconds * SECOND_NS + cloud.timestamp.nanos

    mission = ("--mission", "line", "--scenario", "empty", "--stop-port", "0", "--foxglove", "0")
    with page_process(tmp_path, *mission) as process:
        asyncio.run(read(process.foxglove_url))


def _schema(channel: dict[str, Any]) -> bytes:
    return base64.b64decode(channel["schema"])
