"""Node interface: inputs, outputs and trigger of a node; world interface."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from messages.message import Message


@dataclass(frozen=True)
class Latest:
    """Reads the newest message of the topic."""


@dataclass(frozen=True)
class All:
    """Reads all messages since the last step, at most the newest `most`."""

    most: int


@dataclass(frozen=True)
class At:
    """Reads the topic at a given time, interpolated within the last `keep_s` seconds."""

    keep_s: float


@dataclass(frozen=True)
class Every:
    """Runs at a fixed period from the start of the run."""

    period_ns: int


@dataclass(frozen=True)
class On:
    """Runs at each message on one of the topics."""

    topics: tuple[str, ...]


M = TypeVar("M", bound=Message)
Read = Latest | All | At
Trigger = Every | On
Output = tuple[str, Message]


class Inbox(Protocol):
    """Inputs of a node step; the maximum ages are those of the topic table."""

    def latest(self, topic: str, kind: type[M]) -> M | None:
        """Newest message; None without one, or when it is older than the maximum age of its topic."""

    def last(self, topic: str, kind: type[M]) -> M | None:
        """Newest message of any age."""

    def all(self, topic: str, kind: type[M]) -> tuple[M, ...]:
        """Messages since the last step, oldest first."""

    def at(self, topic: str, kind: type[M], stamp_ns: int) -> M | None:
        """Message interpolated to a time; None outside the stored interval."""


class Node(ABC):
    """Part of the stack; its state is in attributes set in `__init__`; it reads no clock and never sleeps."""

    name: str
    reads: Mapping[str, Read]
    writes: tuple[str, ...]
    runs: Trigger

    @abstractmethod
    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Processes the inputs; outputs are delivered after the latency of the node."""


class World(ABC):
    """Environment of the stack: simulation, log or machine."""

    writes: tuple[str, ...]

    @abstractmethod
    def next_ns(self) -> int | None:
        """Time of the next step, or None at the end."""

    @abstractmethod
    def step(self, now_ns: int) -> Iterable[Output]:
        """Advances to `now_ns`, the result of `next_ns`; returns the messages received then."""
