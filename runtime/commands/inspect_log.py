"""`headland check-log`: what is in a log, whole or cut off."""

import argparse
import json
import sys

from datasets.summary import check_log, render_summary, summary_json


def main(arguments: argparse.Namespace) -> int:
    """0 when the log is whole and every message decodes, else 1; a file that is no log raises LogError."""
    summary = check_log(arguments.log)
    text = json.dumps(summary_json(summary)) if arguments.json else render_summary(summary)
    sys.stdout.write(text.rstrip("\n") + "\n")
    return 0 if summary.is_whole and not summary.undecoded else 1
