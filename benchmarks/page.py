"""The operator's page under load, with real processes on the loopback interface (docs/hmi.md).

    ./headland benchmark page [--live] [--presses 100] [--seconds 15] [--clients 100] [--out FOLDER]

A simulated machine drives a row, with `--live` in one process per part as a machine does; this program is its operator,
by the key of the page. Measured: time from a press of the emergency stop to the brake frame of the gateway; processor
time of the page for one and for ten open pages; whether the machine drives on and others are served while many clients
connect and one reads nothing; the stop while the page is frozen (SIGSTOP); and whether all processes end after kill -9.
Exit code 1 if something stopped that should not, or did not that should.
"""

import argparse
import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import socketio

from hmi.orders import OrderSender, read_key
from messages.command import CanFrame, CanFrames, Mode, OrderStatus, RefusedOrders, SafeCommand
from runtime.live.reactions import requested_mps2
from runtime.live.ring import RingReader
from runtime.live.ring_folder import RINGS_PREFIX
from runtime.live.serialization import topic_of, unpack
from runtime.run_folder import ROOT
from tests.hmi.planned import row_mission

COMMAND = ("--scenario", "empty", "--port", "0", "--stop-port", "0", "--state", "state")
WAIT_S = 120.0
PRESENT_S, AGAIN_S = 1.0, 5.0
TICKS = os.sysconf("SC_CLK_TCK")


class Machine:
    """The page with its simulation: addresses, ring of messages, and the operator of this program."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
        command = [sys.executable, "-m", "runtime", "page", *arguments, *COMMAND]
        self.process = subprocess.Popen(command, cwd=folder, env=env, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        text = ""
        for line in self.process.stdout:
            text += line
            if line.startswith("Ctrl+C"):
                break
        self.url, self.stop_url = (_found(rf"^{name}: (\S+)$", text) for name in ("page", "emergency stop"))
        self.password = _found(r"password (\S+)", text)
        self.children = descendants(self.process.pid)
        self._readers = [RingReader(ring) for ring in {path for pid in self.children for path in rings_of(pid)}]
        self.port = next(port for pid in self.children for port in ports_of(pid) if asked(port) is not None)
        self._sender = OrderSender(read_key(folder / "state" / "order_key.pem"), "operator", self.port)
        self.mode: Mode | None = None
        self.stop_ns: int | None = None  # first command of an emergency stop since it was None
        self.frames: tuple[CanFrame, ...] = ()  # of the newest message of the gateway
        self.frames_ns = 0
        self._presented_s = 0.0

    def order(self, name: str) -> None:
        """Gives a signed order."""
        found = asked(self.port)
        assert found is not None
        refused = tuple(RefusedOrders(*one) for one in found["refused"].items())
        status = OrderStatus(found["stamp_ns"], found["machine"], found["session"], found["accepted"], refused)
        self._sender.send(name, status, status.stamp_ns, 10.0)

    def records(self) -> Iterator[str]:
        """Topics of new messages; the mode is that of the newest command to the machine."""
        if time.monotonic() - self._presented_s > PRESENT_S:
            self._presented_s = time.monotonic()
            with suppress(AssertionError):
                self.order("present")
        for record in (record for reader in self._readers for record in reader.records()):
            topic = topic_of(record)
            if topic == "safe_command" and (found := unpack(record, None)) is not None:
                assert isinstance(found[1], SafeCommand)
                self.mode = found[1].mode
                if self.mode is Mode.EMERGENCY_STOP and self.stop_ns is None:
                    self.stop_ns = found[1].stamp_ns
            elif topic == "can/tx" and (found := unpack(record, None)) is not None:
                assert isinstance(found[1], CanFrames)
                self.frames, self.frames_ns = found[1].frames, found[1].stamp_ns
            yield topic

    def until(self, is_reached: Callable[[], bool], limit_s: float = WAIT_S) -> None:
        """Follows the messages until a condition holds; raises SystemExit."""
        end_s = time.monotonic() + limit_s
        while not is_reached():
            if time.monotonic() > end_s:
                raise SystemExit(f"not reached within {limit_s:.0f} s; the machine is in mode {self.mode}")
            for _ in self.records():
                pass
            time.sleep(0.01)

    def reach(self, mode: Mode, *orders: str) -> None:
        """Gives orders, again after a time, until a mode is reached; a moving machine is not released."""
        end_s = time.monotonic() + WAIT_S
        while self.mode is not mode and time.monotonic() < end_s:
            for order in orders:
                self.order(order)
                time.sleep(0.3)
            again_s = time.monotonic() + AGAIN_S
            while self.mode is not mode and time.monotonic() < again_s:
                for _ in self.records():
                    pass
                time.sleep(0.01)
        self.until(lambda: self.mode is mode, 0.0)

    def _brakes(self) -> list[CanFrame]:
        """Frames of the newest message that demand the brakes since the command of an emergency stop."""
        if self.stop_ns is None:
            return []
        after = (frame for frame in self.frames if frame.stamp_ns >= self.stop_ns)
        return [frame for frame in after if requested_mps2(frame.identifier, frame.data) > 0.0]

    def press(self) -> float:
        """Presses the emergency stop; seconds until the first brake frame of the gateway that follows the command.

        Frames arrive in a message ten times a second: what they waited for it, by their stamps, is taken off.
        """
        sent = subprocess.Popen(
            [sys.executable, "-c", PRESS, self.stop_url], stdout=subprocess.PIPE, text=True
        )  # it tells when it presses: its own start does not count
        assert sent.stdout is not None
        began_s = float(sent.stdout.readline())
        self.stop_ns = None
        while time.monotonic() < began_s + WAIT_S:
            for _ in self.records():
                if brakes := self._brakes():
                    waited_s = 1e-9 * (self.frames_ns - brakes[0].stamp_ns)
                    seconds = time.monotonic() - began_s - waited_s
                    sent.wait()
                    return seconds
            time.sleep(0.001)
        raise SystemExit(f"no emergency stop within {WAIT_S:.0f} s")


PRESS = """
import sys, time, urllib.request
print(time.monotonic(), flush=True)
urllib.request.urlopen(urllib.request.Request(sys.argv[1].split("?")[0] + "stop", data=b""), timeout=60).read()
"""


class Page:
    """An open page as a browser has it, without drawing: counts the updates."""

    def __init__(self) -> None:
        self.updates = 0
        self._session: aiohttp.ClientSession | None = None
        self._link = socketio.AsyncClient(reconnection=False)

    async def open(self, machine: Machine, cookie: str) -> None:
        """Loads the page and connects."""
        self._session = aiohttp.ClientSession(headers={"Cookie": cookie})
        async with self._session.get(machine.url) as answer:
            text = await answer.text()
        client = _found(r"[\"']client_id[\"']:\s*[\"']([0-9a-f-]+)[\"']", text)
        query = {"client_id": client, "tab_id": client, "old_tab_id": "", "document_id": client, "next_message_id": "0"}
        self._link.on("run_javascript", self._count)
        await self._link.connect(
            f"{machine.url}?{urllib.parse.urlencode(query)}", headers={"Cookie": cookie}, transports=["websocket"],
            socketio_path="/_nicegui_ws/socket.io", wait_timeout=30,
        )  # fmt: skip
        if not await self._link.call("handshake", query, timeout=30):
            raise SystemExit("the page refused the connection")

    def _count(self, message: Any) -> None:
        self.updates += "headland.update" in json.dumps(message)

    async def close(self) -> None:
        """Leaves the page."""
        await self._link.disconnect()
        if self._session is not None:
            await self._session.close()


async def log_in(machine: Machine) -> str:
    """Cookie of a session."""
    values = {"name": "operator", "password": machine.password}
    async with (
        aiohttp.ClientSession() as session,
        session.post(f"{machine.url}log-in", data=values, allow_redirects=False) as answer,
    ):
        return answer.headers["Set-Cookie"].split(";")[0]


async def watched(machine: Machine, seconds: float, page: Page | None = None) -> dict[str, float]:
    """Processor time of the page (share of a core), longest gap of commands to the machine (s), and updates (Hz)."""
    for _ in machine.records():
        pass
    began_s = newest_s = time.monotonic()
    used_s, updates, gap_s = processor_s(machine.process.pid), page.updates if page else 0, 0.0
    while time.monotonic() - began_s < seconds:
        for topic in machine.records():
            if topic == "safe_command":
                now_s = time.monotonic()
                gap_s, newest_s = max(gap_s, now_s - newest_s), now_s
        await asyncio.sleep(0.005)
    elapsed_s = time.monotonic() - began_s
    return {
        "core_share": round((processor_s(machine.process.pid) - used_s) / elapsed_s, 4),
        "longest_gap_s": round(max(gap_s, time.monotonic() - newest_s), 3),
        "updates_hz": round((page.updates - updates) / elapsed_s, 2) if page else 0.0,
    }


async def under_load(machine: Machine, seconds: float, clients: int) -> dict[str, Any]:
    """Processor time with one and ten pages; then many clients, and one that reads nothing; the machine drives."""
    rows: dict[str, Any] = {}
    os.nice(5)  # the clients are other devices
    machine.reach(Mode.AUTOMATIC, "confirm_clear", "start")
    cookie = await log_in(machine)
    pages = [Page()]
    await pages[0].open(machine, cookie)
    rows["one_page"] = await watched(machine, seconds, pages[0])
    for _ in range(9):
        pages.append(Page())
        await pages[-1].open(machine, cookie)
    rows["ten_pages"] = await watched(machine, seconds, pages[0])
    while len(pages) < clients:
        pages.append(Page())
        await pages[-1].open(machine, cookie)
        for _ in machine.records():  # the operator says that he is there
            pass
    rows["clients"] = await watched(machine, seconds, pages[0]) | {"number": len(pages)}
    for page in pages[1:]:
        await page.close()
    silent = await silent_client(machine, cookie)
    before_mb = sum(memory_mb(machine.process.pid))
    rows["slow_client"] = await watched(machine, seconds, pages[0])
    rows["slow_client"]["resident_mb_more"] = round(sum(memory_mb(machine.process.pid)) - before_mb, 1)
    silent.close()
    await pages[0].close()
    return rows


async def silent_client(machine: Machine, cookie: str) -> socket.socket:
    """A client that has asked for the page ten times and reads no answer."""
    address = urllib.parse.urlsplit(machine.url)
    link = socket.create_connection((address.hostname, address.port))
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    link.sendall(f"GET / HTTP/1.1\r\nHost: {address.netloc}\r\nCookie: {cookie}\r\n\r\n".encode() * 10)
    return link


def _found(pattern: str, text: str) -> str:
    match = re.search(pattern, text, re.MULTILINE)
    if match is None:
        raise SystemExit(f"the page did not say {pattern}: {text[:500]}")
    return match[1]


def processor_s(pid: int) -> float:
    """Processor time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory_mb(pid: int) -> list[float]:
    """Resident memory of a process by kind: anonymous, of files, and shared: the rings, the same pages in each."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return [float(status[kind].split()[0]) * 1024 / 1e6 for kind in ("RssAnon", "RssFile", "RssShmem")]


def descendants(pid: int) -> list[int]:
    """Child processes and theirs."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if int(path.read_text().rpartition(")")[2].split()[1]) == pid:
                found += [int(path.parent.name), *descendants(int(path.parent.name))]
    return found


def ports_of(pid: int) -> list[int]:
    """UDP ports on the loopback interface that a process has open."""
    links = [os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir() if path.is_symlink()]
    inodes = {link[8:-1] for link in links if link.startswith("socket:[")}
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return [int(row[1].split(":")[1], 16) for row in rows if row[9] in inodes and row[1].startswith("0100007F")]


def rings_of(pid: int) -> set[Path]:
    """Rings of messages that a process has in its memory."""
    words = (line.split() for line in Path(f"/proc/{pid}/maps").read_text().splitlines())
    return {Path(word[-1]) for word in words if RINGS_PREFIX in word[-1]}


def asked(port: int) -> dict[str, Any] | None:
    """Answer of an order port, None without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(5.0)
        try:
            link.sendto(b"", ("127.0.0.1", port))
            found: dict[str, Any] = json.loads(link.recv(4096))
        except (OSError, ValueError):
            return None
        return found


@contextmanager
def machine_in(folder: Path, *arguments: str) -> Iterator[Machine]:
    """A machine, given arguments of the page, that is ended with all its processes."""
    machine = Machine(folder, *arguments)
    try:
        machine.until(lambda: machine.mode is Mode.STANDBY)
        yield machine
    finally:
        machine.process.send_signal(signal.SIGCONT)
        machine.process.terminate()
        machine.process.wait(60.0)


def main() -> int:
    """Prints one line of JSON for each measure."""
    parser = argparse.ArgumentParser(description="the operator's page under load")
    parser.add_argument("--live", action="store_true", help="one process per part")
    parser.add_argument("--presses", type=int, default=100, help="presses of the emergency stop")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measure under load")
    parser.add_argument("--clients", type=int, default=100)
    parser.add_argument("--out", type=Path, help="folder of the runs (default: a new one)")
    arguments = parser.parse_args()
    top = arguments.out or Path(tempfile.mkdtemp(prefix="page-"))
    top.mkdir(parents=True, exist_ok=True)
    is_right = True
    (top / "row.yaml").write_text(row_mission(1), encoding="utf-8")
    with machine_in(top, "--mission", "row.yaml", *(["--live"] if arguments.live else [])) as machine:
        rows = asyncio.run(under_load(machine, arguments.seconds, arguments.clients))
        for name, row in rows.items():
            print(json.dumps({name: row}), flush=True)
        drives_on = machine.mode in (Mode.AUTOMATIC, Mode.FINISHED)
        is_right &= drives_on
        print(json.dumps({"drives_on": drives_on}), flush=True)
        seconds = []
        for _ in range(arguments.presses):
            seconds.append(machine.press())
            machine.reach(Mode.STANDBY, "reset")
        low, high = (round(1e3 * float(np.percentile(seconds, q)), 1) for q in (50, 99))
        stop = {"presses": len(seconds), "median_ms": low, "p99_ms": high, "maximum_ms": round(1e3 * max(seconds), 1)}
        print(json.dumps({"stop_to_frame": stop}), flush=True)
        machine.process.send_signal(signal.SIGSTOP)
        print(json.dumps({"stop_while_frozen_ms": round(1e3 * machine.press(), 1)}), flush=True)
        machine.process.send_signal(signal.SIGCONT)
        machine.process.kill()
        end_s = time.monotonic() + WAIT_S
        while (left := [pid for pid in machine.children if is_running(pid)]) and time.monotonic() < end_s:
            time.sleep(0.2)
        is_right &= not left
        print(json.dumps({"processes_after_kill": len(left)}), flush=True)
    return 0 if is_right else 1


def is_running(pid: int) -> bool:
    """Whether a process is there, and is not waiting for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


if __name__ == "__main__":
    sys.exit(main())
