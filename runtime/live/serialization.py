"""Serialization of messages as ring records: topic, then the message in log encoding."""

from collections.abc import Container

from datasets.codec import codec_of
from messages.errors import LogError, WiringError
from messages.node import Output
from messages.topics import spec_of


def pack(output: Output) -> bytes:
    """Record of a message."""
    topic, message = output
    return header(topic) + codec_of(type(message)).encode(message)


def header(topic: str) -> bytes:
    """First bytes of a record: the topic."""
    name = topic.encode()
    return bytes([len(name)]) + name


def unpack(record: bytes, wanted: Container[str] | None) -> Output | None:
    """Message of a record, or None for an unwanted topic or an invalid record; `wanted` None accepts all topics."""
    end = 1 + record[0]
    try:
        topic = record[1:end].decode()
        if wanted is not None and topic not in wanted:
            return None
        return topic, codec_of(spec_of(topic).type).decode(record[end:])
    except (UnicodeDecodeError, LogError, WiringError):
        return None


def topic_of(record: bytes) -> str:
    """Topic of a record, "" for an invalid one."""
    return record[1 : 1 + record[0]].decode(errors="ignore")
