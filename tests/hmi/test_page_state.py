"""Page state and drive view as functions of messages: worked area, ages, causes, next steps, orders available."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely import Polygon

from geometry.pose2 import Pose2
from hmi.coverage import Coverage
from hmi.drive_view.alarms import alarm_rows
from hmi.drive_view.controls import CONTROLS, ORDERS, unavailable
from hmi.drive_view.machine import machine_rows
from hmi.drive_view.motion import compass_deg, motion_rows, work_rows
from hmi.drive_view.position import position_rows
from hmi.drive_view.standing import standing
from hmi.page_state import PageState
from hmi.shown import shown_of
from hmi.texts import texts_of
from messages.command import Mode
from messages.faults import Severity
from messages.message import Envelope
from messages.perception import ObstacleClass
from messages.plan import MissionState, PathSectionType
from messages.sensors import GnssFix, GnssSolution
from tests.hmi.drive_messages import (
    NOW_NS,
    SECOND_NS,
    demo_scene,
    fault,
    machine,
    map_pose,
    mission,
    odometry,
    rule,
    state_of,
    status,
    supervisor,
)

EN, ZH = texts_of("en"), texts_of("zh")


def rule_text(code: str) -> str:
    return f"中文 {code}"


def drive(coverage_of: list[tuple[float, float]], is_in_work: bool = True) -> float:
    """Worked area (m²) after driving east through these points."""
    state = state_of(("map_pose", map_pose()), ("machine", machine(is_hitch_in_work=is_in_work)))
    state.take(NOW_NS, [Envelope("odom", 0, NOW_NS, odometry(x, y)) for x, y in coverage_of])
    return state.coverage.area_m2


def test_worked_area_is_length_times_width() -> None:
    scene = demo_scene()
    points = [(20.0 + 0.1 * k, 25.0) for k in range(301)]
    assert drive(points) == pytest.approx(30.0 * scene.implement.working_width_m, rel=0.02)


def test_area_passed_twice_or_with_raised_implement_or_outside_the_field_counts_once_or_not() -> None:
    points = [(20.0 + 0.1 * k, 25.0) for k in range(301)]
    assert drive(points + points[::-1]) == drive(points)
    assert drive(points, is_in_work=False) == 0.0
    assert drive([(20.0 + 0.1 * k, -25.0) for k in range(301)]) == 0.0


def test_a_jump_of_the_pose_works_nothing() -> None:
    near = [(20.0 + 0.1 * k, 25.0) for k in range(51)]
    far = [(60.0 + 0.1 * k, 10.0) for k in range(51)]
    assert drive(near + far) == pytest.approx(drive(near) + drive(far), abs=1.0)


@pytest.mark.parametrize("cell_m", [0.1, 0.25, 0.5])
def test_area_of_a_slanted_strip(cell_m: float) -> None:
    scene = demo_scene()
    coverage = Coverage(scene.field, 6.0, 0.0, cell_m)
    start = Pose2(15.0, 10.0, 0.6)
    for k in range(401):
        coverage.update(start.ahead(0.1 * k), True)
    assert coverage.area_m2 == pytest.approx(6.0 * 40.0, rel=0.02)


def test_old_messages_are_not_shown_as_present() -> None:
    messages = (("supervisor", supervisor(Mode.AUTOMATIC)), ("odom", odometry(0.0, 0.0, speed_mps=2.0)))
    state = state_of(*messages)
    assert standing(state, EN, rule_text).mode == "Automatic"
    assert motion_rows(state, EN)[0].value.startswith("7.2")
    state.take(NOW_NS + 2 * SECOND_NS, [])
    found = standing(state, EN, rule_text)
    assert (found.mode, found.level) == ("No data", "alarm")
    assert "nothing for 2" in found.cause
    assert motion_rows(state, EN)[0].value == "–"
    assert set(unavailable(state, EN)) == set(CONTROLS)


def test_before_the_first_message_everything_is_unknown() -> None:
    state = state_of()
    assert standing(state, EN, rule_text).cause == EN("cause.no_data_yet")
    shown = shown_of(state, EN, rule_text, None)
    assert shown["map"] == {"pose": None}
    assert all(level != "good" for *_, level in shown["machine"])


def test_cause_of_a_fault_has_the_text_of_its_message_in_both_languages() -> None:
    state = state_of(("fault/supervisor", fault(True)), ("supervisor", supervisor(Mode.FAULT_STOP, "brake.weak")))
    assert standing(state, EN, rule_text).cause == "Brake weak"
    assert standing(state, ZH, rule_text).cause == "制动弱"
    assert "release the stop" in standing(state, EN, rule_text).next_step


def test_cause_without_a_message_has_the_text_of_the_rule() -> None:
    found = supervisor(Mode.STANDBY, "tilt", rules=(rule("tilt", "tilted by 20°"),))
    state = state_of(("supervisor", found))
    assert standing(state, EN, rule_text).cause == "Tilted by 20°"
    assert standing(state, ZH, rule_text).cause == "中文 tilt"
    assert "remove the cause" in standing(state, EN, rule_text).next_step


def test_cause_of_an_obstacle_stop_names_class_and_distance_once() -> None:
    values = {"obstacle_class": ObstacleClass.PERSON, "clearance_m": 3.21}
    named = supervisor(Mode.OBSTACLE_STOP, "track", rules=(rule("track", "person 3.2 m ahead"),), **values)
    unnamed = supervisor(Mode.OBSTACLE_STOP, "field", rules=(rule("field", "obstacle 3.2 m ahead"),), **values)
    assert standing(state_of(("supervisor", named)), EN, rule_text).cause == "Person 3.2 m ahead"
    assert standing(state_of(("supervisor", unnamed)), EN, rule_text).cause.endswith("(Person, 3.2\u202fm)")
    assert "人" in standing(state_of(("supervisor", named)), ZH, rule_text).cause


@pytest.mark.parametrize("mode", Mode)
def test_each_mode_has_cause_and_next_step_in_both_languages(mode: Mode) -> None:
    state = state_of(("supervisor", supervisor(mode, str(mode))))
    for texts in (EN, ZH):
        found = standing(state, texts, rule_text)
        assert found.mode
        assert found.cause
        assert found.next_step


def available(mode: Mode, reason: str, mission_state: MissionState, **values: object) -> set[str]:
    state = state_of(
        ("supervisor", supervisor(mode, reason)), ("order_status", status()), ("odom", odometry(0.0, 0.0)),
        ("mission", mission(mission_state)), ("machine", machine(**values)),
    )  # fmt: skip
    return set(ORDERS) - set(unavailable(state, EN))


@pytest.mark.parametrize(
    ("mode", "reason", "mission_state", "expected"),
    [
        (Mode.STANDBY, "standby", MissionState.WAITING, {"confirm_clear", "start", "manual"}),
        (Mode.STANDBY, "operator_command.unconfirmed", MissionState.WAITING, {"confirm_clear", "start", "manual"}),
        (Mode.STANDBY, "standby", MissionState.DRIVING, {"confirm_clear", "resume", "manual"}),
        (Mode.STANDBY, "tilt", MissionState.WAITING, {"confirm_clear", "manual"}),
        (Mode.START_WARNING, "start_warning", MissionState.DRIVING, {"confirm_clear", "pause", "manual"}),
        (Mode.AUTOMATIC, "", MissionState.DRIVING, {"pause", "manual"}),
        (Mode.OBSTACLE_STOP, "track", MissionState.DRIVING, {"confirm_clear", "pause", "manual"}),
        (Mode.FAULT_STOP, "tilt", MissionState.DRIVING, {"reset", "manual"}),
        (Mode.EMERGENCY_STOP, "emergency_stop.button", MissionState.DRIVING, {"reset"}),
        (Mode.MANUAL, "manual", MissionState.WAITING, {"automatic"}),
        (Mode.FINISHED, "finished", MissionState.FINISHED, {"manual"}),
    ],
)
def test_orders_available_by_mode(mode: Mode, reason: str, mission_state: MissionState, expected: set[str]) -> None:
    assert available(mode, reason, mission_state) == expected | {"forbid"}


@pytest.mark.parametrize("section", PathSectionType)
@pytest.mark.parametrize("mode", [Mode.AUTOMATIC, Mode.OBSTACLE_STOP, Mode.STANDBY])
def test_a_row_is_shifted_while_it_is_driven(mode: Mode, section: PathSectionType) -> None:
    driven = replace(mission(MissionState.DRIVING), section_type=section, shift_left_m=-0.03)
    state = state_of(("supervisor", supervisor(mode, str(mode))), ("order_status", status()), ("mission", driven))
    is_possible = mode is Mode.AUTOMATIC and section is PathSectionType.SWATH
    assert {"nudge_left", "nudge_right"}.isdisjoint(unavailable(state, EN)) is is_possible
    (shown,) = (row.value for row in work_rows(state, EN) if row.key == "shift")
    assert shown == ("3\u202fcm right" if section is PathSectionType.SWATH else "–")


def test_while_operation_is_forbidden_it_is_not_started_and_the_state_says_so() -> None:
    forbidden = replace(status(), is_forbidden=True)
    for mode in (Mode.STANDBY, Mode.AUTOMATIC, Mode.EMERGENCY_STOP):
        state = state_of(("supervisor", supervisor(mode, str(mode))), ("order_status", forbidden))
        found = unavailable(state, EN)
        assert found["start"] == found["resume"] == "Operation is forbidden"
        assert "permit" not in found
        assert found["forbid"]
    state = state_of(("supervisor", supervisor(Mode.STANDBY, "standby")), ("order_status", forbidden))
    assert standing(state, EN, str).cause == "A person has forbidden operation."


def test_a_stop_is_not_released_while_moving_or_with_the_button_pressed() -> None:
    assert "reset" not in available(
        Mode.EMERGENCY_STOP, "x", MissionState.DRIVING, is_emergency_button_pressed=True
    )  # fmt: skip
    motion = odometry(0.0, 0.0, speed_mps=0.2)
    moving = state_of(("supervisor", supervisor(Mode.FAULT_STOP)), ("order_status", status()), ("odom", motion))
    assert unavailable(moving, EN)["reset"] == "The machine still moves"


def test_alarms_end_with_their_fault_and_the_worst_is_first() -> None:
    warning = fault(True, Severity.WARNING, "gnss.refused")
    state = state_of(("fault/supervisor", warning), ("fault/supervisor", fault(True)))
    assert [row.level for row in alarm_rows(state, EN)] == ["alarm", "warning"]
    assert alarm_rows(state, EN)[0].value == "Brake weak – stops the machine"
    state.take(NOW_NS, [Envelope("fault/supervisor", 0, NOW_NS, fault(False))])
    assert [row.level for row in alarm_rows(state, EN)] == ["warning"]


def test_time_left_needs_a_mean_speed() -> None:
    def rows(engaged_s: int) -> dict[str, str]:
        state = state_of(("mission", mission(MissionState.DRIVING, 25.0, 100.0, NOW_NS + engaged_s * SECOND_NS)))
        for k in range(engaged_s + 1):
            at_ns = NOW_NS + k * SECOND_NS
            state.take(at_ns, [Envelope("supervisor", k, at_ns, supervisor(Mode.AUTOMATIC, "", at_ns))])
        return {row.key: row.value for row in work_rows(state, EN)}

    assert rows(10)["time_left"] == "–"
    assert rows(60)["time_left"] == "3\u202fmin"  # 75 m at 25 m per minute


@pytest.mark.parametrize(("yaw_deg", "heading_deg"), [(90, 0), (0, 90), (-90, 180), (180, 270), (90.3, 0), (450, 0)])
def test_heading_is_clockwise_from_north(yaw_deg: float, heading_deg: float) -> None:
    assert compass_deg(math.radians(yaw_deg)) == heading_deg


def test_actuators_that_never_reported_are_unknown() -> None:
    state = state_of(("machine", machine(implement_stamp_ns=0)))
    values = {row.key: row.value for row in machine_rows(state, EN)}
    assert values["hitch"] == values["pto"] == "–"
    assert values["park_brake"] == "set"


def test_equal_messages_show_equal_values() -> None:
    messages = (
        ("supervisor", supervisor(Mode.AUTOMATIC)), ("map_pose", map_pose(3.0, 4.0, 0.5)), ("odom", odometry(1.0, 2.0)),
    )  # fmt: skip
    first, second = (shown_of(state_of(*messages), ZH, rule_text, None) for _ in range(2))
    assert first == second


def test_worked_area_of_a_turn_about_a_point_within_the_working_width() -> None:
    """Half a turn of a line of 12 m about a point 2 m from its middle: its ends sweep half discs of 8 m and 4 m."""
    coverage = Coverage(Polygon([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]), 12.0, 0.0, 0.05)
    for angle in np.linspace(0.0, math.pi, 400):
        coverage.update(Pose2(2.0 * math.sin(angle), -2.0 * math.cos(angle), float(angle)), True)
    assert coverage.area_m2 == pytest.approx(0.5 * math.pi * (8.0**2 + 4.0**2), rel=0.02)


def gnss(stamp_ns: int, age_s: float, solution: GnssSolution = GnssSolution.RTK_FIXED) -> GnssFix:
    return GnssFix(
        stamp_ns, 0.9, 0.1, 50.0, np.ones(3), np.zeros(3), math.nan, math.nan, math.nan, solution, 20, 0.6, age_s, "BDS"
    )


def test_failed_corrections_are_an_alarm_after_they_were_received() -> None:
    """By any receiver; too old or none, for longer than 2 s; it ends when they return."""
    scene = replace(demo_scene(), max_correction_age_s=20.0)
    state = PageState(scene, 0.25)

    def after(seconds: float, age_s: float, name: str = "main") -> tuple[set[str], str]:
        now_ns = NOW_NS + round(seconds * 1e9)
        state.take(now_ns, [Envelope(f"gnss/{name}", 0, now_ns, gnss(now_ns, age_s))])
        links = [one.value for one in position_rows(state, EN) if one.key == "link"]
        return {code for _, code in state.faults}, links[0]

    lost = {"corrections.lost"}
    assert after(0.0, math.nan) == (set(), "none")  # never received: nothing has failed
    assert after(60.0, 1.0) == (set(), "receiving")
    assert after(61.0, 21.0) == (set(), "too old, not used")
    assert after(63.0, 23.0)[0] == lost
    assert after(64.0, math.nan) == (lost, "none")
    assert after(65.0, 0.5) == (set(), "receiving")
    state.take(NOW_NS + 80 * SECOND_NS, [])
    assert {code for _, code in state.faults} == lost  # the receiver is silent
    assert after(81.0, 0.5)[0] == set()
    assert after(84.0, 0.5, "second")[0] == set()
    assert after(84.5, 30.0)[0] == set()  # the second one has them
