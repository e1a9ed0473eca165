"""Table of sensor kinds: complete registries, and the cost of a new kind and of a new lidar."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from configs.sensor_kinds import SENSOR_KINDS
from configs.site import Site
from configs.strict import CONFIGS, find, load, parse
from configs.vehicle import ImplementFile, Vehicle
from messages.errors import ConfigError
from messages.topics import TOPICS
from runtime.perception_nodes import perception_nodes
from runtime.stack import load_stack
from safety.inputs import SupervisorInputs
from simulation.scenario import Scenario
from simulation.sensors.sensor import SensorContext
from simulation.world import make_sensors

ROOT = Path(__file__).resolve().parent.parent
# file of each kind; with a fact: of the kinds for which it holds
FILES = {
    "perception/{}/nodes.py": None,
    "simulation/sensors/{}.py": None,
    "validation/sensors/{}.py": None,
    "safety/sources/{}.py": "is_raw_source",
}
ROW = "    gnss: dict[str, Gnss]"
NEW_ROW = "    thermal: Annotated[dict[str, Camera], SensorKind()] = Field(default_factory=dict)\n"
NEW_FILES = {
    "perception/thermal/nodes.py": """
from messages.node import Latest, Node, On


class ThermalObstacles(Node):
    def __init__(self, name):
        self.name, self.runs = f"thermal_{name}", On((f"thermal/{name}",))
        self.reads = {f"thermal/{name}": Latest()}
        self.writes = (f"obstacles/{self.name}", f"health/{self.name}")

    def step(self, now_ns, inbox):
        return ()


def make_nodes(vehicle, implement, config):
    return [ThermalObstacles(name) for name in vehicle.sensors.thermal], []
""",
    "simulation/sensors/thermal.py": """
class ThermalModel:
    def __init__(self, name, camera):
        self.topic, self.period_ns, self.latency_ns = f"thermal/{name}", round(1e9 / camera.rate_hz), 0

    def sample(self, state):
        return None


def make_model(name, camera, config, context):
    return ThermalModel(name, camera)
""",
    "validation/sensors/thermal.py": """
def field_of_view(camera):
    return 0.5, 40.0


def remove_object(image, box, camera):
    return image
""",
}
NEW_VALUES = {  # file: line before, new line
    "messages/topics.py": ('    "radar": TopicSpec', '    "thermal": TopicSpec(sensors.CameraImage, 0.1, 0.4),\n'),
    "configs/stack/perception.yaml": (
        "    lidar: {evidence",
        "    thermal: {evidence: 10.0, keep_unconfirmed_s: 0.4, keep_s: 1.0}\n",
    ),
    "configs/stack/safety.yaml": ("      radar: 5.0", "      thermal: 4.0\n"),
    "configs/stack/executor.yaml": ("  radar: 4", "  thermal: 20\n"),
}
FOLDERS = ("configs", "messages", "geometry", "perception", "localization", "planning", "control", "safety", "datasets",
           "simulation", "interfaces", "validation", "runtime")  # fmt: skip


def missing() -> list[str]:
    """Files, topics and values that a kind of the table lacks."""
    found = [
        path.format(kind)
        for path, fact in FILES.items()
        for kind, facts in SENSOR_KINDS.items()
        if (fact is None or getattr(facts, fact)) and not (ROOT / path.format(kind)).is_file()
    ]
    found += [f"messages/topics.py: {kind}" for kind in SENSOR_KINDS if kind not in TOPICS]
    raw = (ROOT / "safety/obstacle_sources.py").read_text()  # the raw protective field combines its kinds by hand
    raw_kinds = [kind for kind, facts in SENSOR_KINDS.items() if facts.is_raw_source]
    found += [f"safety/obstacle_sources.py: {kind}" for kind in raw_kinds if f"sensors.{kind}.items()" not in raw]
    try:
        load_stack()
    except ConfigError as error:
        found.append(str(error))
    return found


def topics_of(vehicle: Vehicle) -> set[str]:
    """Topics of the simulated sensors, of perception, and of the supervisor's inputs."""
    site, scenario = load(Site, find("sites", "demo")), load(Scenario, find("scenarios", "empty"))
    implement, stack = load(ImplementFile, find("implements", "harrow_6m")).implement, load_stack()
    context = SensorContext(site, vehicle, implement, scenario, 1)
    nodes = perception_nodes(vehicle, implement, stack.perception)
    assert all(stack.executor.latency_ns(node.name) > 0 for node in nodes)
    simulated = {sensor.topic for sensor in make_sensors(context, stack.simulation)}
    perceived = {topic for node in nodes for topic in (*node.reads, *node.writes)}
    supervised = SupervisorInputs(vehicle.sensors, frozenset(), stack.safety).reads
    return simulated & perceived | {f"supervisor: {topic}" for topic in supervised}


def machine_with(kind: str, name: str, like: str) -> Vehicle:
    """Machine file with one entry more, the copy of a sensor of the kind `like`."""
    values = yaml.safe_load((CONFIGS / "machines" / "tractor_e.yaml").read_text())
    values["sensors"].setdefault(kind, {})[name] = values["sensors"][like]["front"]
    return parse(Vehicle, values, "machine")


def test_registries_are_complete() -> None:
    from perception.sensor_registry import NODES
    from simulation.sensor_registry import MODELS
    from validation.sensor_registry import FIELDS_OF_VIEW, REMOVALS

    assert missing() == []
    for found in (NODES, MODELS, FIELDS_OF_VIEW, REMOVALS):
        assert list(found) == list(SENSOR_KINDS)


def test_new_lidar_is_one_entry_in_the_machine_file() -> None:
    topics = topics_of(machine_with("lidar", "left", "lidar"))
    assert {"lidar/left", "supervisor: lidar/left", "supervisor: health/lidar_left"} <= topics


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Copy of the packages and of this test."""
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "tests").mkdir()
    for name in ("tests/__init__.py", "tests/test_sensor_kinds.py", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def run(tree: Path, expression: str) -> str:
    """Value of an expression over this module in a process in the copied tree."""
    command = f"from tests.test_sensor_kinds import *; print({expression})"
    # the copy alone is on the path, as ./headland sets one; no kernel is cached for the copy
    env = os.environ | {"PYTHONPATH": str(tree), "NUMBA_DISABLE_JIT": "1"}
    words = [sys.executable, "-c", command]
    done = subprocess.run(words, cwd=tree, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_new_kind_is_a_row_and_a_file_per_folder(tree: Path) -> None:
    table = (tree / "configs/vehicle.py").read_text()
    (tree / "configs/vehicle.py").write_text(table.replace(ROW, NEW_ROW + ROW))
    found = run(tree, "*missing(), sep='\\n'")
    for name in (*NEW_FILES, "messages/topics.py: thermal", "sensor_loss.without_m", "tracker.kinds"):
        assert name in found
    for name, text in NEW_FILES.items():
        (tree / name).parent.mkdir(exist_ok=True)
        (tree / name).write_text(text)
    for name, (before, line) in NEW_VALUES.items():
        text = (tree / name).read_text()
        assert text.count(before) == 1, name
        (tree / name).write_text(text.replace(before, line + before))
    assert run(tree, "missing()") == "[]\n"
    topics = run(tree, "topics_of(machine_with('thermal', 'front', 'camera'))")
    for topic in ("thermal/front", "supervisor: obstacles/thermal_front", "supervisor: health/thermal_front"):
        assert f"'{topic}'" in topics
