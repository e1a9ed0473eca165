"""A rule: one file of this folder that defines `RULE`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Flag, auto
from functools import cached_property
from typing import Any

from configs.strict import Config
from messages.command import RuleResult
from safety.rules.situation import Situation


class Effect(Flag):
    """What the results of a rule lead to, besides the speed limit and the braking they ask for."""

    LIMIT = auto()  # nothing else
    OBSTACLE = auto()  # a stop is an obstacle stop: driving resumes automatically when the path is clear
    DETECTION = auto()  # the same for the sensors that detect obstacles
    FAULT = auto()  # a stop prevents a start, and while engaged waits for a person
    TAKEOVER = auto()  # a stop leads to manual mode
    BLOCKS_START = auto()  # a limit too prevents a start
    ADVISORY = auto()  # a limit too is reported to the operator
    OBSTACLE_STOP = OBSTACLE | DETECTION


@dataclass(frozen=True)
class Rule:
    """A rule, named after its file.

    `order` ranks the rules: of equally restrictive results the first counts. `clauses` are ids of
    docs/requirements.md. `evaluate(situation)` or, with `limits`, `evaluate(situation, limits)` gives the result;
    `limits` is the class of section `rules.<name>` of the configuration, `config_keys` are the other keys used.
    `texts_zh` has the Chinese text of each code, "*" in a code standing for a name that "{}" in the text repeats; the
    English text comes with the result. `effects` has the codes whose effect differs from `effect`.
    """

    order: int
    effect: Effect
    evaluate: Callable[..., RuleResult]
    texts_zh: Mapping[str, str]
    clauses: tuple[str, ...] = ()
    limits: type[Config] | None = None
    config_keys: tuple[str, ...] = ()
    effects: Mapping[str, Effect] = field(default_factory=dict)

    @cached_property
    def name(self) -> str:
        """The name of the file."""
        return self.evaluate.__module__.rpartition(".")[2]

    @cached_property
    def is_obstacle_rule(self) -> bool:
        """Whether its stops are obstacle stops."""
        return bool(self.effect & Effect.OBSTACLE_STOP)

    def effect_of(self, code: str) -> Effect:
        """The effect of a result with this code."""
        return self.effects.get(code, self.effect)

    def __call__(self, situation: Situation) -> RuleResult:
        """The result in a situation."""
        if self.limits is None:
            return self.evaluate(situation)
        limits: Any = getattr(situation.rule_limits, self.name)
        return self.evaluate(situation, limits)
