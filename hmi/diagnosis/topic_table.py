"""Messages per second and age of each topic."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from messages.topics import TOPICS

WINDOW_S = 3.0


@dataclass(frozen=True)
class TopicRow:
    """Rate over `WINDOW_S` and time since the last message; `is_late`: older than the topic table allows."""

    topic: str
    rate_hz: float
    expected_hz: float | None
    age_s: float
    is_late: bool


class TopicTable:
    """Counts of messages by topic; times are those of a monotonic clock (s)."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._arrived_s: dict[str, float] = {}
        self._history: deque[tuple[float, dict[str, int]]] = deque()

    def take(self, counts: Mapping[str, int], now_s: float) -> None:
        """Processes the number of messages by topic since the start."""
        for topic, count in counts.items():
            if count != self._counts.get(topic):
                self._arrived_s[topic] = now_s
        self._counts = dict(counts)
        self._history.append((now_s, self._counts))
        while len(self._history) > 1 and now_s - self._history[1][0] >= WINDOW_S:
            self._history.popleft()

    def rows(self, now_s: float) -> list[TopicRow]:
        """All topics by name, without those of the truth of a simulation."""
        found = []
        began_s, before = self._history[0] if self._history else (now_s, {})
        span_s = now_s - began_s
        for topic, count in sorted(self._counts.items()):
            rate_hz = (count - before.get(topic, 0)) / span_s if span_s > 0.0 else 0.0
            kind = topic.partition("/")[0]
            if kind not in TOPICS or kind.startswith("truth"):
                continue
            spec = TOPICS[kind]
            age_s = now_s - self._arrived_s[topic]
            expected_hz = 1.0 / spec.period_s if spec.period_s > 0.0 else None
            found.append(TopicRow(topic, rate_hz, expected_hz, age_s, age_s > spec.max_age_s + 1.0))
        return found
