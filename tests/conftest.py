"""Counts the tests that were skipped because recordings are absent."""

import pytest

from tests.recordings import DATA, REASON


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Reports how many tests were skipped for want of recordings, and where they are looked for."""
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(REASON in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} skipped without recordings in {DATA} (HEADLAND_DATA names another folder)"
        )
