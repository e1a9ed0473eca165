"""Rows of a benchmark that continues: one JSON object per line of a file, each written when its trial has ended."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

R = TypeVar("R")


def rows_of(file: Path, row: type[R]) -> list[R]:
    """Rows, of a dataclass, of earlier calls; values that it has not any more are left out."""
    if not file.is_file():
        return []
    names = {f.name for f in fields(row)}  # type: ignore[arg-type]
    lines = file.read_text(encoding="utf-8").splitlines()
    return [row(**{k: v for k, v in json.loads(line).items() if k in names}) for line in lines]


def append_row(file: Path, row: Any) -> None:
    """Adds a row, a dataclass."""
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(asdict(row)) + "\n")
