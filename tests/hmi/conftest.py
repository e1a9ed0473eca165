"""The log that the tests of a folder play, the browser, and how many tests were skipped for want of one."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hmi.browser import Browser, chromium
from tests.replay.simulated_crossing import crossing_of_session


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return crossing_of_session(tmp_path_factory)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found
