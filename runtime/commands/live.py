"""`headland live`: checks the arguments, then runs the stack in real time."""

import argparse

from messages.errors import HeadlandError
from runtime.commands.checks import check_drive
from runtime.interruption import Interruption
from runtime.live.can_bus import named_bus
from runtime.live.config import ROLES
from runtime.run_folder import RunFolder, command_of

SIGNALS = ("KILL", "STOP")
ProcessKill = tuple[str, str, float]  # process, signal, seconds after the start


def main(arguments: argparse.Namespace) -> int:
    """Drives; 0 if the mission ended without a fault, or the machine stopped in time after the kill."""
    check_drive(arguments)
    kill, bus = parse_kill(arguments.kill), named_bus(arguments.bus)
    with RunFolder("live", arguments.out, command_of(arguments)) as folder, Interruption() as interruption:
        # only now: these imports take seconds, and a wrong argument is reported at once
        from runtime.live.command import run_live

        code = run_live(arguments, folder, kill, interruption, bus)
    return interruption.exit_code or code


def parse_kill(text: str | None) -> ProcessKill | None:
    """Value of `--kill`, PROCESS:SIGNAL:SECONDS such as perception:KILL:20; raises HeadlandError."""
    if text is None:
        return None
    parts = text.split(":")
    if len(parts) != 3 or parts[0] not in ROLES or parts[1] not in SIGNALS:
        raise HeadlandError(f"--kill {text}: PROCESS:SIGNAL:SECONDS with {', '.join(ROLES)} and KILL or STOP")
    try:
        seconds = float(parts[2])
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds <= 1e6:
        raise HeadlandError(f"--kill {text}: {parts[2]!r} is not a number of seconds")
    return parts[0], parts[1], seconds
