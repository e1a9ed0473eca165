"""Digest over all messages of a log; equal for two runs of one seed."""

import hashlib
import struct


class Digest:
    """Running BLAKE2b over (topic, stamp, encoded message), in the order of the log."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, topic: str, stamp_ns: int, payload: bytes) -> None:
        """Adds one message with its lengths, so that different sequences have different input."""
        name = topic.encode()
        self._hash.update(struct.pack("<IqQ", len(name), stamp_ns, len(payload)) + name)
        self._hash.update(payload)

    def text(self) -> str:
        """The digest so far, 32 hexadecimal digits."""
        return self._hash.hexdigest()
