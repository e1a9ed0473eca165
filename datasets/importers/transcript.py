"""A recording written down as a log of ours."""

import json
from collections import Counter
from pathlib import Path

from datasets.importers.recording import SOURCE, Recording, describe
from datasets.log import LogConfig, LogWriter
from datasets.viewer import Viewer, ViewerConfig
from messages.message import Envelope


def write_recording(recording: Recording, out: Path, log: LogConfig, viewer: ViewerConfig) -> dict[str, int]:
    """Write all messages of a recording to the new log `out`; gives their number by topic.

    The description goes with it as metadata `source`. Raises LogError, and then leaves nothing behind.
    """
    about = describe(recording.description)
    metadata = {SOURCE: {"path": str(recording.path), "description": json.dumps(about)}}
    counts: Counter[str] = Counter()
    writer = LogWriter(out, metadata, log, Viewer(viewer, None, None, None))
    try:
        for receive_ns, topic, message in recording.read():
            writer.write(Envelope(topic, counts[topic], receive_ns, message))
            counts[topic] += 1
    except BaseException:
        writer.abandon()
        out.unlink(missing_ok=True)
        raise
    writer.close()
    return dict(counts)
