"""A folder in which a test judges generated drives."""

from pathlib import Path

import pytest

import runtime.replay.evaluate
import runtime.replay.prepare
from runtime.stack import load_stack
from tests.validation.attacks.recorded import Bench


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


STACK = load_stack()


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures, which are drawn after the verdict, and the configuration of the stack read once: 0.4 s of a test."""
    monkeypatch.setattr(runtime.replay.evaluate, "_figures", lambda *_: {})
    monkeypatch.setattr(runtime.replay.prepare, "load_stack", lambda: STACK)
