"""`headland page`: the operator's page with the demo simulation, for a running drive, or for a log."""

import argparse
import getpass
import ipaddress
import sys
from pathlib import Path

from configs.strict import CONFIGS, load
from hmi.config import PageConfig
from messages.errors import HeadlandError
from runtime.commands.checks import check_drive
from runtime.run_folder import ROOT

STATE = ROOT / "state" / "page"


def main(arguments: argparse.Namespace) -> int:
    """Serves until it is interrupted; raises HeadlandError."""
    state = arguments.state or STATE
    users = state / "users.yaml"
    if arguments.add_user is not None:
        return _add_user(users, *arguments.add_user)
    if arguments.key is not None and arguments.connect is None:
        raise HeadlandError("--key: only with --connect; the simulation accepts the key of the page")
    config = load(PageConfig, arguments.config or CONFIGS / "page.yaml")
    ports = {"port": arguments.port, "stop_port": arguments.stop_port, "foxglove_port": arguments.foxglove}
    config = config.model_copy(update={name: number for name, number in ports.items() if number is not None})
    arguments.foxglove = config.foxglove_port
    _check_foxglove(arguments)
    if arguments.replay is None and arguments.connect is None:
        check_drive(arguments)
    # only now: these imports take seconds, and a wrong argument is reported at once
    from runtime.page.start import serve_log, serve_running, serve_simulation

    if arguments.replay is not None:
        return serve_log(arguments.replay, config, state, arguments.listen)
    if arguments.connect is not None:
        return serve_running(arguments.connect, arguments.key, config, state, arguments.listen)
    return serve_simulation(arguments, config, state)


def _check_foxglove(arguments: argparse.Namespace) -> None:
    """Raises HeadlandError for a Foxglove server of a page that others reach: it has no log-in."""
    is_reached = arguments.listen is not None and not ipaddress.ip_address(arguments.listen).is_loopback
    if arguments.foxglove is not None and is_reached:
        raise HeadlandError(
            f"--foxglove {arguments.foxglove}: has no log-in and cannot be used with --listen {arguments.listen}"
        )


def _add_user(users: Path, name: str, role: str) -> int:
    """Adds or replaces a user with the password from standard input."""
    from hmi.access import ROLES, add_user

    known = {one: one for one in ROLES}
    is_terminal = sys.stdin.isatty()
    password = getpass.getpass(f"password of {name}: ") if is_terminal else sys.stdin.readline().rstrip("\n")
    add_user(users, name, known[role], password)  # type: ignore[index]
    sys.stdout.write(f"{name} ({role}) is in {users}\n")
    return 0
