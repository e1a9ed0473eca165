"""Download of a file of known size and hash; what is left behind is the complete file or none."""

import errno
import hashlib
import http.client
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from shutil import disk_usage

from configs.known_models import KnownModel, KnownModels
from datasets.disk import new_file
from messages.errors import HeadlandError

CHUNK_BYTES = 65536


def download(model: KnownModel, path: Path, limits: KnownModels) -> None:
    """Downloads a model into `path`, which must not exist; raises HeadlandError in one line."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        free = disk_usage(path.parent).free
    except OSError as error:
        raise HeadlandError(f"{path.parent}: cannot be created ({error.strerror})") from error
    if free < model.size_bytes:
        raise HeadlandError(f"{path}: {free} bytes are free on its disk, and {model.size_bytes} are needed")
    with new_file(path) as fresh:
        digest = hashlib.sha256()
        for chunk in _chunks(model, limits):
            digest.update(chunk)
            _append(fresh, chunk, path)
        if digest.hexdigest() != model.sha256:
            raise HeadlandError(f"{model.url}: SHA-256 is {digest.hexdigest()}, not {model.sha256}; nothing was kept")


def _append(fresh: Path, chunk: bytes, path: Path) -> None:
    try:
        with fresh.open("ab") as file:
            file.write(chunk)
    except OSError as error:
        full = " (the disk is full)" if error.errno in (errno.ENOSPC, errno.EDQUOT) else f" ({error.strerror})"
        raise HeadlandError(f"{path}: cannot be written{full}") from error


def _chunks(model: KnownModel, limits: KnownModels) -> Iterator[bytes]:
    """Content of the URL, exactly of the known size."""
    end_s, n = time.monotonic() + limits.max_duration_s, 0
    try:
        # the address comes from the configuration, which takes http and https only
        with urllib.request.urlopen(model.url, timeout=limits.timeout_s) as response:
            while n < model.size_bytes and (chunk := response.read1(CHUNK_BYTES)):
                n += len(chunk)
                if n <= model.size_bytes:
                    yield chunk
                if time.monotonic() > end_s:
                    raise HeadlandError(f"{model.url}: not complete after {limits.max_duration_s:g} s")
            if n == model.size_bytes and response.read1(1):
                n += 1
    except urllib.error.HTTPError as error:
        raise HeadlandError(f"{model.url}: the server answers {error.code} {error.reason}") from error
    except (OSError, http.client.HTTPException) as error:
        why = getattr(error, "reason", None) or error
        raise HeadlandError(f"{model.url}: cannot be downloaded ({type(error).__name__}: {why})") from error
    if n != model.size_bytes:
        at_least = "more than " if n > model.size_bytes else ""
        raise HeadlandError(f"{model.url}: has {at_least}{min(n, model.size_bytes)} of {model.size_bytes} bytes")
