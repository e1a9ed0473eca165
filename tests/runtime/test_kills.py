"""Kill -9 of each writing verb as it starts and as it writes: no file of the user is lost, the same command continues.

The benchmark `kills` takes random moments of the whole run; test_hazard_list.py kills a campaign.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.kills import VERBS, kill, make_inputs
from tests.runtime.written_file import after_file

MOST_S = 1.0  # after the file


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kills")
    make_inputs(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb != "campaign"])
def test_killed_command_continues(top: Path, verb: str) -> None:
    early_s, late_s = np.random.default_rng([1, *verb.encode()]).uniform(high=MOST_S, size=2)
    folder = top / verb
    assert kill(verb, top, folder, after_file("*", early_s), is_run_again=False) == ""
    assert kill(verb, top, folder, after_file(VERBS[verb].main, late_s), is_run_again=True) == ""
