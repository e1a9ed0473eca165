"""`headland animate`: writes an animation of a logged drive."""

import argparse
import sys

from datasets.disk import new_file
from validation.drive.animation import animate, webp

FPS = 8.0


def main(arguments: argparse.Namespace) -> int:
    """Reads the log, draws the images and writes an animated WebP; 0 when it is written, raises HeadlandError."""
    with new_file(arguments.out) as fresh:
        images = animate(arguments.log, arguments.start, arguments.duration, arguments.rate, FPS)
        data = webp(images, FPS, arguments.quality)
        fresh.write_bytes(data)
    sys.stdout.write(f"{arguments.out}: {len(images)} images, {len(images) / FPS:.1f} s, {len(data) / 1e6:.2f} MB\n")
    return 0
