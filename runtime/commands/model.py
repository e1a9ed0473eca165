"""`headland model`: downloads a known network of the camera detector into the user's cache."""

import argparse
import json
import sys

from configs.known_models import cached_file, is_intact, known_models
from messages.errors import HeadlandError
from runtime.download import download


def main(arguments: argparse.Namespace) -> int:
    """Downloads a file that is not there and prints its path; 0, or HeadlandError if it is not there or damaged."""
    known, path = known_models(), cached_file(arguments.name)
    model = known.model(arguments.name)
    is_new = not path.exists()
    if is_new:
        sys.stderr.write(f"headland: {model.url}, {model.size_bytes / 1e6:.1f} MB, {model.licence}\n")
        download(model, path, known)
    elif not is_intact(path, model):
        raise HeadlandError(f"{path}: not the known file (its SHA-256 is another); remove it and download it again")
    if arguments.json:
        found = {"name": arguments.name, "path": str(path), "sha256": model.sha256, "is_new": is_new}
        sys.stdout.write(json.dumps(found) + "\n")
    else:
        sys.stdout.write(f"{path}\n")
    return 0
