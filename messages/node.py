"""The node contract: what a node reads and how, what it writes and when it runs."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from messages.message import Message


@dataclass(frozen=True)
class Latest:
    """Read the newest message of the topic."""


@dataclass(frozen=True)
class All:
    """Read all messages since the last step, the newest `most` if there were more."""

    most: int


@dataclass(frozen=True)
class At:
    """Read the topic at a given time, interpolated within the last `keep_s` seconds."""

    keep_s: float


@dataclass(frozen=True)
class Every:
    """Run at a fixed period, counted from the start of the run."""

    period_ns: int


@dataclass(frozen=True)
class On:
    """Run whenever a message comes on one of these topics."""

    topics: tuple[str, ...]


M = TypeVar("M", bound=Message)
Read = Latest | All | At
Trigger = Every | On
Output = tuple[str, Message]


class Inbox(Protocol):
    """What a node may know when it steps; staleness follows from the topic table."""

    def latest(self, topic: str, kind: type[M]) -> M | None:
        """The newest message, or None when there is none or it is older than its topic allows."""

    def last(self, topic: str, kind: type[M]) -> M | None:
        """The newest message however old."""

    def all(self, topic: str, kind: type[M]) -> tuple[M, ...]:
        """Messages since the last step, oldest first."""

    def at(self, topic: str, kind: type[M], stamp_ns: int) -> M | None:
        """The message interpolated to a time, or None when that time is not covered."""


class Node(ABC):
    """One part of the stack; its state is its attributes, all set in `__init__`; it reads no clock and never sleeps."""

    name: str
    reads: Mapping[str, Read]
    writes: tuple[str, ...]
    runs: Trigger

    @abstractmethod
    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """React to what has come; what is returned is delivered after the node's latency."""


class World(ABC):
    """What lies outside the stack: simulation, a log or a machine; the only part that differs between them."""

    writes: tuple[str, ...]

    @abstractmethod
    def next_ns(self) -> int | None:
        """When something happens next, or None at the end."""

    @abstractmethod
    def step(self, now_ns: int) -> Iterable[Output]:
        """Go on to `now_ns` (what `next_ns` said) and give what is received then."""
