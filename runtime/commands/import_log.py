"""`headland import`: converts a recording of a known format into a Headland log."""

import argparse
import json
import math
import sys

from datasets.importers.excerpt import excerpt
from datasets.importers.truth_sidecar import open_with_truth
from datasets.importers.write_recording import write_recording
from runtime.stack import load_stack


def main(arguments: argparse.Namespace) -> int:
    """Writes the log; raises LogError and leaves no file in that case."""
    stack = load_stack().datasets
    recording = open_with_truth(arguments.source, arguments.truth, "any")
    if arguments.start > 0.0 or arguments.end != math.inf:
        recording = excerpt(recording, arguments.start, arguments.end)
    counts = write_recording(recording, arguments.out, stack.log, stack.viewer)
    result = {"source": str(arguments.source), "format": recording.description.format, "log": str(arguments.out),
              "messages": counts, "notes": list(recording.description.notes)}  # fmt: skip
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
        return 0
    for topic, count in sorted(counts.items()):
        sys.stdout.write(f"{topic:<40}{count:>9}\n")
    sys.stdout.write(f"{recording.description.format}: {sum(counts.values())} messages in {arguments.out}\n")
    return 0
