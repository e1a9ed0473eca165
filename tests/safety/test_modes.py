"""Transition table in full; operator commands, time-outs, alarms, fault memory and timers."""

import math
from itertools import chain, combinations

import pytest

from messages.command import Mode, OperatorCommand, OperatorCommandKind, RuleResult
from messages.faults import Fault, Response, Severity
from safety.modes import PERSON, TRANSITIONS, Event, next_mode
from safety.monitors.memory import DebounceTimer, FaultMemory, RecentRange
from safety.monitors.operator_commands import OperatorCommands
from safety.monitors.watchdog import TopicAge, age_of, timed_out_topics
from safety.output.alarms import Alarms, text_zh
from safety.rules import RULES
from safety.supervisor import texts_of
from tests.clause import clause
from tests.safety.safety_world import START_NS, around

TEXTS = texts_of(RULES)
STOPPED = (Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
ENGAGED = (Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP)


@clause("BD-5.5.1b")
def test_transition_table() -> None:
    """The table written a second time; all other pairs leave the mode unchanged."""
    e, m = Event, Mode
    engaged = {e.EMERGENCY: m.EMERGENCY_STOP, e.HAND: m.MANUAL, e.FAULT: m.FAULT_STOP, e.MANUAL: m.MANUAL,
               e.PAUSE: m.STANDBY, e.DONE: m.FINISHED}  # fmt: skip
    expected = {
        m.MANUAL: {e.EMERGENCY: m.EMERGENCY_STOP, e.AUTOMATIC: m.STANDBY},
        m.STANDBY: {e.EMERGENCY: m.EMERGENCY_STOP, e.HAND: m.MANUAL, e.MANUAL: m.MANUAL, e.START: m.START_WARNING},
        m.START_WARNING: engaged | {e.OBSTACLE: m.OBSTACLE_STOP, e.WARNED: m.AUTOMATIC},
        m.AUTOMATIC: engaged | {e.WAIT: m.STANDBY, e.OBSTACLE: m.OBSTACLE_STOP},
        m.OBSTACLE_STOP: engaged | {e.CLEAR: m.START_WARNING},
        m.FAULT_STOP: {e.EMERGENCY: m.EMERGENCY_STOP, e.HAND: m.MANUAL, e.MANUAL: m.MANUAL, e.RESET: m.STANDBY},
        m.EMERGENCY_STOP: {e.RESET: m.STANDBY},
        m.FINISHED: {
            e.EMERGENCY: m.EMERGENCY_STOP,
            e.HAND: m.MANUAL,
            e.MANUAL: m.MANUAL,
            e.START: m.START_WARNING,
            e.RESET: m.STANDBY,
        },
    }
    for mode in Mode:
        for event in Event:
            assert next_mode(mode, frozenset({event})) is expected[mode].get(event, mode), (mode, event)


def every_set() -> list[frozenset[Event]]:
    return [frozenset(s) for s in chain.from_iterable(combinations(Event, n) for n in range(len(Event) + 1))]


def test_all_sets_of_events() -> None:
    """All 8 192 sets in all modes: the result is that of one of the set's events, and of the safest."""
    for mode in Mode:
        for events in every_set():
            after = next_mode(mode, events)
            alone = {next_mode(mode, frozenset({event})) for event in events} | {mode}
            assert after in alone
            if Event.EMERGENCY in events:
                assert after is Mode.EMERGENCY_STOP or mode is Mode.EMERGENCY_STOP
            if mode in ENGAGED and events & {Event.FAULT, Event.HAND}:
                assert after not in ENGAGED


def test_no_motion_after_a_stop_without_a_person() -> None:
    """Every sequence of events other than operator commands, from every mode in which the machine must wait."""
    unattended = [event for event in Event if event not in PERSON]
    for start in (*STOPPED, Mode.MANUAL, Mode.STANDBY, Mode.FINISHED):
        reached, frontier = {start}, [start]
        while frontier:
            mode = frontier.pop()
            for event in unattended:
                after = next_mode(mode, frozenset({event}))
                if after not in reached:
                    reached.add(after)
                    frontier.append(after)
        assert not reached & set(ENGAGED), start


def test_reset_and_start_after_a_stop() -> None:
    for mode in STOPPED:
        assert Event.START not in TRANSITIONS[mode]
        for events in every_set():
            assert next_mode(mode, events) not in ENGAGED


def test_only_reset_ends_an_emergency_stop() -> None:
    assert set(TRANSITIONS[Mode.EMERGENCY_STOP]) == {Event.RESET}


def order(
    kind: OperatorCommandKind, sequence: int = 0, authority: str = "operator", expires_ns: int = 100
) -> OperatorCommand:
    return OperatorCommand(0, kind, authority, sequence, expires_ns)


def test_event_of_each_operator_command() -> None:
    expected = {OperatorCommandKind.START: Event.START, OperatorCommandKind.RESUME: Event.START,
    OperatorCommandKind.PAUSE: Event.PAUSE,
                OperatorCommandKind.EMERGENCY_STOP: Event.EMERGENCY, OperatorCommandKind.RESET: Event.RESET,
                OperatorCommandKind.MANUAL: Event.MANUAL,
                OperatorCommandKind.AUTOMATIC: Event.AUTOMATIC}  # fmt: skip
    for kind in OperatorCommandKind:
        events = OperatorCommands(("operator",), 60.0, 30.0).events(0, [order(kind)])
        assert events == ({expected[kind]} if kind in expected else frozenset())


OTHERS = (OperatorCommandKind.EMERGENCY_STOP, OperatorCommandKind.NUDGE)  # always accepted; for the mission alone


@pytest.mark.parametrize("kind", [k for k in OperatorCommandKind if k not in OTHERS])
def test_refused_operator_commands(kind: OperatorCommandKind) -> None:
    orders = OperatorCommands(("operator", "remote"), 60.0, 30.0)

    def is_accepted(command: OperatorCommand, now_ns: int = 0) -> bool:
        orders.forget_start()
        orders.forget_confirmation()
        events = orders.events(now_ns, [command])
        return bool(events) or orders.is_confirmed(0)

    assert not is_accepted(order(kind, authority="passer-by"))
    assert not is_accepted(order(kind), 101)
    assert is_accepted(order(kind, 5))
    for sequence in range(6):
        assert not is_accepted(order(kind, sequence)), sequence
    assert orders.refused_count == 8
    assert is_accepted(order(kind, 6))
    assert is_accepted(order(kind, 0, "remote"))


def test_first_sequence_and_expiry() -> None:
    orders = OperatorCommands(("operator",), 60.0, 30.0)
    assert orders.events(0, [order(OperatorCommandKind.PAUSE, -1)]) == frozenset()
    assert orders.events(100, [order(OperatorCommandKind.PAUSE, 0)]) == {Event.PAUSE}


def test_emergency_stop_without_authority() -> None:
    orders = OperatorCommands(("operator",), 60.0, 30.0)
    stop = order(OperatorCommandKind.EMERGENCY_STOP, -5, "passer-by", -1)
    assert orders.events(1000, [stop, stop]) == {Event.EMERGENCY}


def test_waiting_start() -> None:
    orders = OperatorCommands(("operator",), 60.0, 30.0)
    assert orders.events(0, [order(OperatorCommandKind.START, 1)]) == {Event.START}
    for now in around(100, 1):
        assert orders.events(int(now), []) == ({Event.START} if now <= 100 else frozenset()), now
    for other in (
        OperatorCommandKind.PAUSE,
        OperatorCommandKind.RESET,
        OperatorCommandKind.MANUAL,
        OperatorCommandKind.AUTOMATIC,
        OperatorCommandKind.EMERGENCY_STOP,
    ):
        orders = OperatorCommands(("operator",), 60.0, 30.0)
        orders.events(0, [order(OperatorCommandKind.START, 1)])
        assert Event.START not in orders.events(1, [order(other, 2)])
        assert orders.events(2, []) == frozenset()


def test_topic_age_limit() -> None:
    for age_ms in around(100, 1):
        age = age_of("odom", START_NS, START_NS + round(age_ms * 1e6))
        assert age.is_stale == (age_ms > 100), age_ms
        assert age_of("odom", START_NS + round(age_ms * 1e6), START_NS).is_stale == (age_ms > 100)
    for age_ms in around(60, 1):
        assert age_of("odom", START_NS, START_NS + round(age_ms * 1e6)).is_late == (age_ms > 60), age_ms
    never = age_of("path", None, START_NS)
    assert never.is_stale
    assert never.is_late
    assert not age_of("path", 0, START_NS).is_stale


FINE, LATE, STALE = 0.01, 0.08, 0.2


def blamed(**ages_s: float) -> tuple[str, ...]:
    sensors = ("machine", "imu", "wheel", "lidar/rear", "lidar/front", "health/lidar_front")
    order_of = (*sensors, "odom", "map_pose", "tracks", "control_command")
    return timed_out_topics([TopicAge(topic, ages_s.get(topic.replace("/", "_"), FINE), 0.1) for topic in order_of])


def test_root_cause() -> None:
    assert blamed() == ()
    assert blamed(odom=STALE) == ("odom",)
    assert blamed(odom=STALE, imu=LATE) == ("imu",)
    assert blamed(odom=STALE, imu=STALE, control_command=STALE, map_pose=STALE) == ("imu",)
    assert blamed(control_command=STALE, odom=LATE) == ("odom",)
    assert blamed(control_command=STALE, odom=LATE, wheel=LATE) == ("wheel",)
    assert blamed(tracks=STALE, lidar_front=LATE) == ("lidar/front",)
    assert blamed(tracks=STALE) == ("tracks",)
    assert blamed(health_lidar_front=STALE) == ("health/lidar_front",)
    assert blamed(health_lidar_front=STALE, lidar_front=LATE) == ("lidar/front",)
    assert blamed(health_lidar_front=STALE, lidar_rear=LATE) == ("health/lidar_front",)
    assert blamed(health_lidar_front=STALE, odom=LATE, imu=LATE) == ("imu",)
    assert blamed(tracks=STALE, health_lidar_front=LATE) == ("health/lidar_front",)
    assert blamed(lidar_front=STALE, odom=STALE) == ("lidar/front", "odom")
    assert blamed(machine=STALE, control_command=STALE) == ("machine",)


def fault(code: str, is_active: bool = True, is_latched: bool = False) -> Fault:
    stop = Response.CONTROLLED_STOP
    return Fault(0, code, "part", Severity.ALARM, is_latched, stop, is_active, "broken", "kaputt")


def test_fault_memory() -> None:
    fault_memory = FaultMemory()
    fault_memory.update([fault("a"), fault("b", is_latched=True), fault("c", is_active=False)])
    assert [f.code for f in fault_memory.active] == ["a", "b"]
    fault_memory.reset()
    assert len(fault_memory.active) == 2
    fault_memory.update([fault("a", False), fault("b", False, True)])
    assert [f.code for f in fault_memory.active] == ["b"]
    fault_memory.update([fault("b", True, True)])
    fault_memory.reset()
    assert [f.code for f in fault_memory.active] == ["b"]
    fault_memory.update([fault("b", False, True)])
    fault_memory.reset()
    assert fault_memory.active == ()


def result(code: str, response: Response = Response.CONTROLLED_STOP) -> RuleResult:
    return RuleResult(code, response, 0.0, "text")


def test_alarm_spacing() -> None:
    alarms, reported = Alarms(TEXTS), []
    wanted = [result("imu.silent"), result("odom.silent"), result("localization.gnss_lost", Response.NONE)]
    for k in range(150):
        reported += [(k, f.code, f.is_active) for f in alarms.update(k * 20_000_000, wanted)]
    assert reported == [(0, "imu.silent", True), (50, "odom.silent", True), (100, "localization.gnss_lost", True)]
    (first,) = Alarms(TEXTS).update(7, wanted[:1])
    assert first == Fault(7, "imu.silent", "supervisor", Severity.ALARM, True, Response.CONTROLLED_STOP, True, "text",
                          "imu 无消息")  # fmt: skip
    (warning,) = Alarms(TEXTS).update(7, [result("odd.code", Response.LIMIT)])
    assert (warning.severity, warning.is_latched, warning.response) == (Severity.WARNING, False, Response.LIMIT)
    assert warning.text_zh == "部件报告故障：odd.code"
    over = alarms.update(3_000_000_000, wanted[:1])
    assert {f.stamp_ns for f in over} == {3_000_000_000}
    assert [(f.code, f.is_active, f.severity) for f in over] == [
        ("odom.silent", False, Severity.ALARM), ("localization.gnss_lost", False, Severity.WARNING),
    ]  # fmt: skip


def test_chinese_texts() -> None:
    assert text_zh(TEXTS, "lidar/front.silent") == "lidar/front 无消息"
    assert text_zh(TEXTS, "lidar/front.frozen") == "lidar/front 数据重复不变"
    assert text_zh(TEXTS, "radar/front.blind") == "radar/front 被遮挡"
    assert text_zh(TEXTS, "a.b.silent") == "a.b 无消息"
    assert text_zh(TEXTS, "control_command.silent") == "控制器无消息"
    assert text_zh(TEXTS, "driver_override").startswith("手握方向盘")
    assert text_zh(TEXTS, "odd.code") == "部件报告故障：odd.code"
    assert text_zh(TEXTS, "silent") == "部件报告故障：silent"


def test_debounce_timer_and_recent_range() -> None:
    held = DebounceTimer()
    assert not held.is_held
    assert [held.update(k * 10**9, k >= 2) for k in range(5)] == [0.0, 0.0, 0.0, 1.0, 2.0]
    assert held.is_held
    assert held.update(1, True) == 0.0  # the clock went back: restarted
    assert held.update(2, False) == 0.0
    window = RecentRange(1.0)
    assert window.distance(3.0) == 0.0
    for k in range(5):
        window.add(k * 10**9, float(k))
    assert [window.distance(v) for v in (2.0, 3.0, 4.0, 5.0)] == [1.0, 0.0, 0.0, 1.0]
    assert math.isnan(window.distance(math.nan))
    window.add(4 * 10**9 + 1, 6.0)  # the value of 3 s is too old by a nanosecond
    assert [window.distance(v) for v in (3.0, 5.0)] == [1.0, 0.0]
