"""Message time-out: a topic, a scan or a group of the machine's state is too old, repeated or not finite."""

from messages.command import MachineState, RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "message_timeout"
GUIDING = frozenset({"control_command", "mission"})


def evaluate(situation: Situation) -> RuleResult:
    """Stop on the first topic that timed out; at standstill the topics that guide the machine only limit the speed.

    Control has no command before a path exists, and the mission node may take its time to plan a detour.
    """
    for topic in situation.timed_out_topics:
        if topic in GUIDING and not situation.is_moving:
            return limit(f"{topic}.silent", 0.0, f"no message on {topic}")
        return stop(f"{topic}.silent", f"no message on {topic} within its maximum age")
    if situation.frozen:
        return stop(f"{situation.frozen[0]}.frozen", f"{situation.frozen[0]} repeats the same scan")
    if situation.inputs.odom is None:
        return stop("odom.invalid", "odometry is not finite")
    if situation.inputs.map_pose is None:
        return stop("map_pose.invalid", "map pose is not finite")
    group = timed_out_group(situation)
    if group:
        return stop(f"machine.{group}.silent", f"the machine's {group} frames are missing")
    return no_objection(CODE)


def timed_out_group(situation: Situation) -> str:
    """The first group of the machine's state that is too old, or ""."""
    machine = situation.machine
    if machine is None:
        return ""
    oldest_ns = machine.stamp_ns - round(situation.config.limits.max_group_age_s * 1e9)
    return next((name for name, stamp_ns in groups(machine) if stamp_ns < oldest_ns), "")


def groups(machine: MachineState) -> tuple[tuple[str, int], ...]:
    """The groups that driving needs, with the time of their last valid frame."""
    return (
        ("heartbeat", machine.heartbeat_stamp_ns),
        ("motion", machine.motion_stamp_ns),
        ("steering", machine.steering_stamp_ns),
        ("cab", machine.cab_stamp_ns),
    )


RULE = Rule(
    order=50,
    clauses=("BD-5.5.1a", "BD-5.5.2d"),
    effect=Effect.FAULT,
    evaluate=evaluate,
    config_keys=("limits.max_group_age_s",),
    texts_zh={
        "control_command.silent": "控制器无消息",
        "mission.silent": "任务管理无消息",
        "odom.invalid": "里程计数据无效",
        "map_pose.invalid": "地图位姿数据无效",
        "*.silent": "{} 无消息",
        "*.frozen": "{} 数据重复不变",
    },
)
