"""Attacks from another process in a network namespace that has only a loopback interface, three of each kind."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def has_namespaces() -> bool:
    command = ["unshare", "-rn", "ip", "link", "set", "lo", "up"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not has_namespaces(), reason="network namespaces are not permitted here")
def test_attacks_are_named_and_stop_the_machine(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "benchmarks.bus_attacks", "--out", str(tmp_path), "--trials"]
    for trials in ("1", "3"):  # the second continues
        done = subprocess.run([*words, trials], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert len(rows) == len({(row["attack"], row["seed"]) for row in rows}) == 18
    assert all(row["detected_ms"] <= 200 for row in rows)
    assert all(row["travel_m"] <= row["s_m"] for row in rows if "s_m" in row)
    assert not any(row.get("accepted") for row in rows)
