"""Times that nodes take."""

from dataclasses import dataclass

from messages.message import Message


@dataclass(frozen=True)
class NodeTiming(Message):
    """Latency of the steps of a node since the last such message: number of steps, mean and longest (s).

    A latency lasts from the time a step is due until its outputs are sent.
    """

    steps: int
    mean_s: float
    longest_s: float
