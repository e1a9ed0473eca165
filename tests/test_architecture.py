"""Import rules between folders, and SafeCommand built in safety/ only; injected violations verify the check."""

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
    "calibration": BASE,
    "hmi": BASE | {"calibration"},
}
FOLDERS = {*MAY_IMPORT, "runtime"}
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
    "importlib",
    "pkgutil",
    "zlib",
}


def imported(source: str) -> set[str]:
    """Top-level packages that a file imports."""
    nodes = list(ast.walk(ast.parse(source)))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    return {name.partition(".")[0] for name in names}


def violations(folder: str, source: str) -> set[str]:
    """Imports of a file in this folder that the rules forbid."""
    names = imported(source)
    foreign = (names & FOLDERS) - MAY_IMPORT.get(folder, FOLDERS) - {folder}
    return foreign | (names - SAFETY_LIBRARIES - BASE - {"safety"} if folder == "safety" else set())


def builds_safe_command(source: str) -> bool:
    calls = (node.func for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    return any(getattr(call, "id", getattr(call, "attr", "")) == "SafeCommand" for call in calls)


def files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("folder", sorted(MAY_IMPORT))
def test_import_rules(folder: str) -> None:
    found = {
        f"{path.relative_to(ROOT)}: {name}" for path in files(folder) for name in violations(folder, path.read_text())
    }
    assert not found


def test_safe_command_in_safety_only() -> None:
    folders = [folder for folder in FOLDERS if folder != "safety"]
    assert not [path for folder in folders for path in files(folder) if builds_safe_command(path.read_text())]
    assert any(builds_safe_command(path.read_text()) for path in files("safety"))


def test_ground_truth_in_validation_and_viewers_only() -> None:
    folders = [
        folder for folder in FOLDERS if folder not in ("simulation", "validation", "datasets", "runtime", "messages")
    ]
    assert not [path for folder in folders for path in files(folder) if "messages.truth" in path.read_text()]


def test_runtime_is_not_imported() -> None:
    assert not [path for folder in MAY_IMPORT for path in files(folder) if "runtime" in imported(path.read_text())]


def test_web_server_in_hmi_only() -> None:
    """The state of the page and what is shown of it need no browser and no server."""
    folders = [folder for folder in FOLDERS if folder != "hmi"]
    assert not [path for folder in folders for path in files(folder) if "nicegui" in imported(path.read_text())]
    users = {path.relative_to(ROOT / "hmi").as_posix() for path in files("hmi") if uses_server(path.read_text())}
    names = ("drive", "plan", "setup", "calibration", "diagnosis", "statistics")
    views = {"view.py", *(f"{name}_page.py" for name in names)}
    assert users == views | {"app.py", "files.py", "log_in.py", "replay_bar.py", "seat_bar.py", "security.py"}


def uses_server(source: str) -> bool:
    return not imported(source).isdisjoint({"nicegui", "fastapi", "starlette", "uvicorn"})


def test_injected_violations() -> None:
    assert violations("hmi", "from datasets.reader import x\nfrom nicegui import ui") == {"datasets"}
    assert uses_server("from nicegui import ui")
    assert violations("planning", "from control.speed import x\nimport numpy") == {"control"}
    assert violations("safety", "import shapely\nimport numpy") == {"shapely"}
    assert builds_safe_command("from messages import command\ncommand.SafeCommand(1)")
