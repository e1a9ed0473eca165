"""Simulated drives of the page, one after the other at the same order port; one that fails leaves room for the next."""

import asyncio
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hmi.parts import Drive
from hmi.plan_view.mission_store import StoredMission
from hmi.setup_view.store import SetupStore
from interfaces.orders.config import ORDERS, OrderKey
from interfaces.orders.port import OrderPort
from runtime.commands.options import parse_arguments
from runtime.page.drives import SimulatedDrives
from tests.hmi.planned import PLANNER, desk_in, geojson
from tests.recordings import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.drive]
PATIENCE_S = 60.0


def waited(look: Callable[[], Any]) -> Any:
    """The first result that is neither None nor empty."""
    until_s = time.monotonic() + PATIENCE_S
    while not (found := look()):
        assert time.monotonic() < until_s
        time.sleep(0.1)
    return found


def status(port: int) -> dict[str, Any]:
    """Answer of the order gate of the running drive, empty without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(0.5)
        link.sendto(b"", ("127.0.0.1", port))
        try:
            found: dict[str, Any] = json.loads(link.recv(4096))
        except OSError:
            return {}
        return found


def topics(drive: Drive) -> set[str]:
    """Topics of the messages that have arrived."""
    drive.feed.poll()
    return {topic for topic, count in drive.feed.counts.items() if count}


@pytest.fixture
def mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StoredMission:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    async def stored() -> StoredMission:
        desk = desk_in(tmp_path, PLANNER, 240.0)
        desk.set_option("implement", "harrow_6m", "anna")
        await desk.load({"corner.geojson": geojson()})
        await desk.make_plan()
        return desk.store_mission("corner", "anna")

    return asyncio.run(stored())


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int) -> Iterator[SimulatedDrives]:
    monkeypatch.chdir(tmp_path)
    order_port = OrderPort(port)
    arguments = parse_arguments(["page", "--mission", "line", "--scenario", "empty"])
    key = OrderKey(public_key="00" * 32, authority="operator", orders=tuple(ORDERS), lost_operator_s=None)
    found = SimulatedDrives(arguments, order_port, key, SetupStore(tmp_path / "setup.db"))
    order_port.close()
    yield found
    found.end()
    assert not [line for line in os.popen(f"ps -o pid= --ppid {os.getpid()}") if int(line) == found._process.pid]


def test_drives_follow_each_other_with_the_same_port_and_another_session(
    drives: SimulatedDrives, mission: StoredMission, port: int
) -> None:
    first = drives.first()
    assert first.scene.site.name != "corner field"
    session = waited(lambda: status(port))["session"]
    waited(lambda: "odom" in topics(first))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:  # an old order that waits at the port
        link.sendto(bytes(96) + json.dumps({"session": session, "order": "start"}).encode(), ("127.0.0.1", port))
    drives.start(mission)
    second = waited(drives.take)
    assert isinstance(second, Drive)
    assert second.scene.site.name == "corner field"
    assert second.name != first.name
    found = waited(lambda: status(port))
    assert found["session"] != session  # no order for the first drive counts
    waited(lambda: topics(second) >= {"odom", "lidar/front", "supervisor"})
    assert len(list(Path("runs").glob("*-page*"))) == 2


def test_a_mission_that_cannot_be_loaded_is_reported_and_another_one_starts(
    drives: SimulatedDrives, mission: StoredMission, port: int
) -> None:
    drives.first()
    mission.field.rename(mission.folder / "away")
    drives.start(mission)
    assert waited(drives.take) == f"{mission.folder / 'field'}: an empty folder"
    assert status(port) == {}
    (mission.folder / "away").rename(mission.folder / "field" / "corner.geojson")
    drives.start(mission)
    again = waited(drives.take)
    assert isinstance(again, Drive)
    assert waited(lambda: status(port))
