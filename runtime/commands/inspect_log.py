"""`headland inspect-log`: topics, gaps and damage of a log, also of a truncated one."""

import argparse
import json
import sys

from datasets.importers.import_table import render, rows_of_log
from datasets.importers.recording import SOURCE
from datasets.summary import render_summary, summarize_log, summary_json
from messages.errors import LogError

MAX_NAMES = 6


def main(arguments: argparse.Namespace) -> int:
    """Prints the summary; 0 if the log is complete and all messages decode, else 1; raises LogError for other files."""
    if arguments.log.is_dir():
        logs = ", ".join(sorted(p.name for p in arguments.log.glob("*.mcap"))[:MAX_NAMES])
        remedy = f"give one of its logs ({logs})" if logs else "import it first (headland import), and give the log"
        raise LogError(f"{arguments.log}: is a folder; {remedy}")
    summary = summarize_log(arguments.log)
    rows = rows_of_log(summary.metadata, {topic.topic: topic.count for topic in summary.topics})
    text = json.dumps(summary_json(summary) | {"streams": rows}) if arguments.json else render_summary(summary)
    if rows and not arguments.json:
        text += f"\nimported from {summary.metadata[SOURCE].get('path', '?')}:\n{render(rows)}"
    sys.stdout.write(text.rstrip("\n") + "\n")
    return 0 if summary.is_complete and not summary.undecoded else 1
