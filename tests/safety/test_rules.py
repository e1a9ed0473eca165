"""Each rule at its limit."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.mission import Consent
from messages.faults import Fault, Response, Severity
from messages.motion import PositionSource
from messages.perception import ObstacleClass
from safety.monitors.brake_test import Phase
from safety.monitors.sensors import SensorFailure
from safety.rules import RULES
from safety.rules.arbitration import allowance_m, evaluate_rules
from safety.rules.rule import Effect
from safety.stopping_distance import highest_speed, stopping_distance
from safety.supervisor_config import SupervisorConfig
from safety.zones.protective_field import Clearance
from safety.zones.standing_bodies import StandingBody
from safety.zones.tracked_obstacles import CriticalObject
from tests.clause import clause
from tests.safety.safety_world import START_NS, around, machine_state, situation_of

NONE, LIMIT, STOP, EMERGENCY = Response.NONE, Response.LIMIT, Response.CONTROLLED_STOP, Response.EMERGENCY_STOP


NO_OBJECTION = {
    "emergency_stop": "emergency_stop.button", "driver_override": "driver_override", "clock_step": "clock_step",
    "reported_fault": "reported_fault",
    "message_timeout": "message_timeout", "lidar_agreement": "lidar_agreement",
    "supply_voltage": "supply_voltage", "steering": "steering",
    "drive": "drive.not_following", "brake": "brake.weak", "overspeed": "overspeed",
    "localization": "localization", "tilt": "tilt", "geofence": "geofence", "implement_fold": "implement_fold",
    "protective_field": "protective_field",
    "tracked_obstacle": "tracked_obstacle", "standing_body": "standing_body",
    "detection_range": "detection_range.limit", "sensor_loss": "sensor_loss",
    "vegetation": "vegetation", "wall_clearance": "wall_clearance",
    "speed_limit": "speed_limit",
}  # fmt: skip


def ask(rule: str, config: SupervisorConfig, **changes: Any) -> tuple[Response, str, float]:
    result = RULES[rule](situation_of(config, **changes))
    assert isinstance(result.text, str)
    assert result.text or result.response is NONE
    return result.response, result.code, result.speed_limit_mps


def with_machine(**changes: Any) -> dict[str, Any]:
    return {"machine": machine_state(START_NS, **changes)}


@pytest.mark.parametrize("rule", RULES)
def test_no_objection(rule: str, config: SupervisorConfig) -> None:
    response, code, limit = ask(rule, config)
    assert response <= LIMIT
    assert limit >= 8.0
    assert code == NO_OBJECTION[rule]


@pytest.mark.parametrize(
    "rule",
    ["emergency_stop", "driver_override", "supply_voltage", "steering", "localization", "tilt", "implement_fold"],
)
def test_missing_inputs_are_left_to_message_timeout(rule: str, config: SupervisorConfig) -> None:
    missing = ask(rule, config, machine=None, map_pose=None, odom=None, is_foldable=True)
    assert missing == (NONE, NO_OBJECTION[rule], math.inf)


@clause(rule="clock_step")
def test_clock_step(config: SupervisorConfig) -> None:
    for step in around(0.0, 0.6):
        assert ask("clock_step", config, clock_step_s=step)[:2] == (STOP if step else NONE, "clock_step"), step


@clause("BD-5.8.1b", rule="emergency_stop")
def test_emergency_button_and_pedal(config: SupervisorConfig) -> None:
    pressed = ask("emergency_stop", config, **with_machine(is_emergency_button_pressed=True))
    assert pressed[:2] == (EMERGENCY, "emergency_stop.button")
    for pedal in around(0.05, 0.004):
        expected = EMERGENCY if pedal >= 0.05 else NONE
        assert ask("emergency_stop", config, **with_machine(brake_pedal=pedal))[0] is expected, pedal
    assert ask("emergency_stop", config, **with_machine(brake_pedal=math.nan))[:2] == (
        EMERGENCY,
        "emergency_stop.pedal",
    )


@pytest.mark.parametrize("sign", [1, -1])
@clause("BD-5.5.2e", rule="driver_override")
def test_driver_override(config: SupervisorConfig, sign: int) -> None:
    for rate in around(50.0, 0.125):
        expected = STOP if rate >= 50.0 else NONE
        assert (
            ask("driver_override", config, **with_machine(driver_rate_radps=sign * math.radians(rate)))[0] is expected
        ), rate
    for angle in around(30.0, 0.1):
        expected = STOP if angle > 30.0 + 1e-9 else NONE
        assert (
            ask("driver_override", config, **with_machine(driver_angle_rad=sign * math.radians(angle)))[0] is expected
        ), angle
    for forced in around(1.0, 0.02):
        assert ask("driver_override", config, driver_override_s=forced)[0] is (STOP if forced > 1.0 else NONE), forced
    assert ask("driver_override", config, **with_machine(driver_rate_radps=math.nan))[:2] == (STOP, "driver_override")
    assert ask("driver_override", config, **with_machine(driver_angle_rad=math.nan))[:2] == (STOP, "driver_override")
    assert ask("driver_override", config, driver_override_s=2.0)[:2] == (STOP, "driver_override")


def fault(response: Response, code: str = "x.y") -> Fault:
    return Fault(START_NS, code, "part", Severity.ALARM, False, response, True, "broken", "kaputt")


@clause("BD-5.2.4", "BD-5.5.2d", rule="lidar_agreement")
def test_first_lidar_that_contradicts_the_others(config: SupervisorConfig) -> None:
    failures = tuple(SensorFailure("lidar", f"lidar/{name}.contradicted", name) for name in ("front", "rear"))
    result = RULES["lidar_agreement"](situation_of(config, lidar_failures=failures))
    assert (result.response, result.code, result.text) == (STOP, "lidar/front.contradicted", "front")


@pytest.mark.parametrize("response", list(Response))
@clause(rule="reported_fault")
def test_reported_faults(config: SupervisorConfig, response: Response) -> None:
    faults = (fault(NONE, "a"), fault(response, "b"), fault(NONE, "c"))
    got = ask("reported_fault", config, faults=faults)
    assert got[:2] == (response, "b" if response else "a")
    assert got[2] == (math.inf if response is NONE else pytest.approx(5 / 3.6) if response is LIMIT else 0.0)


@clause("BD-5.5.1a", "BD-5.5.2d", rule="message_timeout")
def test_message_timeout(config: SupervisorConfig) -> None:
    assert ask("message_timeout", config, timed_out_topics=("imu", "odom"))[:2] == (STOP, "imu.silent")
    assert ask("message_timeout", config, timed_out_topics=("control_command",))[:2] == (STOP, "control_command.silent")
    assert ask("message_timeout", config, timed_out_topics=("control_command",), speed_mps=0.0) == (
        LIMIT,
        "control_command.silent",
        0.0,
    )
    assert ask("message_timeout", config, timed_out_topics=("mission",))[:2] == (STOP, "mission.silent")
    assert ask("message_timeout", config, timed_out_topics=("mission",), speed_mps=0.0) == (
        LIMIT,
        "mission.silent",
        0.0,
    )
    assert ask("message_timeout", config, frozen=("lidar/front",))[:2] == (STOP, "lidar/front.frozen")
    assert ask("message_timeout", config, machine=None)[0] is NONE
    assert ask("message_timeout", config, odom=None)[:2] == (STOP, "odom.invalid")
    assert ask("message_timeout", config, map_pose=None)[:2] == (STOP, "map_pose.invalid")


@pytest.mark.parametrize("group", ["heartbeat", "motion", "steering", "cab"])
@clause("BD-5.5.1a", "BD-5.5.2d", rule="message_timeout")
def test_timeout_of_a_machine_state_group(config: SupervisorConfig, group: str) -> None:
    for age_ms in around(250, 1):
        changes = {f"{group}_stamp_ns": START_NS - round(age_ms * 1e6)}
        expected = (STOP, f"machine.{group}.silent") if age_ms > 250 else (NONE, "message_timeout")
        assert ask("message_timeout", config, **with_machine(**changes))[:2] == expected, age_ms


@clause("BD-5.6.1a", "BD-5.1d", rule="supply_voltage")
def test_supply_voltage(config: SupervisorConfig) -> None:
    for volts in around(9.0, 0.05):
        assert ask("supply_voltage", config, **with_machine(supply_v=volts))[0] is (NONE if volts >= 9.0 else STOP), (
            volts
        )
    for volts in around(36.0, 0.05):
        assert ask("supply_voltage", config, **with_machine(supply_v=volts))[0] is (NONE if volts <= 36.0 else STOP), (
            volts
        )
    assert ask("supply_voltage", config, **with_machine(supply_v=math.nan))[:2] == (STOP, "supply_voltage")


@clause("BD-5.5.2a", "BD-5.5.2d", rule="steering")
def test_steering(config: SupervisorConfig) -> None:
    for held in around(0.4, 0.02):
        expected = (STOP, "steering.not_following") if held > 0.4 else (NONE, "steering")
        assert ask("steering", config, steering_deviation_s=held)[:2] == expected, held
        expected = (STOP if held > 0.4 else LIMIT, "steering.not_ready")
        assert (
            ask("steering", config, steering_unavailable_s=held, **with_machine(is_steering_ready=False))[:2]
            == expected
        )
    assert ask("steering", config, **with_machine(is_steering_ready=False)) == (LIMIT, "steering.not_ready", 0.0)


@clause("BD-5.2.5a", rule="drive")
def test_drive(config: SupervisorConfig) -> None:
    for held in around(5.0, 0.02):
        expected = STOP if held > 5.0 else NONE
        changes = {"drive_ineffective_s": held, **with_machine(speed_mps=2.0)}
        assert ask("drive", config, **changes)[:2] == (expected, "drive.not_following"), held
    for difference in around(0.25, 0.01):
        changes = {"drive_ineffective_s": 5.1, **with_machine(speed_mps=2.0 + difference)}
        code = "speeds.contradicted" if difference > 0.25 else "drive.not_following"
        assert ask("drive", config, **changes)[:2] == (STOP, code), difference


@clause("BD-5.2.5b", rule="brake")
def test_brake(config: SupervisorConfig) -> None:
    for held in around(0.8, 0.02):
        assert ask("brake", config, brake_ineffective_s=held)[:2] == (
            EMERGENCY if held > 0.8 else NONE,
            "brake.weak",
        ), held
    for phase in (Phase.CREEP, Phase.BRAKE, Phase.FAILED):
        assert ask("brake", config, brake_test=phase)[1].startswith("brake.test"), phase


@clause("BD-5.2.5a", rule="overspeed")
def test_overspeed(config: SupervisorConfig) -> None:
    for held in around(0.1, 0.02):
        changes = {"overspeed_s": held, **with_machine(speed_mps=2.0)}
        assert ask("overspeed", config, **changes)[:2] == (EMERGENCY if held > 0.1 else NONE, "overspeed"), held
    for difference in around(0.25, 0.01):
        for sign in (1, -1):
            changes = {"overspeed_s": 0.2, **with_machine(speed_mps=2.0 + sign * difference)}
            code = "speeds.contradicted" if difference > 0.25 else "overspeed"
            assert ask("overspeed", config, **changes)[:2] == (EMERGENCY, code), difference
    for missing in ({"machine": None}, {"odom": None}):
        assert ask("overspeed", config, overspeed_s=0.2, **missing)[:2] == (EMERGENCY, "overspeed")


@clause("BD-5.3d", "BD-5.2.6a", rule="localization")
def test_localization(config: SupervisorConfig) -> None:
    for level in around(0.5, 0.01):
        expected = (STOP, "localization.protection") if level > 0.5 else (LIMIT, "localization")
        assert ask("localization", config, pose={"protection_level_m": level})[:2] == expected, level
        brief = ask("localization", config, pose={"protection_level_m": level}, lasting_level_m=0.5)
        assert brief[:2] == (LIMIT, "localization"), level
        assert (brief[2] == 0.0) == (level > 0.5), level
    for level in around(0.3, 0.01):
        expected = LIMIT if level > 0.3 else NONE
        assert ask("localization", config, pose={"protection_level_m": level})[0] is expected, level
    for age in around(120.0, 0.1):
        expected = (STOP, "localization.gnss_age") if age > 120.0 else (NONE, "localization.gnss_lost")
        assert ask("localization", config, pose={"gnss_age_s": age})[:2] == expected, age
    for age in around(1.0, 0.02):
        expected = "localization.gnss_lost" if age > 1.0 else "localization"
        assert ask("localization", config, pose={"gnss_age_s": age})[1] == expected, age
    for bad in ({"is_initialized": False}, {"source": PositionSource.NONE}, {"protection_level_m": math.nan},
                {"gnss_age_s": math.nan}, {"protection_level_m": math.inf}):  # fmt: skip
        assert ask("localization", config, pose=bad)[0] is STOP, bad
    for bad in ({"is_initialized": False}, {"source": PositionSource.NONE}):
        assert ask("localization", config, pose=bad)[1] == "localization.none"
    sensor_failures = ask("localization", config, is_under_roof=True, pose={"uwb_age_s": 9.0})
    assert sensor_failures[:2] == (STOP, "localization.uwb_lost")
    shed = {"gnss_age_s": 500.0, "source": PositionSource.UWB}
    assert ask("localization", config, pose=shed)[:2] == (NONE, "localization")
    for age, text in ((500.0, "no fix for 500.0 s"), (math.inf, "no fix yet")):
        assert RULES["localization"](situation_of(config, pose={"gnss_age_s": age})).text == text


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", ["roll", "pitch"])
@clause(rule="tilt")
def test_tilt(config: SupervisorConfig, axis: str, sign: int) -> None:
    for angle in around(15.0, 0.1):
        got = ask("tilt", config, **{f"{axis}_rad": sign * math.radians(angle - 1e-9)})
        assert got[:2] == ((STOP, f"tilt.{axis}") if angle > 15.0 + 1e-6 else (NONE, "tilt")), angle
    level = config.rules.model_copy(update={"tilt": config.rules.tilt.model_copy(update={f"{axis}_deg": 0.0})})
    assert ask("tilt", config, rule_limits=level)[0] is NONE  # at the limit itself
    broken = replace(situation_of(config).inputs.odom, T_odom_base=np.full((4, 4), np.nan))
    assert ask("tilt", config, odom=broken)[0] is STOP


@clause(rule="geofence")
def test_geofence(config: SupervisorConfig) -> None:
    assert ask("geofence", config, geofence_distance_m=None) == (LIMIT, "geofence.unknown", 0.0)
    assert ask("geofence", config, geofence_distance_m=-1.0)[:2] == (STOP, "geofence.outside")
    assert ask("geofence", config, geofence_distance_m=0.0) == (LIMIT, "geofence", 0.0)
    margin = config.limits.geofence_margin_m
    for distance in around(margin, 0.008):
        response, _, limit = ask("geofence", config, geofence_distance_m=distance)
        assert response is LIMIT
        assert (limit > 0.0) == (distance > margin), distance
    speeds = [ask("geofence", config, geofence_distance_m=distance)[2] for distance in (0.5, 1.0, 3.0, 9.0)]
    assert speeds == sorted(speeds)


def clearance(main: float, arc: float = math.inf) -> dict[str, Any]:
    return {"clearance": Clearance(main, arc, np.zeros((1, 3)))}


@clause("BD-5.2.4", "BD-5.2.5b", rule="protective_field")
def test_protective_field(config: SupervisorConfig) -> None:
    assert ask("protective_field", config, clearance=None) == (LIMIT, "protective_field.no_scan", 0.0)
    stopping = stopping_distance(2.0, config.braking.flat)
    for main in around(stopping, 0.01):
        expected = STOP if main < stopping else LIMIT
        assert ask("protective_field", config, **clearance(main))[0] is expected, main
        assert ask("protective_field", config, **clearance(math.inf, main))[0] is expected, main
    assert ask("protective_field", config, **clearance(1.0))[1] == "protective_field"
    assert ask("protective_field", config, speed_mps=0.0, **clearance(0.5)) == (LIMIT, "protective_field", 0.0)
    for main in around(2.1, 0.02):
        assert (ask("protective_field", config, speed_mps=0.0, **clearance(main))[2] > 0.0) == (main > 2.1), main
    assert (
        0.0
        < ask("protective_field", config, **clearance(20.0, 4.0))[2]
        < ask("protective_field", config, **clearance(20.0))[2]
    )


@clause("BD-5.2.4", "BD-5.2.5b", rule="tracked_obstacle")
def test_tracked_obstacle(config: SupervisorConfig) -> None:
    stopping = stopping_distance(2.0, config.braking.flat)
    for away in around(stopping, 0.01):
        expected = STOP if away < stopping else LIMIT
        assert (
            ask("tracked_obstacle", config, critical_object=CriticalObject(away, ObstacleClass.PERSON, 3))[0]
            is expected
        ), away
    assert ask("tracked_obstacle", config, critical_object=CriticalObject(1.0, ObstacleClass.PERSON, 3))[:2] == (
        STOP,
        "tracked_obstacle",
    )
    standing = ask(
        "tracked_obstacle", config, speed_mps=0.0, critical_object=CriticalObject(0.5, ObstacleClass.PERSON, 3)
    )
    assert standing == (LIMIT, "tracked_obstacle", 0.0)


@clause("BD-5.2.4", rule="standing_body")
def test_standing_body(config: SupervisorConfig) -> None:
    deer = StandingBody(1.2, 2.5, ObstacleClass.ANIMAL)
    assert ask("standing_body", config, standing_body=deer) == (LIMIT, "standing_body", 1.2)
    assert ask("standing_body", config, standing_body=deer, is_docking=True)[0] is NONE
    assert ask("standing_body", config)[0] is NONE


@clause("BD-5.2.4", rule="detection_range")
def test_detection_range(config: SupervisorConfig) -> None:
    assert ask("detection_range", config, detection_range_m=0.0) == (LIMIT, "detection_range.limit", 0.0)
    for seen_m in (0.0, 0.5, 40.0):  # by another lidar
        found = ask("detection_range", config, detection_range_m=seen_m, blind=("lidar/front",))
        assert found == (LIMIT, "lidar/front.blind", 0.0)
    assert ask("detection_range", config, detection_range_m=40.0)[2] * 3.6 == pytest.approx(29.5, abs=0.5)
    speeds = [ask("detection_range", config, detection_range_m=r)[2] for r in np.arange(0.0, 40.0, 0.5)]
    assert speeds == sorted(speeds)


@clause("BD-5.2.4", rule="sensor_loss")
def test_sensor_loss(config: SupervisorConfig) -> None:
    flat = config.braking.flat
    for kind, half_m, whole_m in (("radar", 2.5, 5.0), ("camera", 2.15, 4.3), ("ultrasonic", 1.5, 3.0)):
        sensor_failures = (SensorFailure(kind, f"{kind}.lost", "lost"),)
        speed = min(highest_speed(half_m, flat, 0.0), highest_speed(whole_m, flat, 2.1))
        assert ask("sensor_loss", config, sensor_failures=sensor_failures) == (LIMIT, f"{kind}.lost", speed), kind
        close = min(highest_speed(half_m, flat, 0.0), highest_speed(whole_m, flat, 0.1))
        assert ask("sensor_loss", config, sensor_failures=sensor_failures, allowance_m=0.1)[2] == close, kind


@clause("BD-5.2.4", rule="vegetation")
def test_vegetation(config: SupervisorConfig) -> None:
    consent = Consent(by="A. Bauer", vegetation_m=0.3)
    for given in (None, consent):
        assert ask("vegetation", config, vegetation_m=0.0, consent=given) == (NONE, "vegetation", math.inf)
    assert ask("vegetation", config, vegetation_m=0.2) == (LIMIT, "vegetation", 0.0)
    assert ask("vegetation", config, vegetation_m=0.34, consent=consent) == (NONE, "vegetation.consented", math.inf)
    assert ask("vegetation", config, vegetation_m=0.36, consent=consent) == (LIMIT, "vegetation", 0.0)


@clause(rule="implement_fold")
def test_implement_fold(config: SupervisorConfig) -> None:
    assert ask("implement_fold", config, is_foldable=True, fold=None)[:2] == (STOP, "machine.implement.silent")
    assert ask("implement_fold", config, is_foldable=True, fold=0.5) == (LIMIT, "implement_fold", 0.0)
    for changes in ({"is_foldable": False, "fold": None}, {"is_foldable": True, "fold": 1.0}):
        assert ask("implement_fold", config, **changes) == (NONE, "implement_fold", math.inf)


@clause(rule="speed_limit")
def test_speed_limit(config: SupervisorConfig) -> None:
    assert ask("speed_limit", config) == (LIMIT, "speed_limit", 8.0)
    assert ask("speed_limit", config, is_docking=True) == (LIMIT, "speed_limit.docking", 0.5)


@clause(rule="wall_clearance")
def test_wall_clearance(config: SupervisorConfig) -> None:
    assert ask("wall_clearance", config, wall_distance_m=0.0) == (LIMIT, "wall_clearance", 0.0)
    assert ask("wall_clearance", config, wall_distance_m=2.0)[2] == highest_speed(2.0, config.braking.flat, 0.0)


def test_most_restrictive_rule(config: SupervisorConfig) -> None:
    near = {**clearance(5.0), "critical_object": CriticalObject(4.0, ObstacleClass.PERSON, 1)}
    slow = evaluate_rules(situation_of(config, **near), RULES)
    assert slow.binding.code == "tracked_obstacle"
    assert slow.clearance_m == 4.0
    assert slow.binding_is_obstacle
    assert slow.is_ready
    assert not slow.is_fault
    hand = evaluate_rules(situation_of(config, driver_override_s=2.0, timed_out_topics=("odom",), **near), RULES)
    assert (hand.binding.code, hand.is_takeover, hand.is_fault, hand.is_ready) == ("driver_override", True, True, False)
    worst = evaluate_rules(situation_of(config, brake_ineffective_s=2.0, timed_out_topics=("odom",)), RULES)
    assert (worst.binding.code, worst.is_emergency) == ("brake.weak", True)
    for main, arc in ((3.0, 5.0), (5.0, 3.0)):
        either = evaluate_rules(situation_of(config, speed_mps=0.0, **near | clearance(main, arc)), RULES)
        assert either.clearance_m == 3.0
    inside = evaluate_rules(situation_of(config, geofence_distance_m=None, **clearance(1.0)), RULES)  # both limit to 0
    assert inside.binding.code == "protective_field"
    blind = evaluate_rules(situation_of(config, clearance=None, geofence_distance_m=None), RULES)
    assert (blind.clearance_m, blind.is_ready) == (math.inf, False)


def test_allowance(config: SupervisorConfig) -> None:
    assert allowance_m(config.field, 0.02, 0.01) == pytest.approx(3.0 * 0.02 + 0.01 + 2.0)


def test_rules_left_out(config: SupervisorConfig) -> None:
    others = {name: rule for name, rule in RULES.items() if Effect.OBSTACLE not in rule.effect}
    near = {**clearance(1.0), "critical_object": CriticalObject(1.0, ObstacleClass.PERSON, 1)}
    remaining = evaluate_rules(situation_of(config, **near), others)
    assert remaining.binding.code == "speed_limit"
    none = evaluate_rules(situation_of(config, **near), {})
    assert (none.results, none.allowed_mps, none.binding_is_obstacle) == ((), math.inf, False)
