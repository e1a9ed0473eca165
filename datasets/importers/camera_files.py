"""Folders of numbered camera images (PNG, JPEG)."""

from collections import Counter
from itertools import islice
from pathlib import Path

from datasets.importers.frame_streams import Files, FrameStream, Times, numbered_files, read_bytes
from datasets.importers.images import decode_image
from datasets.importers.recording import Sensor
from messages.errors import LogError
from messages.sensors import CameraImage

FORMAT = "images"
SUFFIXES = (".png", ".jpg", ".jpeg")
# Images that decide on the size of all.
SIZED_IMAGES = 5
Size = tuple[int, int]


def image_files(folder: Path) -> Files:
    """Images by frame number; empty without the folder."""
    return numbered_files(p for p in folder.glob("*") if p.suffix.lower() in SUFFIXES)


def camera_stream(name: str, files: Files, times: Times, size_px: Size | None) -> FrameStream:
    """Images in the optical frame `name`; those of another size (width, height) are refused, with None of no size."""
    paths, unread = files
    sensor = Sensor(f"camera/{name}", name, str(next(iter(paths.values())).parent), FORMAT)
    return FrameStream(
        (sensor,), times[0], lambda number, stamp: (read_image(paths[number], stamp, size_px),), (*unread, *times[1])
    )


def common_size(files: dict[int, Path]) -> Size | None:
    """Size of most of the first images; None if none of them can be read."""
    sizes: Counter[Size] = Counter()
    for path in islice(files.values(), SIZED_IMAGES):
        try:
            sizes[_size_of(read_image(path, 0, None))] += 1
        except LogError:  # it is counted when the recording is read
            continue
    return sizes.most_common(1)[0][0] if sizes else None


def read_image(path: Path, stamp_ns: int, size_px: Size | None) -> CameraImage:
    """One image; raises LogError with its size if that is not `size_px`."""
    data = read_bytes(path)
    try:
        image = CameraImage(stamp_ns, decode_image(data), data)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    width, height = _size_of(image)
    if size_px is not None and (width, height) != size_px:
        raise LogError(f"{path}: image of {width} x {height} instead of {size_px[0]} x {size_px[1]}")
    return image


def _size_of(image: CameraImage) -> Size:
    return image.bgr.shape[1], image.bgr.shape[0]
