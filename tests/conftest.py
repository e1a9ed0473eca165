"""Order of the tests, garbage collection, and the number of tests skipped for want of recordings or a browser."""

import gc

import pytest

import runtime  # noqa: F401  sets the thresholds of the garbage collection
from tests.hmi.browser import REASON as NO_BROWSER
from tests.recordings import DATA, REASON

DRIVES = {"attacks", "hmi", "replay", "runtime", "scenarios"}  # folders whose tests drive or replay


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules with slow tests come first: a core takes the next module, and at the end none waits for a slow one."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path not in slow, DRIVES.isdisjoint(item.path.parts)))


def pytest_collection_finish() -> None:
    """Leaves what the imports made out of the garbage collection."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Reports how many tests were skipped for want of recordings or a browser, and what provides them."""
    skipped = terminalreporter.stats.get("skipped", [])
    if count := sum(NO_BROWSER in str(report.longrepr) for report in skipped):
        terminalreporter.write_line(f"{count} skipped without a browser (`make browser` installs one)")
    count = sum(REASON in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} skipped without recordings in {DATA} (HEADLAND_DATA names another folder)"
        )
