"""Table of an import: every stream of the recording with its messages read and skipped, and the reasons."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from datasets.importers.recording import SOURCE, TopicCount, description_from, table_of
from messages.errors import LogError


def rows_of(table: Iterable[TopicCount]) -> list[dict[str, Any]]:
    """Rows as JSON; `skipped` null where not counted, `topic` "" for a stream that is not read."""
    return [vars(row) | {"reasons": dict(row.reasons)} for row in table]


def rows_of_log(metadata: Mapping[str, Mapping[str, str]], read: Mapping[str, int]) -> list[dict[str, Any]]:
    """Rows of an imported log, empty for another; `read` are its messages by topic. Raises LogError."""
    if SOURCE not in metadata:
        return []
    try:
        return rows_of(table_of(description_from(json.loads(metadata[SOURCE]["description"])), read))
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"metadata {SOURCE!r} has no description of an import ({error!r})") from error


def render(rows: Iterable[Mapping[str, Any]]) -> str:
    """The rows as text, one line per stream and one per reason."""
    lines = [f"  {'stream':<44}{'topic':<36}{'read':>9}{'skipped':>9}"]
    for row in rows:
        skipped = "?" if row["skipped"] is None else row["skipped"]
        lines.append(f"  {row['source']:<44}{row['topic'] or '—':<36}{row['read']:>9}{skipped:>9}")
        lines += [f"      {count or '?'} × {reason}" for reason, count in row["reasons"].items()]
    return "\n".join(lines) + "\n"
