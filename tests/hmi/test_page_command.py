"""`headland page` with wrong arguments: one line that names the value, exit code 2, nothing written."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.recordings import ROOT


def page(folder: Path, *arguments: str, given: str = "") -> tuple[int, str]:
    """Exit code and standard error of the command in a folder."""
    command = [sys.executable, "-m", "runtime", "page", "--state", str(folder / "state"), *arguments]
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, input=given, text=True, env=env, cwd=folder, capture_output=True, timeout=120)
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--port", "70000"), "70000"),
        (("--stop-port", "-1"), "-1"),
        (("--add-user", "anna"), "anna"),
        (("--add-user", "anna:admin"), "anna:admin"),
        (("--add-user", "a b:view"), "a b:view"),
        (("--replay", "none.mcap"), "none.mcap"),
        (("--connect", "none"), "none"),
        (("--connect", "."), "not the run folder"),
        (("--mission", "nowhere"), "nowhere"),
        (("--key", str(ROOT / "LICENSE")), "--connect"),
        (("--replay", str(ROOT / "LICENSE")), "LICENSE"),
        (("--foxglove", "65536"), "65536"),
        (("--foxglove", "8765", "--listen", "192.168.1.5"), "--foxglove 8765: has no log-in"),
    ],
)
def test_wrong_argument_is_one_line(tmp_path: Path, arguments: tuple[str, ...], named: str) -> None:
    code, text = page(tmp_path, *arguments)
    assert code == 2
    assert named in text
    assert len(text.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_short_password_is_refused(tmp_path: Path) -> None:
    code, text = page(tmp_path, "--add-user", "anna:view", given="short\n")
    assert code == 2
    assert "fewer than 8 characters" in text
    assert list(tmp_path.iterdir()) == []


def test_taken_port_is_named(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = str(taken.getsockname()[1])
        for option in ("--port", "--stop-port", "--foxglove"):
            ports = {"--port": "0", "--stop-port": "0"} | {option: number}
            code, text = page(tmp_path, *(word for pair in ports.items() for word in pair))
            assert code == 2
            assert f"{option} {number}: cannot be opened" in text
            assert len(text.strip().splitlines()) == 1
