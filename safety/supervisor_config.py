"""Section `safety` of the stack configuration."""

from safety.config import SafetyConfig
from safety.rules import RuleLimits


class SupervisorConfig(SafetyConfig):
    """The values of the whole supervisor: those that its parts share, and the limits of each rule."""

    rules: RuleLimits
