"""Kill -9 of each writing verb at three random moments: no file of the user is lost, and the same command continues."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.kills import COMPLETE_EVERY, VERBS, make_inputs, one_trial


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kills")
    make_inputs(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_killed_command_continues(top: Path, verb: str) -> None:
    moments = np.random.default_rng([1, *verb.encode()]).uniform(size=3)
    for trial, moment in enumerate(moments, COMPLETE_EVERY - 3):  # the last one runs to its end afterwards
        assert one_trial(verb, top, float(moment), trial, is_full_disk=False)["failure"] == ""
