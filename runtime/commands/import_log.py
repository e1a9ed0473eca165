"""`headland import`: converts a recording of a known format into a Headland log."""

import argparse
import json
import math
import sys

from datasets.importers.excerpt import excerpt
from datasets.importers.import_table import render, rows_of
from datasets.importers.selection import select
from datasets.importers.truth_sidecar import open_with_truth
from datasets.importers.write_recording import write_recording
from runtime.stack import load_stack


def main(arguments: argparse.Namespace) -> int:
    """Writes the log and the table of all streams; raises LogError and leaves no file in that case."""
    stack = load_stack().datasets
    recording = open_with_truth(arguments.source, arguments.truth, "any")
    if arguments.topics is not None:
        recording = select(recording, [name.strip() for name in arguments.topics.split(",") if name.strip()])
    if arguments.start > 0.0 or arguments.end != math.inf:
        recording = excerpt(recording, arguments.start, arguments.end)
    counts = write_recording(recording, arguments.out, stack.log, stack.viewer)
    about, rows = recording.description, rows_of(recording.table())
    result = {"source": str(arguments.source), "format": about.format, "log": str(arguments.out),
              "messages": counts, "streams": rows, "notes": list(about.notes)}  # fmt: skip
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
        return 0
    sys.stdout.write(render(rows) + "".join(f"  {note}\n" for note in about.notes))
    sys.stdout.write(f"{about.format}: {sum(counts.values())} messages in {arguments.out}\n")
    return 0
