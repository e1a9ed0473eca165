"""Each rule is one file: found, ordered, with its codes, texts, limits and configuration keys."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from messages.faults import Response
from safety.output.alarms import text_zh
from safety.rules import RULES
from safety.rules.results import limit
from safety.rules.rule import Effect, Rule
from safety.supervisor import texts_of
from tests.safety.safety_world import ROOT

RESULTS = {"emergency", "stop", "limit", "advisory"}
ORDER = (
    "emergency_stop", "driver_override", "clock_step", "reported_fault", "message_timeout", "lidar_agreement",
    "supply_voltage",
    "steering", "drive", "brake", "overspeed", "localization", "tilt", "geofence", "implement_fold",
    "protective_field", "tracked_obstacle", "standing_body",
    "detection_range", "vegetation", "sensor_loss", "wall_clearance", "speed_limit",
)  # fmt: skip

ADDED = """
from safety.rules.results import stop
from safety.rules.rule import Effect, Rule

RULE = Rule(
    order=25,
    effect=Effect.FAULT,
    evaluate=lambda situation: stop("engine_hood", "engine hood open"),
    texts_zh={"engine_hood": "发动机罩未关"},
)
"""
SCRIPT = """
import sys
from tests.safety.conftest import config, geofence, implement, sparse, vehicle
from safety.rules import RULES
from safety.supervisor import Supervisor
from tests.safety.safety_world import START_NS, SyntheticInbox

def value(fixture, *args):
    return getattr(fixture, "__wrapped__", getattr(fixture, "_fixture_function", None))(*args)

machine = value(sparse, value(vehicle))
supervisor = Supervisor(machine, value(implement), value(config), value(geofence), ())
outputs = dict(supervisor.step(START_NS, SyntheticInbox()))
names = list(RULES)
print(names[names.index("driver_override") + 1], outputs["safe_command"].reason, "engine_hood" in
      [rule.code for rule in outputs["supervisor"].rules], supervisor._alarms._texts["engine_hood"])
"""


def called_codes(rule: Rule) -> Iterator[str]:
    """Every code that a rule's file gives to a result; "*" stands for a name put into it."""
    module = sys.modules[rule.evaluate.__module__]
    for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in RESULTS:
            yield code_of(node.args[0], module)


def code_of(node: ast.expr, module: Any) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.Name):
        return str(getattr(module, node.id))
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "x/y" for part in node.values)
    return "other.code"  # of a reported fault, or of a sensor's failure


def test_order_of_the_rules() -> None:
    assert tuple(RULES) == ORDER
    orders = [rule.order for rule in RULES.values()]
    assert orders == sorted(set(orders))


@pytest.mark.parametrize("name", RULES)
def test_codes_have_chinese_texts(name: str) -> None:
    own = set(called_codes(RULES[name]))
    if name == "sensor_loss":
        own = own - {"other.code"} | {"x/y.silent", "x/y.frozen", "x/y.blind"}
    if name == "lidar_agreement":
        own = own - {"other.code"} | {"x/y.contradicted", "x/y.foreign"}
    for code in own:
        text = text_zh(RULES[name].texts_zh, code)
        assert any("一" <= letter <= "鿿" for letter in text), (code, text)
        assert text_zh(texts_of(RULES), code) == text
    assert own


@pytest.mark.parametrize("name", RULES)
def test_rule_is_named_after_its_file(name: str) -> None:
    module = sys.modules[f"safety.rules.{name}"]
    assert module.RULE is RULES[name]
    assert RULES[name].effects.keys() <= set(called_codes(RULES[name]))


@pytest.mark.parametrize("name", RULES)
def test_configuration_keys_exist(name: str, config: Any) -> None:
    for key in RULES[name].config_keys:
        value = config
        for part in key.split("."):
            value = getattr(value, part)
    assert hasattr(config.rules, name) == (RULES[name].limits is not None)


def test_effect_of_a_code() -> None:
    rule = Rule(
        order=1, effect=Effect.FAULT, evaluate=lambda situation: limit("a", 1.0, "text"), texts_zh={},
        effects={"a.b": Effect.BLOCKS_START},
    )  # fmt: skip
    assert (rule.effect_of("a"), rule.effect_of("a.b")) == (Effect.FAULT, Effect.BLOCKS_START)
    situation: Any = None
    assert rule(situation).response is Response.LIMIT


def test_rule_added_by_one_file(tmp_path: Path) -> None:
    for folder in ("configs", "geometry", "messages", "safety"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "tests/safety", tmp_path / "tests/safety", ignore=shutil.ignore_patterns("test_*"))
    (tmp_path / "safety/rules/engine_hood.py").write_text(ADDED)
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUTF8": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["engine_hood", "engine_hood", "True", "发动机罩未关"], done.stderr
