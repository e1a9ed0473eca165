"""Uploads and downloads: session and seat, size, traversal, links, and what is not a file of a run."""

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from hmi.access import HASHER, Access, User
from hmi.config import PageConfig, SessionConfig
from hmi.diagnosis.run_files import file_of, runs_of
from hmi.feed import Feed
from hmi.files import _beginning, add_files
from hmi.log_in import COOKIE, add_log_in
from hmi.notification.config import NotificationConfig
from hmi.parts import Drive, PageParts
from hmi.plan_view.desk import MAX_FIELD_BYTES, PlanDesk
from hmi.security import LOOPBACK, RequestChecks
from hmi.statistics.store import StatisticsStore, Totals
from hmi.upload.config import UploadConfig
from messages.message import Envelope
from tests.hmi.drive_messages import demo_scene
from tests.hmi.planned import desk_in

PASSWORD = "correct horse"
HASH = HASHER.hash(PASSWORD)
USERS = {
    "anna": User(role="operate", password_hash=HASH), "bo": User(role="operate", password_hash=HASH),
    "cem": User(role="view", password_hash=HASH),
}  # fmt: skip
OWN = "http://127.0.0.1:8680"
SESSION = SessionConfig(idle_s=100.0, max_s=1000.0, attempts=3, attempts_s=60.0, seat_s=15.0)
CONFIG = PageConfig(
    port=0, stop_port=0, period_s=0.2, order_valid_s=1.0, confirmation_valid_s=1.0, lost_operator_s=10.0, cell_m=0.25,
    plan_limit_s=60.0, foxglove_port=None, foxglove_origins=(), session=SESSION,
    notification=NotificationConfig(after_s=60.0, language="en"),
    upload=UploadConfig(every_s=60.0, pause_s=5.0, max_pause_s=300.0, timeout_s=20.0),
)  # fmt: skip


class NoFeed(Feed):
    """Feed without messages."""

    def poll(self) -> list[Envelope]:
        return []


class Site:
    """Application with the routes of files, and clients of its users."""

    def __init__(self, folder: Path) -> None:
        self.access = Access(SESSION, USERS)
        self.desk: PlanDesk = desk_in(folder)
        self.runs = folder / "runs"
        self.statistics = StatisticsStore(folder / "statistics.db")
        drive = Drive(NoFeed(), demo_scene(), "a drive")
        parts = PageParts(
            drive, CONFIG, self.access, None, None, "replay", lambda code: code, self.desk, self.runs, self.statistics
        )
        self._app = FastAPI()
        add_log_in(self._app, self.access, None)
        add_files(self._app, parts)
        self._app.add_middleware(RequestChecks, hosts=LOOPBACK, frames=[])

    def client(self, name: str | None) -> TestClient:
        """Client of a user who has logged in, None: of nobody."""
        client = TestClient(self._app, base_url=OWN, follow_redirects=False, raise_server_exceptions=False)
        if name is not None:
            client.post("/log-in", data={"name": name, "password": PASSWORD}, headers={"Origin": OWN})
        return client

    def seat(self, client: TestClient) -> None:
        """Gives control to the user of a client, who has a page open."""
        session = self.access.session(client.cookies[COOKIE], time.monotonic())
        assert session is not None
        session.pages = 1
        assert self.access.take_seat(session, time.monotonic())


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    found = Site(tmp_path)
    yield found
    found.statistics.close()


@pytest.fixture
def anna(site: Site) -> TestClient:
    """The operator in control."""
    client = site.client("anna")
    site.seat(client)
    return client


def sent(*names: str, content: bytes = b"ok") -> list[tuple[str, tuple[str, bytes]]]:
    return [("field", (name, content)) for name in names]


def test_a_field_file_of_the_operator_in_control_is_read(site: Site, anna: TestClient) -> None:
    answer = anna.post("/plan/field", files=sent("a.kml"), headers={"Origin": OWN})
    assert (answer.status_code, answer.text) == (204, "")
    assert site.desk.name == "north"


def test_only_the_operator_in_control_sends_a_field_file(site: Site, anna: TestClient) -> None:
    for name, code in ((None, 401), ("bo", 403), ("cem", 403)):
        answer = site.client(name).post("/plan/field", files=sent("a.kml"), headers={"Origin": OWN})
        assert answer.status_code == code
        assert answer.text
    for origin in ("http://example.org", "null"):
        assert anna.post("/plan/field", files=sent("a.kml"), headers={"Origin": origin}).status_code == 403
    assert site.desk.draft is None


def test_a_file_above_the_limit_is_refused_in_words_and_not_kept(site: Site, anna: TestClient) -> None:
    large = sent("a.kml", content=b"x" * (MAX_FIELD_BYTES + 200_000))
    answer = anna.post("/plan/field?lang=zh", files=large, headers={"Origin": OWN})
    assert (answer.status_code, answer.text) == (413, "文件大于 20 MB。请只导出一个田块的轮廓。")
    assert site.desk.draft is None


def test_a_stream_without_length_ends_at_the_limit(site: Site, anna: TestClient) -> None:
    """A client that sends 60 MB in chunks and does not say so."""

    def chunks() -> Iterator[bytes]:
        yield b'--b\r\nContent-Disposition: form-data; name="field"; filename="a.kml"\r\n\r\n'
        for _ in range(60):
            yield b"x" * 1_000_000

    headers = {"Origin": OWN, "Content-Type": "multipart/form-data; boundary=b"}
    assert anna.post("/plan/field", content=chunks(), headers=headers).status_code == 413
    assert site.desk.draft is None


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        (b"", "multipart/form-data; boundary=b"), (b"--b--\r\n", "multipart/form-data; boundary=b"),
        (b"\xff" * 1000, "multipart/form-data; boundary=b"), (b"x", "multipart/form-data"), (b"x", "text/plain"),
        (b"--b\r\n\r\n\r\n--b--", "multipart/form-data; boundary=b"),
        (b"--" + b"b" * 400, "multipart/form-data; boundary=" + "b" * 400),
        (b'--b\r\nContent-Disposition: form-data; name="x"\r\n\r\nv\r\n--b--\r\n', "multipart/form-data; boundary=b"),
        (b"{}", "application/json"),
    ],
)  # fmt: skip
def test_odd_bodies_are_refused(site: Site, anna: TestClient, body: bytes, kind: str) -> None:
    answer = anna.post("/plan/field", content=body, headers={"Origin": OWN, "Content-Type": kind})
    assert (answer.status_code, answer.text) == (400, "No file was sent.")
    assert site.desk.draft is None


def test_odd_names_stay_in_the_folder_of_the_draft(site: Site, anna: TestClient, tmp_path: Path) -> None:
    for name in ("../../../../x.kml", "..\\..\\x.kml", "/etc/passwd", "<script>.kml", "x" * 3000):
        assert anna.post("/plan/field", files=sent(name), headers={"Origin": OWN}).status_code == 204
        assert site.desk.draft is not None
        (kept,) = (site.desk.draft / "field").iterdir()
        assert kept.parent.parent.parent == tmp_path / "missions"
        assert not set("<>/\\") & set(kept.name)
    others = {path.name for path in tmp_path.iterdir() if not path.name.startswith("statistics.db")}
    assert others == {"missions"}


def test_too_many_files_and_equal_names_are_refused(anna: TestClient) -> None:
    many = sent(*(f"{k}.shp" for k in range(30)))
    assert anna.post("/plan/field", files=many, headers={"Origin": OWN}).status_code == 400
    answer = anna.post("/plan/field", files=sent("a.shp", "b/a.shp"), headers={"Origin": OWN})
    assert (answer.status_code, answer.text) == (400, "Two files have the same name.")


def test_a_field_file_while_the_planner_works_is_refused(site: Site, anna: TestClient) -> None:
    from hmi.plan_view.field_job import FieldJob

    site.desk.job = FieldJob(("false",), "plan")
    answer = anna.post("/plan/field", files=sent("a.kml"), headers={"Origin": OWN})
    assert (answer.status_code, answer.text) == (400, "The planner is at work. Wait, or cancel it.")


@pytest.fixture
def run(site: Site) -> Path:
    """A run folder with a log, a report and a file that is not offered."""
    folder = site.runs / "20261125T080000Z-page"
    folder.mkdir(parents=True)
    files = {"log.mcap": b"\x89MCAP0\r\n" + bytes(1000), "log.2.mcap": b"x", "report.html": b"<script>1</script>",
             "order_key.pem": b"secret", ".manifest.json.new": b"x"}  # fmt: skip
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "manifest.json").write_text(json.dumps({"verb": "page", "files": list(files), "is_complete": True}))
    (site.runs / "latest").symlink_to(folder.name)
    (folder / "log.3.mcap").symlink_to("/etc/passwd")
    (folder / "console.log").mkdir()
    return folder


def test_logs_and_reports_are_listed_and_downloaded(site: Site, run: Path, anna: TestClient) -> None:
    (found,) = runs_of(site.runs)
    assert (found.name, found.verb, found.is_complete) == (run.name, "page", True)
    assert set(found.files) == {"log.mcap", "log.2.mcap", "report.html"}
    answer = site.client("cem").get(f"/runs/{run.name}/log.mcap")
    assert answer.content == (run / "log.mcap").read_bytes()
    report = anna.get(f"/runs/{run.name}/report.html")
    assert report.headers["content-disposition"].startswith("attachment")  # not shown as a page of this server
    assert report.headers["content-type"] == "application/octet-stream"
    assert report.headers["x-content-type-options"] == "nosniff"


def test_a_log_that_grows_while_it_is_sent_keeps_its_length(site: Site, run: Path, anna: TestClient) -> None:
    """As long as it was when the download began."""
    content = (run / "log.mcap").read_bytes()
    with anna.stream("GET", f"/runs/{run.name}/log.mcap") as answer, (run / "log.mcap").open("ab") as log:
        log.write(bytes(100_000))
        log.flush()
        assert answer.headers["content-length"] == str(len(content))
    assert b"".join(_beginning(run / "log.mcap", len(content))) == content
    with pytest.raises(OSError, match="symbolic links"):
        next(_beginning(run / "log.3.mcap", 10))


def test_a_download_needs_a_session(site: Site, run: Path) -> None:
    for path in (f"/runs/{run.name}/log.mcap", "/statistics.csv"):
        answer = site.client(None).get(path)
        assert answer.status_code == 401
        assert b"MCAP" not in answer.content


@pytest.mark.parametrize(
    "path",
    ["{run}/manifest.json", "{run}/order_key.pem", "{run}/..%2Forder_key.pem", "..%2F{run}/log.mcap",
     "%2e%2e/users.yaml",
     "{run}/log.3.mcap", "{run}/console.log", "latest/log.mcap", "./log.mcap", "{run}/log.mcap%00.html",
     "{run}/.manifest.json.new",
     "{run}%2F..%2F{run}/log.mcap", "none/log.mcap", "{run}/%2Fetc%2Fpasswd", "%2Fetc/passwd"],
)  # fmt: skip
def test_other_files_are_not_given(site: Site, run: Path, anna: TestClient, path: str) -> None:
    answer = anna.get(f"/runs/{path.format(run=run.name)}")
    assert answer.status_code == 404
    assert b"secret" not in answer.content
    assert b"root:" not in answer.content


@pytest.mark.parametrize(
    ("run_name", "name"), [("..", "log.mcap"), (".", "log.mcap"), ("", "log.mcap"), ("a/b", "log.mcap")]
)
def test_names_with_folders_are_no_runs(site: Site, run: Path, run_name: str, name: str) -> None:
    assert file_of(run, run_name, name) is None


@pytest.mark.parametrize("manifest", ["", "[]", "{", "3", '{"verb": {}}', "\0"])
def test_a_damaged_manifest_does_not_stop_the_list(site: Site, run: Path, manifest: str) -> None:
    (site.runs / "20261126T080000Z-run").mkdir()
    (site.runs / "20261126T080000Z-run" / "manifest.json").write_text(manifest)
    assert run.name in [one.name for one in runs_of(site.runs)]


def test_statistics_are_downloaded_as_csv(site: Site, anna: TestClient) -> None:
    site.statistics.put("a", "2026-11-25", '=HYPERLINK("http://x","y")', Totals(10_000.0, 3600.0, 5000.0, 2))
    answer = anna.get("/statistics.csv")
    lines = answer.text.splitlines()
    assert lines[0] == "day,field,drives,area_m2,engaged_s,distance_m,stops"
    assert lines[1] == '2026-11-25,"\'=HYPERLINK(""http://x"",""y"")",1,10000.0,3600.0,5000.0,2'
    assert answer.headers["content-disposition"].startswith("attachment")


def test_two_operators_cannot_both_send(site: Site, anna: TestClient) -> None:
    """Hand-over moves the right to send."""
    bo = site.client("bo")
    assert bo.post("/plan/field", files=sent("a.kml"), headers={"Origin": OWN}).status_code == 403
    session = site.access.seated(time.monotonic())
    assert session is not None
    site.access.release_seat(session)
    site.seat(bo)
    assert bo.post("/plan/field", files=sent("a.kml"), headers={"Origin": OWN}).status_code == 204
    assert anna.post("/plan/field", files=sent("b.kml"), headers={"Origin": OWN}).status_code == 403
