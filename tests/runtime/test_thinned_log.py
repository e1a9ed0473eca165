"""Log of `live`: without raw sensor data over the drive, complete around events, and *not shown* by `validate`."""

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from configs.strict import CONFIGS, load
from datasets.log import LogConfig, LogWriter
from datasets.reader import read_log
from datasets.summary import summarize_log
from messages.command import Mode, SupervisorState
from messages.faults import Fault, Response, Severity
from messages.message import Envelope, Message
from messages.perception import ObstacleClass
from messages.sensors import ImuSample, UltrasonicRange
from runtime.live.config import LiveConfig
from runtime.live.thinned_log import THINNED, ThinnedLog
from runtime.replay.evaluate import NotShown, check_thinned

S = 1_000_000_000
LOG = LogConfig(chunk_kib=16, flush_s=0.1, sync_s=100.0, min_free_mb=0.0)
CONFIG = load(LiveConfig, CONFIGS / "live.yaml").thinned_log.model_copy(
    update={"left_out": ("ultrasonic",), "period_s": {"imu": 0.1}, "before_s": 2.0, "after_s": 3.0}
)


def supervisor(stamp_ns: int, mode: Mode, reason: str) -> SupervisorState:
    return SupervisorState(
        stamp_ns, mode, reason, (), ObstacleClass.UNKNOWN, math.inf, 0.0, 0.0, 0.0, 0.0,
        np.empty((0, 3), np.float32), np.empty((0, 2)),
    )  # fmt: skip


def fault(stamp_ns: int, response: Response) -> Fault:
    return Fault(stamp_ns, "imu.silent", "localizer", Severity.ALARM, False, response, True, "IMU: no data", "")


def write(folder: Path, seconds: float, events: dict[float, Message], config=CONFIG) -> ThinnedLog:
    """IMU at 100 Hz, an ultrasonic sensor at 10 Hz and the supervisor at 10 Hz, and events by their seconds."""
    counts: Counter[str] = Counter()
    stopped = {t for t, message in events.items() if isinstance(message, SupervisorState)}
    with LogWriter(folder / "log.mcap", {THINNED: {"left_out": "ultrasonic"}}, LOG) as log:
        sink = ThinnedLog(log, folder / "events", config, LOG, None)
        for k in range(round(100 * seconds)):
            stamp_ns = k * S // 100
            due: list[tuple[str, Message]] = [("imu", ImuSample(stamp_ns, np.ones(3), np.ones(3)))]
            if k % 10 == 0:
                due.append(("ultrasonic/front", UltrasonicRange(stamp_ns, 1.0)))
                if not any(t <= k / 100 <= t + 1.0 for t in stopped):
                    due.append(("supervisor", supervisor(stamp_ns, Mode.AUTOMATIC, "")))
            for t, message in events.items():
                if round(100 * t) == k:
                    due.append(("supervisor" if t in stopped else "fault/localizer", message))
            for topic, message in due:
                sink(Envelope(topic, counts[topic], stamp_ns, message))
                counts[topic] += 1
        sink.close()
    return sink


def topics(path: Path) -> Counter[str]:
    return Counter(envelope.topic for envelope in read_log(path))


def test_thinned_topics_and_the_complete_seconds_of_a_stop(tmp_path: Path) -> None:
    sink = write(tmp_path, 20.0, {10.0: supervisor(10 * S, Mode.OBSTACLE_STOP, "protective_field")})
    found = topics(tmp_path / "log.mcap")
    assert found["ultrasonic/front"] == 0
    assert found["imu"] == pytest.approx(200, abs=2)
    assert sink.events == 1
    (event,) = (tmp_path / "events").iterdir()
    assert event.name == "0001-protective_field.mcap"
    summary = summarize_log(event)
    assert summary.is_complete
    assert THINNED not in summary.metadata
    assert summary.metadata["event"] == {"code": "protective_field"}
    assert summary.start_ns == pytest.approx(8 * S, abs=S // 50)
    assert summary.end_ns == pytest.approx(13 * S, abs=S // 10)
    assert all(topic.missing == 0 for topic in summary.topics)
    stamps = [envelope.receive_ns for envelope in read_log(event)]
    assert stamps == sorted(stamps)
    assert topics(event)["imu"] == pytest.approx(500, abs=10)
    assert topics(event)["ultrasonic/front"] == pytest.approx(50, abs=2)


@pytest.mark.parametrize(
    ("response", "events"), [(Response.NONE, 0), (Response.LIMIT, 0), (Response.CONTROLLED_STOP, 1)]
)
def test_only_faults_that_demand_a_stop_are_events(tmp_path: Path, response: Response, events: int) -> None:
    assert write(tmp_path, 5.0, {3.0: fault(3 * S, response)}).events == events


def test_event_at_the_end_of_the_drive_is_closed(tmp_path: Path) -> None:
    write(tmp_path, 5.0, {4.9: fault(49 * S // 10, Response.CONTROLLED_STOP)})
    (event,) = (tmp_path / "events").iterdir()
    summary = summarize_log(event)
    assert summary.is_complete
    assert summary.end_ns == 499 * S // 100


def test_size_of_an_event_is_bounded(tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"after_s": 60.0, "event_mb": 1.0})
    random = np.random.default_rng(1)
    with LogWriter(tmp_path / "log.mcap", {}, LOG) as log:
        sink = ThinnedLog(log, tmp_path / "events", config, LOG, None)
        sink(Envelope("fault/localizer", 0, 0, fault(0, Response.CONTROLLED_STOP)))
        for k in range(40_000):
            sink(
                Envelope(
                    "imu", k, k * S // 1000, ImuSample(k * S // 1000, random.normal(size=3), random.normal(size=3))
                )
            )
        sink.close()
    (event,) = (tmp_path / "events").iterdir()
    assert 0.8e6 < event.stat().st_size < 1e6
    assert summarize_log(event).is_complete


def test_validate_shows_nothing_of_a_thinned_log(tmp_path: Path) -> None:
    write(tmp_path, 5.0, {3.0: fault(3 * S, Response.CONTROLLED_STOP)})
    with pytest.raises(NotShown, match="thinned, without ultrasonic"):
        check_thinned(tmp_path / "log.mcap")
    (event,) = (tmp_path / "events").iterdir()
    check_thinned(event)
