"""Translation of the messages of a stream."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from messages.errors import LogError
from messages.message import Message

# Decoded message and receive time (ns) to a Headland message; raises LogError, ValueError and the like.
Translate = Callable[[Any, int], Message]


class NotRead(LogError):
    """A stream that is not read, with the reason."""


@dataclass(frozen=True)
class Translation:
    """Kind of the topic, and the translation; `make` builds one for each pass where it has a state (video)."""

    kind: str
    translate: Translate | None = None
    make: Callable[[], Translate] | None = None

    def start(self) -> Translate:
        """Translation for a new pass."""
        translate = self.make() if self.make is not None else self.translate
        assert translate is not None
        return translate
