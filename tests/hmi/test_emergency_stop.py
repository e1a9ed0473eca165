"""The form of the emergency stop against a real order gate: no key, no log-in, flood, foreign origin, no machine."""

import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection
from http.server import ThreadingHTTPServer

import pytest

from hmi.emergency_stop import make_server, serve
from interfaces.orders.config import OrdersConfig
from interfaces.orders.gate import OrderGate
from interfaces.orders.port import OrderPort
from interfaces.orders.sequence import SequenceStore
from interfaces.orders.verifier import OrderVerifier
from messages.command import OperatorCommand, OperatorCommandKind
from tests.hmi.drive_messages import EmptyInbox

CONFIG = OrdersConfig(keys={}, max_per_s=5, max_validity_s=600.0, max_delay_s=3.0, report_s=0.5)


class Machine:
    """An order gate that steps every 10 ms until it is stopped; `commands` are those that it wrote."""

    def __init__(self) -> None:
        self.port = OrderPort(0)
        verifier = OrderVerifier("tractor-1", "session", CONFIG, SequenceStore(None))
        self._gate = OrderGate("tractor-1", "session", verifier, CONFIG.report_s, 0.1, self.port)
        self.commands: list[tuple[float, OperatorCommand]] = []
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._is_over.wait(0.01):
            for _, message in self._gate.step(time.monotonic_ns(), EmptyInbox()):
                if isinstance(message, OperatorCommand):
                    self.commands.append((time.monotonic(), message))

    def stop(self) -> None:
        self._is_over.set()
        self._thread.join()
        self.port.close()


@pytest.fixture
def machine() -> Iterator[Machine]:
    found = Machine()
    yield found
    found.stop()


def served(order_port: int) -> Iterator[ThreadingHTTPServer]:
    server, over = make_server("127.0.0.1", 0), threading.Event()
    server.timeout = 0.05
    thread = threading.Thread(target=serve, args=(server, order_port, lambda sender: over.is_set()))
    thread.start()
    yield server
    over.set()
    thread.join()
    server.server_close()


@pytest.fixture
def server(machine: Machine) -> Iterator[ThreadingHTTPServer]:
    yield from served(machine.port.number)


def request(server: ThreadingHTTPServer, method: str, path: str, **headers: str) -> tuple[int, str]:
    link = HTTPConnection("127.0.0.1", server.server_address[1], timeout=10.0)
    link.request(method, path, headers=headers)
    answer = link.getresponse()
    return answer.status, answer.read().decode()


def test_form_needs_no_script_and_no_log_in(server: ThreadingHTTPServer) -> None:
    code, text = request(server, "GET", "/?lang=zh")
    assert code == 200
    assert "<script" not in text
    assert "急 停" in text
    assert "EMERGENCY STOP" in request(server, "GET", "/")[1]


def test_press_is_an_emergency_stop_at_once(server: ThreadingHTTPServer, machine: Machine) -> None:
    pressed_s = time.monotonic()
    code, text = request(server, "POST", "/stop?lang=en", Origin=f"http://127.0.0.1:{server.server_address[1]}")
    assert code == 200
    assert "The machine has answered" in text
    at_s, command = machine.commands[0]
    assert command.kind is OperatorCommandKind.EMERGENCY_STOP
    assert command.authority == "anyone"
    assert at_s - pressed_s < 1.0  # beside other tests; docs/hmi.md has the measured time


def test_looking_at_the_form_stops_nothing(server: ThreadingHTTPServer, machine: Machine) -> None:
    request(server, "GET", "/stop")
    request(server, "GET", "/?order=emergency_stop")
    assert machine.commands == []


def test_form_on_a_page_of_another_server_is_refused(server: ThreadingHTTPServer, machine: Machine) -> None:
    code, _ = request(server, "POST", "/stop", Origin="http://example.org")
    assert code == 403
    assert machine.commands == []


def test_stop_without_origin_is_taken(server: ThreadingHTTPServer, machine: Machine) -> None:
    """A wrong refusal is worse than a wrong stop: programs send no origin, some browsers `null`."""
    assert request(server, "POST", "/stop")[0] == 200
    assert request(server, "POST", "/stop", Origin="null")[0] == 200
    assert len(machine.commands) >= 2


def test_slow_clients_do_not_hold_the_stop_up(server: ThreadingHTTPServer, machine: Machine) -> None:
    slow = [HTTPConnection("127.0.0.1", server.server_address[1]) for _ in range(50)]
    for link in slow:
        link.connect()
        link.sock.sendall(b"POST /stop HTTP/1.1\r\nContent-Length: 9")
    assert "has answered" in request(server, "POST", "/stop")[1]
    for link in slow:
        link.close()


def test_silent_machine_is_named() -> None:
    port = OrderPort(0)  # open, but nobody reads it
    for server in served(port.number):
        assert "THE MACHINE DOES NOT ANSWER" in request(server, "POST", "/stop")[1]
    port.close()
