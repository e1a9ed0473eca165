"""Sends the queue to the platform in a thread of its own; an item leaves it when the platform has confirmed its id.

One request is a POST of `{"items": [{"id", "kind", "body"}, ...]}`; the answer is `{"taken": [id, ...]}`. The platform
stores items before it answers and ignores an id that it has: what is sent again after a cut is no duplicate.
"""

import json
import threading
import urllib.request
from dataclasses import asdict
from http.client import HTTPException
from pathlib import Path

from hmi.upload.config import UploadConfig
from hmi.upload.upload_queue import UploadQueue
from messages.errors import HeadlandError

BATCH = 50
MAX_ANSWER = 1 << 20


class Uploader:
    """Uploads until `end`; `error` says why the last attempt has failed, "" after a success."""

    def __init__(self, path: Path, config: UploadConfig) -> None:
        self.error = ""
        self._path, self._config = path, config
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="upload", daemon=True)
        if config.url is not None:
            self._thread.start()

    def end(self) -> None:
        """Sends nothing more; returns when the thread has ended, or after the time limit of a request."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(self._config.timeout_s)

    def _run(self) -> None:
        link: UploadQueue | None = None
        pause_s = self._config.pause_s
        while not self._ended.wait(pause_s):
            try:
                link = link or UploadQueue(self._path)
                is_more = self._upload(link)
                self.error, pause_s = "", 0.0 if is_more else self._config.pause_s
            except (HeadlandError, OSError, HTTPException, ValueError) as error:
                self.error = str(error)[:300] or type(error).__name__
                pause_s = min(self._config.max_pause_s, 2.0 * max(pause_s, self._config.pause_s))
        if link is not None:
            link.close()

    def _upload(self, link: UploadQueue) -> bool:
        """Sends the oldest items; whether there may be more."""
        items = link.oldest(BATCH)
        if not items:
            return False
        assert self._config.url is not None
        body = json.dumps({"items": [asdict(item) for item in items]}, ensure_ascii=False).encode()
        headers = {"Content-Type": "application/json; charset=utf-8"}
        if self._config.token_file is not None:
            headers["Authorization"] = f"Bearer {self._config.token_file.read_text(encoding='utf-8').strip()}"
        request = urllib.request.Request(self._config.url, body, headers, method="POST")
        with urllib.request.urlopen(request, timeout=self._config.timeout_s) as answer:
            found = json.loads(answer.read(MAX_ANSWER))
        taken = found.get("taken") if isinstance(found, dict) else None
        sent = {item.id for item in items}
        if not isinstance(taken, list) or not sent.intersection(one for one in taken if isinstance(one, str)):
            raise ValueError(f"{self._config.url}: its answer confirms no item")
        link.remove(sent.intersection(taken))
        return True
