"""`headland model` against a local server, and runs with a model from the cache."""

import argparse
import hashlib
import http.server
import io
import json
import os
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from configs.known_models import KnownModel, KnownModels, cached_file, known_models, model_path
from messages.errors import ConfigError, HeadlandError
from perception.camera.detector import DetectorConfig
from perception.camera.nodes import detector_of
from runtime.commands import model as command
from runtime.commands.options import make_parser
from runtime.commands.progress import Progress
from runtime.download import download
from runtime.setup import load_setup, start_notes, with_model
from tests.recordings import DATA, needs

ROOT = Path(__file__).resolve().parents[2]
CONTENT = bytes(range(256)) * 800
YOLOX = DATA / "onnx-detectors" / "yolox-nano" / "model" / "yolox_nano.onnx"


class Server(http.server.ThreadingHTTPServer):
    """Serves CONTENT in the ways a server can fail; the path of the address chooses one."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answers)
        self.count, self.go_on, self.started = 0, threading.Event(), threading.Event()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def url(self, path: str) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/{path}"


class Answers(http.server.BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        self.server.count += 1
        kind = self.path[1:]
        if kind == "gone":
            self.send_error(404)
            return
        if kind == "moved":
            self.send_response(302)
            self.send_header("Location", "/good")
            self.end_headers()
            return
        if kind == "noise":
            self.wfile.write(b"\0" * 100)
            return
        body = {"wrong": CONTENT[:-1] + b"!", "long": CONTENT + b"!", "empty": b""}.get(kind, CONTENT)
        self.send_response(200)
        if kind != "unsized":
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if kind in ("cut", "stalled", "waits"):
            self.wfile.write(body[:70_000])
            self.wfile.flush()
            self.server.started.set()
            if kind != "cut":
                self.server.go_on.wait(20.0)
            body = body[70_000:] if kind == "waits" else b""
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    one = Server()
    yield one
    one.go_on.set()
    one.shutdown()
    one.server_close()


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "headland" / "models"


def model_at(url: str, content: bytes = CONTENT) -> KnownModel:
    return KnownModel(url=url, sha256=hashlib.sha256(content).hexdigest(), size_bytes=len(content), licence="test")


LIMITS = KnownModels(timeout_s=0.5, max_duration_s=10.0, models={})


@pytest.mark.parametrize("kind", ["good", "moved", "unsized"])
def test_download(server: Server, cache: Path, kind: str) -> None:
    download(model_at(server.url(kind)), cache / "m.onnx", LIMITS)
    assert (cache / "m.onnx").read_bytes() == CONTENT
    assert list(cache.iterdir()) == [cache / "m.onnx"]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("gone", "the server answers 404 Not Found"),
        ("wrong", "SHA-256 is [0-9a-f]{64}, not [0-9a-f]{64}; nothing was kept"),
        ("cut", "has 70000 of 204800 bytes"),
        ("empty", "has 0 of 204800 bytes"),
        ("long", "has more than 204800 of 204800 bytes"),
        ("stalled", "cannot be downloaded .*timed out"),
        ("noise", "cannot be downloaded"),
    ],
)
def test_failures_leave_nothing(server: Server, cache: Path, kind: str, words: str) -> None:
    with pytest.raises(HeadlandError, match=words) as failure:
        download(model_at(server.url(kind)), cache / "m.onnx", LIMITS)
    assert str(failure.value).startswith(server.url(kind))
    assert "\n" not in str(failure.value)
    assert list(cache.iterdir()) == []
    server.go_on.set()
    download(model_at(server.url("good")), cache / "m.onnx", LIMITS)  # the next one is not disturbed
    assert (cache / "m.onnx").read_bytes() == CONTENT


def test_endless_server(server: Server, cache: Path) -> None:
    limits = LIMITS.model_copy(update={"max_duration_s": 1e-6})
    with pytest.raises(HeadlandError, match="not complete after 1e-06 s"):
        download(model_at(server.url("good")), cache / "m.onnx", limits)
    assert list(cache.iterdir()) == []


def test_no_server(server: Server, cache: Path) -> None:
    url = server.url("good")
    server.shutdown()
    server.server_close()
    with pytest.raises(HeadlandError, match=r"cannot be downloaded .*refused"):
        download(model_at(url), cache / "m.onnx", LIMITS)


def test_disk_without_room(server: Server, cache: Path) -> None:
    huge = model_at(server.url("good")).model_copy(update={"size_bytes": 10**18})
    with pytest.raises(HeadlandError, match=r"m\.onnx: \d+ bytes are free on its disk, and 1000000000000000000"):
        download(huge, cache / "m.onnx", LIMITS)
    assert server.count == 0


def test_disk_that_fills_up(server: Server, cache: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(HeadlandError, match=r"m\.onnx: cannot be written \(File too large\)"):
            download(model_at(server.url("good")), cache / "m.onnx", LIMITS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(cache.iterdir()) == []


def test_folder_that_cannot_be_made(server: Server, cache: Path) -> None:
    cache.parents[1].write_text("a file")
    with pytest.raises(HeadlandError, match=r"models: cannot be created \(Not a directory\)"):
        download(model_at(server.url("good")), cache / "m.onnx", LIMITS)


def test_two_at_once(server: Server, cache: Path) -> None:
    path, failures = cache / "m.onnx", []

    def first() -> None:
        try:
            download(model_at(server.url("waits")), path, LIMITS.model_copy(update={"timeout_s": 20.0}))
        except HeadlandError as error:
            failures.append(error)

    thread = threading.Thread(target=first)
    thread.start()
    assert server.started.wait(10.0)
    with pytest.raises(HeadlandError, match="another process is writing it"):
        download(model_at(server.url("good")), path, LIMITS)
    server.go_on.set()
    thread.join(20.0)
    assert not failures
    assert path.read_bytes() == CONTENT


def test_killed_download(server: Server, cache: Path) -> None:
    """A download that ends without any clean-up leaves no file of the name, and the next one is complete."""
    one = model_at(server.url("stalled"))
    code = (
        "import pathlib, sys; from configs.known_models import *; from runtime.download import download;"
        "known = KnownModels(timeout_s=60, max_duration_s=60, models={});"
        "download(KnownModel.model_validate_json(sys.argv[1]), pathlib.Path(sys.argv[2]), known)"
    )
    path = cache / "m.onnx"
    process = subprocess.Popen(
        [sys.executable, "-c", code, one.model_dump_json(), str(path)], cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert server.started.wait(20.0)
    process.kill()
    process.wait(10.0)
    assert not path.exists()
    download(model_at(server.url("good")), path, LIMITS)
    assert path.read_bytes() == CONTENT
    assert list(cache.iterdir()) == [path]


def namespace(name: str, is_json: bool = True) -> argparse.Namespace:
    return argparse.Namespace(name=name, json=is_json)


def test_command_line_without_network(cache: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT), "https_proxy": "http://127.0.0.1:9"}
    for name, words in (("yolox_nano", "cannot be downloaded"), ("../x", "model '../x': not one of yolox_nano, nano")):
        done = subprocess.run(
            [sys.executable, "-m", "runtime", "model", name], cwd=ROOT, env=env, capture_output=True, text=True,
            timeout=60, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (2, "")
        assert words in done.stderr.splitlines()[-1]
        assert "Traceback" not in done.stderr
    assert not list(cache.iterdir())


@needs("onnx-detectors")
def test_existing_file(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = cached_file("yolox_nano")
    path.parent.mkdir(parents=True)
    shutil.copyfile(YOLOX, path)
    assert command.main(namespace("yolox_nano")) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {
        "name": "yolox_nano", "path": str(path), "is_new": False,
        "sha256": known_models().model("yolox_nano").sha256,
    }  # fmt: skip
    assert make_parser().parse_args(["run", "--model", "yolox_nano"]).model == path
    path.write_bytes(YOLOX.read_bytes()[:-1] + b"!")
    for use in (lambda: command.main(namespace("yolox_nano")), lambda: model_path("yolox_nano")):
        with pytest.raises(HeadlandError, match=r"yolox_nano\.onnx: not the known file .* remove it"):
            use()
    with pytest.raises(SystemExit):
        make_parser().parse_args(["run", "--model", "yolox_nano"])
    assert "not the known file" in capsys.readouterr().err


@needs("onnx-detectors")
def test_run_uses_the_cached_model(cache: Path) -> None:
    config = DetectorConfig(model="yolox_nano", min_score=0.3, max_iou=0.45, max_tile_ratio=1.5, input_px=416)
    with pytest.raises(ConfigError, match=r"no such file; download it with \./headland model yolox_nano"):
        detector_of(config)
    cache.mkdir(parents=True)
    shutil.copyfile(YOLOX, cache / "yolox_nano.onnx")
    detector = detector_of(config)
    assert detector is not None
    assert detector.model.size_px == (416, 416)
    assert detector_of(config.model_copy(update={"model": None})) is None


@needs("onnx-detectors")
def test_start_without_a_model() -> None:
    setup, console = load_setup("line", None, None, None, 1), io.StringIO()
    Progress((console,), start_notes(setup))
    words = "without a detector model nothing is detected by camera_front (./headland model --help)"
    assert console.getvalue() == f"    0.0 s  {words}\n"
    assert start_notes(with_model(setup, YOLOX)) == ()


@needs("onnx-detectors")
def test_known_hashes_are_those_of_the_tested_files() -> None:
    files = {"yolox_nano": YOLOX, "nanodet_m": DATA / "onnx-detectors" / "nanodet-m" / "model" / "nanodet_m_416.onnx"}
    known = known_models().models
    assert set(known) == set(files)
    for name, path in files.items():
        assert path.stat().st_size == known[name].size_bytes
        assert hashlib.sha256(path.read_bytes()).hexdigest() == known[name].sha256


def test_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for given in ("", "relative/path"):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert cached_file("m") == tmp_path / ".cache/headland/models/m.onnx"
