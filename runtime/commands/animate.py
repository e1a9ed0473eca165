"""`headland animate`: writes an animation of a logged drive."""

import argparse
import math
import sys

from messages.errors import HeadlandError
from validation.drive.animation import animate, webp

FPS = 8.0


def main(arguments: argparse.Namespace) -> int:
    """Reads the log, draws the images and writes an animated WebP; 0 when it is written, raises HeadlandError."""
    for name, value, low in (("from", arguments.start, 0.0), ("duration", arguments.duration, 0.1)):
        if not low <= value < math.inf:
            raise HeadlandError(f"--{name} {value}: must be {low} or more")
    if not 0.1 <= arguments.rate <= 100.0:
        raise HeadlandError(f"--rate {arguments.rate}: must be 0.1 to 100")
    if not 0 <= arguments.quality <= 100:
        raise HeadlandError(f"--quality {arguments.quality}: must be 0 to 100")
    images = animate(arguments.log, arguments.start, arguments.duration, arguments.rate, FPS)
    data = webp(images, FPS, arguments.quality)
    try:
        arguments.out.write_bytes(data)
    except OSError as error:
        raise HeadlandError(f"--out {arguments.out}: cannot be written ({error.strerror})") from error
    sys.stdout.write(f"{arguments.out}: {len(images)} images, {len(images) / FPS:.1f} s, {len(data) / 1e6:.2f} MB\n")
    return 0
