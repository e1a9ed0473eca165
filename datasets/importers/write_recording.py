"""Writing of a recording as a Headland log."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

from datasets.disk import new_file
from datasets.importers.mcap_logs import OWN
from datasets.importers.recording import SOURCE, Ignored, Recording, describe
from datasets.log import LogConfig, LogWriter
from datasets.reader import END, read_metadata
from datasets.viewer import Viewer, ViewerConfig
from messages.message import Envelope


def write_recording(recording: Recording, out: Path, log: LogConfig, viewer: ViewerConfig) -> dict[str, int]:
    """Writes all messages of a recording to the new log `out`; returns their number by topic.

    The description is stored as metadata `source`, and again at the end, with the skipped messages; a Headland log
    keeps its metadata. Raises LogError, and then leaves no file.
    """
    own = read_metadata(recording.path) if recording.description.format == OWN and recording.path.is_file() else {}
    metadata = {name: values for name, values in own.items() if name != END}
    metadata[SOURCE] = _source(recording)
    counts: Counter[str] = Counter()
    with new_file(out) as fresh:
        writer = LogWriter(fresh, metadata, log, Viewer(viewer, None, None, None, recording.description.cameras))
        try:
            for receive_ns, topic, message in recording.read():
                writer.write(Envelope(topic, counts[topic], receive_ns, message))
                counts[topic] += 1
            writer.add_metadata(SOURCE, _source(recording))
        except BaseException:
            writer.abandon()
            raise
        writer.close()
    return dict(counts)


def _source(recording: Recording) -> dict[str, str]:
    skipped = (
        Ignored(row.source, row.source_type, reason, None if row.skipped is None else count)
        for row in recording.table()
        for reason, count in row.reasons.items()
    )
    about = replace(recording.description, ignored=tuple(skipped))
    return {"path": str(recording.path), "description": json.dumps(describe(about))}
