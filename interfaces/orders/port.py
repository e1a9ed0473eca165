"""UDP port on the loopback interface at which programs of this computer hand in orders.

Datagram: signature (64 bytes), public key (32 bytes), payload. The answer to an empty datagram is the status as JSON.
"""

import json
import socket

from interfaces.orders.config import KEY_BYTES
from messages.command import OrderStatus, SignedOrder
from messages.errors import HeadlandError

SIGNATURE_BYTES = 64
MAX_BYTES = 2048
_HEAD = SIGNATURE_BYTES + KEY_BYTES


class OrderPort:
    """Receives orders; raises HeadlandError if the port is taken. `port` 0 is a free one."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise HeadlandError(f"order port {port} cannot be opened ({error})") from error

    @property
    def number(self) -> int:
        """Number of the port."""
        found: int = self._socket.getsockname()[1]
        return found

    def receive(self, now_ns: int, most: int, status: OrderStatus) -> list[SignedOrder]:
        """At most `most` orders received since the last call; answers the questions for the status."""
        orders = []
        for _ in range(most):
            try:
                data, sender = self._socket.recvfrom(MAX_BYTES)
                if not data:
                    self._socket.sendto(encode_status(status), sender)
                    continue
            except OSError:
                break
            key, signature = data[SIGNATURE_BYTES:_HEAD], data[:SIGNATURE_BYTES]
            orders.append(SignedOrder(now_ns, key, signature, data[_HEAD:]))
        return orders

    def close(self) -> None:
        """Closes the port."""
        self._socket.close()


def encode_status(status: OrderStatus) -> bytes:
    """JSON of a status."""
    refused = {one.reason: one.count for one in status.refused}
    content = {"machine": status.machine, "session": status.session, "stamp_ns": status.stamp_ns}
    return json.dumps(content | {"accepted": status.accepted, "refused": refused}).encode()
