"""Upload to a platform that cuts connections, from a page that is killed: nothing is lost, nothing comes twice."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from configs.strict import parse
from hmi.diagnosis.alarm_log import AlarmLog
from hmi.statistics.store import Totals
from hmi.upload.config import UploadConfig
from hmi.upload.platform_report import DriveName, PlatformReport
from hmi.upload.upload_queue import UploadQueue
from hmi.upload.uploader import BATCH, Uploader
from messages.errors import ConfigError, HeadlandError
from messages.faults import Severity
from tests.hmi.drive_messages import fault
from tests.hmi.receiver import receiver
from tests.recordings import ROOT

FAST = {"every_s": 60.0, "pause_s": 0.001, "max_pause_s": 0.002, "timeout_s": 5.0}
UPLOADER = """
import sys, threading
from pathlib import Path
from hmi.upload.config import UploadConfig
from hmi.upload.upload_queue import UploadQueue
from hmi.upload.uploader import Uploader
path, url, first = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
uploader = Uploader(path, UploadConfig(url=url, every_s=60.0, pause_s=0.001, max_pause_s=0.002, timeout_s=5.0))
queue = UploadQueue(path)
for number in range(first, first + 1000):
    queue.put("number", {"n": number})
    print(number, flush=True)
"""


def config(url: str | None, **changes: Any) -> UploadConfig:
    return parse(UploadConfig, FAST | {"url": url} | changes, "page.yaml")


def wait_until(is_done: Callable[[], bool], seconds: float = 60.0) -> None:
    until_s = time.monotonic() + seconds
    while not is_done():
        assert time.monotonic() < until_s
        time.sleep(0.01)


@pytest.mark.parametrize("cuts", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_cuts_of_the_connection_lose_and_repeat_nothing(tmp_path: Path, cuts: int) -> None:
    """Every request is cut at a random place until there were so many cuts, while new items come."""
    with receiver(tmp_path / "platform.db", seed=cuts) as platform:
        platform.cuts = cuts
        queue = UploadQueue(tmp_path / "upload.db")
        uploader = Uploader(tmp_path / "upload.db", config(platform.url))
        count = 0
        while platform.cuts > 0 or count < 3 * BATCH:
            queue.put("number", {"n": count})
            count += 1
        wait_until(lambda: len(queue) == 0)
        uploader.end()
        assert sorted(body["n"] for body in platform.bodies("number")) == list(range(count))
        assert platform.repeated > 0  # an answer was cut: the same items came again and were recognized


@pytest.mark.parametrize("kills", [4, pytest.param(30, marks=pytest.mark.slow)])
def test_kills_of_the_sender_lose_and_repeat_nothing(tmp_path: Path, kills: int) -> None:
    """kill -9 at random times, with cuts; each item that was queued arrives once."""
    chance, queued = random.Random(kills), []
    with receiver(tmp_path / "platform.db") as platform:
        for k in range(kills):
            platform.cuts = 20
            command = [sys.executable, "-c", UPLOADER, str(tmp_path / "upload.db"), platform.url, str(1000 * k)]
            env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
            process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True)
            assert process.stdout is not None
            lines = [process.stdout.readline()]
            time.sleep(chance.uniform(0.0, 0.4))
            process.send_signal(signal.SIGKILL)
            lines += process.stdout.readlines()
            process.wait()
            queued += [int(line) for line in lines if line.endswith("\n")]
        queue = UploadQueue(tmp_path / "upload.db")
        platform.cuts = 0
        uploader = Uploader(tmp_path / "upload.db", config(platform.url))
        wait_until(lambda: len(queue) == 0)
        uploader.end()
        numbers = [body["n"] for body in platform.bodies("number")]
        assert len(numbers) == len(set(numbers))
        assert set(queued) <= set(numbers)
        assert len(set(numbers) - set(queued)) <= kills  # stored, and killed before it was printed


def test_items_of_days_off_line_arrive_in_their_order(tmp_path: Path) -> None:
    queue = UploadQueue(tmp_path / "upload.db")
    with receiver(tmp_path / "platform.db", token="secret") as platform:
        url = platform.url
        (tmp_path / "token").write_text("secret\n")
    gone = Uploader(tmp_path / "upload.db", config(url))
    for number in range(5000):  # three days, one a minute
        queue.put("number", {"n": number})
    wait_until(lambda: "refused" in gone.error)
    gone.end()
    assert len(queue) == 5000
    queue.close()
    queue = UploadQueue(tmp_path / "upload.db")
    with receiver(tmp_path / "platform.db", token="secret") as platform:
        uploader = Uploader(tmp_path / "upload.db", config(platform.url, token_file=str(tmp_path / "token")))
        wait_until(lambda: len(queue) == 0)
        uploader.end()
        assert [body["n"] for body in platform.bodies("number")] == list(range(5000))
        assert platform.repeated == 0


def test_a_wrong_token_is_named_and_keeps_the_items(tmp_path: Path) -> None:
    queue = UploadQueue(tmp_path / "upload.db")
    queue.put("number", {"n": 1})
    with receiver(tmp_path / "platform.db", token="secret") as platform:
        uploader = Uploader(tmp_path / "upload.db", config(platform.url))
        wait_until(lambda: "401" in uploader.error)
        uploader.end()
        assert (len(queue), platform.bodies("number")) == (1, [])


def test_a_full_queue_drops_the_oldest_and_counts_them(tmp_path: Path) -> None:
    queue = UploadQueue(tmp_path / "upload.db", most=10)
    for number in range(25):
        queue.put("number", {"n": number})
    assert [item.body["n"] for item in queue.oldest(100)] == list(range(15, 25))
    assert queue.dropped == 15


def test_another_file_is_refused_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "upload.db").write_text("no database, but long enough to be read as the header of one " * 20)
    with pytest.raises(HeadlandError, match=r"upload\.db: cannot be used for the upload queue"):
        UploadQueue(tmp_path / "upload.db")
    with sqlite3.connect(tmp_path / "newer.db") as link:
        link.execute("PRAGMA user_version = 9")
    with pytest.raises(HeadlandError, match=r"newer\.db: upload queue of version 9"):
        UploadQueue(tmp_path / "newer.db")


def test_totals_and_alarms_of_a_drive_are_queued(tmp_path: Path) -> None:
    """Totals every minute when they have changed, and at the end; each alarm once, no warnings."""
    report, alarms = PlatformReport(tmp_path / "upload.db", config("http://127.0.0.1:1/")), AlarmLog()
    queue, drive = UploadQueue(tmp_path / "upload.db"), DriveName("run/1", "north")
    times = (
        (100.0, 10.0, False),
        (130.0, 20.0, False),
        (161.0, 30.0, False),
        (230.0, 30.0, False),
        (231.0, 31.0, True),
    )
    for now_s, area_m2, is_last in times:
        report.take(drive, "2026-11-25", Totals(area_m2=area_m2), alarms, now_s, is_last)
        if now_s == 130.0:
            alarms.take([fault(True), fault(True, Severity.WARNING, "gnss.age")], now_s)
    found = [(item.kind, item.body.get("area_m2", item.body.get("code"))) for item in queue.oldest(100)]
    assert found == [("totals", 10.0), ("alarm", "brake.weak"), ("totals", 30.0), ("totals", 31.0)]
    assert report.error == ""


def test_without_a_platform_nothing_is_queued(tmp_path: Path) -> None:
    report = PlatformReport(tmp_path / "upload.db", config(None))
    report.take(DriveName("run/1", "north"), "2026-11-25", Totals(area_m2=5.0), AlarmLog(), 0.0, True)
    Uploader(tmp_path / "upload.db", config(None)).end()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [({"url": "file:///etc/passwd"}, "url"), ({"every_s": 0.0}, "every_s"), ({"speed": 1}, "speed")],
)
def test_configuration_names_what_is_wrong(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse(UploadConfig, FAST | change, "page.yaml")
