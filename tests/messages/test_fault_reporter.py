"""Fault reporter: one message per change of state."""

from messages.fault_reporter import FaultReporter, FaultType
from messages.faults import Response, Severity

LOST = FaultType("a.lost", Severity.ALARM, Response.CONTROLLED_STOP, "Lost", "丢失")
LATCHED = FaultType("a.latched", Severity.WARNING, Response.NONE, "Latched", "锁存", is_latched=True)


def states(messages):
    return [(m.code, m.is_active, m.text_en) for m in messages]


def test_only_changes_become_messages():
    reporter = FaultReporter("node")
    reporter.set(LOST, False)
    assert reporter.take(1) == []
    reporter.set(LOST, True, "first")
    reporter.set(LOST, True, "second")
    (begun,) = reporter.take(2)
    assert (begun.stamp_ns, begun.source, begun.is_latched, begun.text_zh) == (2, "node", False, "丢失 (first)")
    assert reporter.is_active("a.lost")
    reporter.set(LOST, False, "third")
    assert states(reporter.take(3)) == [("a.lost", False, "Lost (third)")]
    assert reporter.take(4) == []


def test_messages_keep_the_order_of_the_calls():
    reporter = FaultReporter("node")
    assert states(reporter.update(1, [(LOST, True), (LATCHED, True)])) == [
        ("a.lost", True, "Lost"),
        ("a.latched", True, "Latched"),
    ]
    assert reporter.active_codes == ("a.lost", "a.latched")
    assert states(reporter.update(2, [(LATCHED, False), (LOST, False)])) == [
        ("a.latched", False, "Latched"),
        ("a.lost", False, "Lost"),
    ]


def test_clear_uses_the_texts_of_the_beginning():
    reporter = FaultReporter("node")
    reporter.clear("a.latched")
    reporter.set(LATCHED)
    reporter.clear("a.latched")
    begun, ended = reporter.take(1)
    assert begun.is_latched
    assert (ended.is_active, ended.text_en) == (False, "Latched")


def test_event_begins_and_ends_at_once():
    reporter = FaultReporter("node")
    reporter.report_event(LOST, "why")
    assert states(reporter.take(1)) == [("a.lost", True, "Lost (why)"), ("a.lost", False, "Lost (why)")]
    assert reporter.active_codes == ()
