"""A drive that a person orders, instead of a scenario."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from interfaces.orders.port import OrderPort


@dataclass(frozen=True)
class Operated:
    """A drive that a person orders by `port`: it ends when it is interrupted or a process dies.

    `announce` is called with the rings by process and the resolved configuration before the processes start.
    """

    port: OrderPort
    announce: Callable[[dict[str, Path], str], None]
