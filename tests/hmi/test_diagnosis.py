"""History of alarms, rates of topics, remedies: pure functions of messages and times."""

import re
from pathlib import Path

import pytest

from hmi.config import LANGUAGES
from hmi.diagnosis.alarm_log import MAX_ENTRIES, REPEATED_S, SOUND_S, AlarmLog
from hmi.diagnosis.bus_table import MAX_IDENTIFIERS, BusTable
from hmi.diagnosis.node_table import node_rows
from hmi.diagnosis.remedy import remedy
from hmi.diagnosis.topic_table import TopicTable
from hmi.texts import texts_of
from interfaces.orders.verifier import Reason
from messages.command import CanFrame, CanFrames
from messages.faults import Severity
from messages.message import Envelope
from messages.timing import NodeTiming
from safety.rules import RULES
from safety.supervisor import texts_of as codes_of
from tests.hmi.drive_messages import NOW_NS, fault, state_of
from tests.recordings import ROOT

FAULT_TYPE = re.compile(r'FaultType\(\s*"([a-z_.]+)"')


def test_an_alarm_is_one_entry_until_it_has_ended() -> None:
    log = AlarmLog()
    log.take([fault(True)], 100.0)
    log.take([fault(True)], 101.0)
    log.take([fault(False)], 105.0)
    (entry,) = log.entries
    assert (entry.began_s, entry.ended_s, entry.count) == (100.0, 105.0, 1)
    assert entry.fault.is_latched


def test_a_flickering_alarm_is_one_entry_with_a_count_and_few_sounds() -> None:
    """1,000 appearances within 100 s."""
    log = AlarmLog()
    for k in range(1000):
        log.take([fault(True)], 0.1 * k)
        log.take([fault(False)], 0.1 * k + 0.05)
    (entry,) = log.entries
    assert entry.count == 1000
    assert 1 <= log.sound_number <= 100.0 / SOUND_S + 1


def test_an_alarm_that_returns_later_is_new_and_has_to_be_acknowledged_again() -> None:
    log = AlarmLog()
    log.take([fault(True)], 0.0)
    assert log.acknowledge(1, "anna")
    log.take([fault(False)], 1.0)
    log.take([fault(True)], 1.0 + REPEATED_S - 0.1)
    assert len(log.entries) == 1
    log.take([fault(False)], 20.0)
    log.take([fault(True)], 20.0 + REPEATED_S + 0.1)
    assert [entry.acknowledged_by for entry in log.entries] == ["anna", ""]


def test_the_sound_repeats_until_the_alarm_is_acknowledged_or_has_ended() -> None:
    for silence in ("acknowledge", "end"):
        log = AlarmLog()
        log.take([fault(True)], 0.0)
        for k in range(1, 100):
            log.take([], 0.2 * k)
        before = log.sound_number
        assert before == 1 + int(19.8 // SOUND_S)
        if silence == "acknowledge":
            assert log.acknowledge(1, "anna")
            assert not log.acknowledge(1, "bo")
            assert log.entries[0].acknowledged_by == "anna"
        else:
            log.take([fault(False)], 20.0)
        log.take([], 100.0)
        log.take([], 200.0)
        assert log.sound_number <= before + (silence == "end")  # the end arrives with the last repetition
        assert not log.is_sounding


@pytest.mark.parametrize("severity", [Severity.NOTICE, Severity.WARNING])
def test_what_is_no_alarm_is_listed_without_a_sound(severity: Severity) -> None:
    log = AlarmLog()
    log.take([fault(True, severity)], 0.0)
    assert len(log.entries) == 1
    assert log.sound_number == 0


def test_acknowledging_what_is_not_there_changes_nothing() -> None:
    log = AlarmLog()
    log.take([fault(True)], 0.0)
    assert not log.acknowledge(7, "anna")
    assert log.entries[0].acknowledged_by == ""


def test_a_flood_of_different_alarms_is_bounded_and_drops_what_has_ended_first() -> None:
    log = AlarmLog()
    log.take([fault(True, code="first.active")], 0.0)
    for k in range(2000):
        log.take([fault(True, code=f"code.{k}"), fault(False, code=f"code.{k}")], 1.0 + k)
    assert len(log.entries) == MAX_ENTRIES
    assert log.dropped == 2001 - MAX_ENTRIES
    assert log.entries[0].fault.code == "first.active"
    assert len(log._newest) <= MAX_ENTRIES


def test_a_drive_that_ends_ends_its_alarms() -> None:
    log = AlarmLog()
    log.take([fault(True)], 0.0)
    log.end_all(5.0)
    assert log.entries[0].ended_s == 5.0
    assert not log.is_sounding
    log.take([fault(False)], 6.0)
    assert log.entries[0].ended_s == 5.0


def test_a_clock_that_steps_back_does_not_silence_the_sound() -> None:
    log = AlarmLog()
    log.take([fault(True)], 1e9)
    log.take([], 5.0)
    assert log.sound_number == 2


def test_rates_and_ages_of_topics() -> None:
    table = TopicTable()
    for k in range(101):  # 10 s
        now_s = 100.0 + 0.1 * k
        counts = {"odom": 5 * k, "gnss/main": min(k, 50), "fault/orders": 1, "truth_machine": k, "unknown": k}
        table.take(counts, now_s)
    rows = {row.topic: row for row in table.rows(110.0)}
    assert set(rows) == {"odom", "gnss/main", "fault/orders"}
    assert rows["odom"].rate_hz == pytest.approx(50.0, rel=0.01)
    assert (rows["odom"].expected_hz, rows["odom"].is_late) == (50.0, False)
    assert rows["gnss/main"].rate_hz == 0.0
    assert rows["gnss/main"].age_s == pytest.approx(5.0, abs=0.01)
    assert rows["gnss/main"].is_late
    assert rows["fault/orders"].expected_hz is None
    assert not rows["fault/orders"].is_late  # an event is not late


def test_a_table_without_messages_is_empty() -> None:
    assert TopicTable().rows(1.0) == []


def test_nodes_with_the_longest_latency_come_first() -> None:
    state = state_of(
        ("node_timing/tracker", NodeTiming(NOW_NS, 10, 0.012, 0.0314)),
        ("node_timing/supervisor", NodeTiming(NOW_NS, 50, 0.004, 0.1)),
    )
    rows = [["supervisor", "50", "4.0 ms", "100.0 ms"], ["tracker", "10", "12.0 ms", "31.4 ms"]]
    assert [[cell.replace("\u202f", " ") for cell in row] for row in node_rows(state)] == rows
    assert node_rows(state_of()) == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_of_the_machine_has_a_remedy(language: str) -> None:
    """All codes of rules, of the order gate, and of the faults that nodes report."""
    texts = texts_of(language)
    sources = [path for folder in ("interfaces", "localization", "safety") for path in (ROOT / folder).rglob("*.py")]
    codes = {code for path in sources for code in FAULT_TYPE.findall(Path(path).read_text(encoding="utf-8"))}
    codes |= {code.replace("*", "lidar_front") for code in codes_of(RULES) if code != "*"}
    codes |= {f"orders.{reason}" for reason in Reason} | {"node.exception", "log.failed"}
    assert len(codes) > 70
    assert not {code for code in codes if remedy(code, texts) == texts("remedy.other")}
    assert remedy("something.new", texts) == texts("remedy.other")


def test_frames_are_decoded_by_identifier_and_group() -> None:
    table = BusTable()
    speed = CanFrame(1, 0x0CFE48F0, bytes((0xE8, 3, 0, 0, 0, 0, 0, 0)))
    other_source = CanFrame(2, 0x0CFE4801, bytes((0xD0, 7, 0, 0, 0, 0, 0, 0)))
    unknown, cut = CanFrame(3, 0x18FF1234, b"\x01\xab"), CanFrame(4, 0x0CFE48F0, b"\x01")
    frames = CanFrames(5, "machine", (speed, speed, other_source, unknown))
    table.take([Envelope("can/rx", 0, 5, frames), Envelope("can/tx", 0, 5, CanFrames(5, "machine", (unknown,)))])
    rows = {(row.is_sent, row.identifier): row for row in table.rows()}
    assert rows[False, speed.identifier].count == 2
    for frame, value in ((speed, "Speed 1 m/s"), (other_source, "Speed 2 m/s")):
        assert rows[False, frame.identifier].name == "WheelBasedSpeed"
        assert value in rows[False, frame.identifier].values
    assert (rows[False, unknown.identifier].name, rows[False, unknown.identifier].values) == ("", "01 ab")
    assert rows[True, unknown.identifier].count == 1
    table.take([Envelope("can/rx", 0, 5, CanFrames(5, "machine", (cut,)))])
    assert [row.values for row in table.rows() if row.identifier == cut.identifier] == ["01"]
    flood = tuple(CanFrame(6, 0x18000000 + k, b"") for k in range(1000))
    table.take([Envelope("can/rx", 0, 6, CanFrames(6, "machine", flood))])
    assert len(table.rows()) == MAX_IDENTIFIERS
