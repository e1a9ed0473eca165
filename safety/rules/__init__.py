"""The rules, one file each, found by their `RULE`; the most restrictive result wins, of equals the first by `order`."""

from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from pydantic import create_model

from configs.strict import Config
from safety.rules.rule import Rule


def find_rules() -> dict[str, Rule]:
    """Every rule of this folder by name, in order."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    rules: list[Rule] = [module.RULE for module in modules if hasattr(module, "RULE")]
    return {rule.name: rule for rule in sorted(rules, key=lambda rule: (rule.order, rule.name))}


RULES = find_rules()

if TYPE_CHECKING:
    RuleLimits = Config
else:
    RuleLimits = create_model(
        "RuleLimits",
        __base__=Config,
        __doc__="Section `rules`: the limits of each rule, by its name.",
        **{rule.name: (rule.limits, ...) for rule in RULES.values() if rule.limits is not None},
    )
