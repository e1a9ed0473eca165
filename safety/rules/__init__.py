"""The rules, one file each: `(situation) -> RuleResult`; the most restrictive wins, of equals the first here."""

from collections.abc import Callable

from messages.command import RuleResult
from safety.rules import (
    brake,
    clock,
    emergency,
    fence,
    fold,
    hand,
    localization,
    obstacle,
    proven,
    reported,
    sensing,
    silence,
    speed,
    steering,
    supply,
    survey,
    tilt,
    tracked,
)
from safety.situation import Situation

Rule = Callable[[Situation], RuleResult]

RULES: dict[str, Rule] = {
    "emergency": emergency.judge,
    "hand": hand.judge,
    "clock": clock.judge,
    "reported": reported.judge,
    "silence": silence.judge,
    "supply": supply.judge,
    "steering": steering.judge,
    "brake": brake.judge,
    "localization": localization.judge,
    "tilt": tilt.judge,
    "fence": fence.judge,
    "fold": fold.judge,
    "obstacle": obstacle.judge,
    "tracked": tracked.judge,
    "proven": proven.judge,
    "sensing": sensing.judge,
    "survey": survey.judge,
    "speed": speed.judge,
}
BLOCKING_RULES = frozenset({"obstacle", "tracked", "proven", "sensing"})  # to stand for one is an obstacle stop
OBSTACLE_RULES = frozenset({"obstacle", "tracked"})  # what an ablation switches off
