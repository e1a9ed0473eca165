"""A silent source is never all clear: too old by the topic table, or the same scan again and again."""

from messages.command import MachineState, RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation

LEADING = frozenset({"control_command", "mission"})


def evaluate(situation: Situation) -> RuleResult:
    """Stop on the first silent source; while the machine stands, those that lead it need not speak.

    Control then has nothing to say yet, and the mission may take its time to plan a way round.
    """
    for topic in situation.timed_out_topics:
        if topic in LEADING and not situation.is_moving:
            return limit(f"{topic}.silent", 0.0, f"no message on {topic}")
        return stop(f"{topic}.silent", f"no message on {topic} within its greatest age")
    if situation.frozen:
        return stop(f"{situation.frozen[0]}.frozen", f"{situation.frozen[0]} repeats the same scan")
    if situation.odom is None or situation.map_pose is None:
        return stop("odom.invalid" if situation.odom is None else "map_pose.invalid", "a pose that is no number")
    group = silent_group(situation)
    return (
        stop(f"machine.{group}.silent", f"the machine's {group} frames are missing")
        if group
        else no_objection("message_timeout")
    )


def silent_group(situation: Situation) -> str:
    """The first group of the machine's state that is too old, or ""."""
    machine = situation.machine
    if machine is None:
        return ""
    oldest_ns = machine.stamp_ns - round(situation.config.limits.max_group_age_s * 1e9)
    return next((name for name, stamp_ns in groups(machine) if stamp_ns < oldest_ns), "")


def groups(machine: MachineState) -> tuple[tuple[str, int], ...]:
    """The groups that driving needs, with the time of their last good frame."""
    return (
        ("heartbeat", machine.heartbeat_stamp_ns),
        ("motion", machine.motion_stamp_ns),
        ("steering", machine.steering_stamp_ns),
        ("cab", machine.cab_stamp_ns),
    )
