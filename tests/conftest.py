"""Counts the tests that were skipped because recordings are absent."""

import gc

import pytest

import runtime  # noqa: F401  sets the thresholds of the garbage collection
from tests.recordings import DATA, REASON


def pytest_collection_finish() -> None:
    """Leaves what the imports made out of the garbage collection."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Reports how many tests were skipped for want of recordings, and where they are looked for."""
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(REASON in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} skipped without recordings in {DATA} (HEADLAND_DATA names another folder)"
        )
