"""Who may import whom, and who alone builds safe commands; a planted violation shows that the check can fail."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BASE = {"messages", "geometry", "configs"}
MAY_IMPORT: dict[str, set[str]] = {
    "messages": {"geometry"},
    "geometry": set(),
    "configs": {"geometry", "messages"},
    "validation": BASE | {"datasets"},
    **dict.fromkeys(("perception", "localization", "planning", "control", "safety", "datasets", "simulation"), BASE),
    "interfaces": BASE,
    "hmi": BASE,
}
ROOMS = {*MAY_IMPORT, "runtime"}
SAFETY_LIBRARIES = {
    "numpy",
    "pydantic",
    "math",
    "dataclasses",
    "collections",
    "enum",
    "typing",
    "itertools",
    "functools",
}


def imported(source: str) -> set[str]:
    """First names of all that a file imports."""
    nodes = list(ast.walk(ast.parse(source)))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    return {name.partition(".")[0] for name in names}


def violations(room: str, source: str) -> set[str]:
    """What a file of this room imports and may not."""
    names = imported(source)
    foreign = (names & ROOMS) - MAY_IMPORT.get(room, ROOMS) - {room}
    return foreign | (names - SAFETY_LIBRARIES - BASE - {"safety"} if room == "safety" else set())


def builds_safe_command(source: str) -> bool:
    calls = (node.func for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    return any(getattr(call, "id", getattr(call, "attr", "")) == "SafeCommand" for call in calls)


def files(room: str) -> list[Path]:
    return sorted((ROOT / room).rglob("*.py"))


@pytest.mark.parametrize("room", sorted(MAY_IMPORT))
def test_rooms_meet_through_messages_alone(room: str) -> None:
    found = {f"{path.relative_to(ROOT)}: {name}" for path in files(room) for name in violations(room, path.read_text())}
    assert not found


def test_only_safety_builds_safe_commands() -> None:
    rooms = [room for room in ROOMS if room != "safety"]
    assert not [path for room in rooms for path in files(room) if builds_safe_command(path.read_text())]
    assert any(builds_safe_command(path.read_text()) for path in files("safety"))


def test_truth_is_read_by_validation_and_viewers_alone() -> None:
    rooms = [room for room in ROOMS if room not in ("simulation", "validation", "datasets", "runtime", "messages")]
    assert not [path for room in rooms for path in files(room) if "messages.truth" in path.read_text()]


def test_nobody_imports_the_runtime() -> None:
    assert not [path for room in MAY_IMPORT for path in files(room) if "runtime" in imported(path.read_text())]


def test_a_planted_violation_is_found() -> None:
    assert violations("planning", "from control.speed import x\nimport numpy") == {"control"}
    assert violations("safety", "import shapely\nimport numpy") == {"shapely"}
    assert builds_safe_command("from messages import command\ncommand.SafeCommand(1)")
