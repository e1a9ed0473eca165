"""Simulation of the page: a drive that waits for orders, in a process of its own."""

import argparse
import secrets
import sys
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

from geometry.arrays import Float64
from geometry.polyline import simplified
from hmi.plan_view.progress import Progress, StoredDrive
from interfaces.orders.config import OrderKey
from interfaces.orders.port import OrderPort
from messages.errors import HeadlandError
from runtime.interruption import Interruption
from runtime.processes import begin_worker
from runtime.run_folder import RunFolder, command_of

REFUSED = 2  # exit code of a drive that has said why it does not begin


@dataclass(frozen=True)
class Announcement:
    """Run folder, rings by process, resolved configuration and planned lines (N, 2) in `map` of a drive that starts.

    `setup_version` is the machine and number of the setup that it takes.
    """

    run: str
    rings: dict[str, Path]
    config: str
    planned_map_m: tuple[Float64, ...]
    stored: StoredDrive | None
    setup_version: tuple[str, int]


@dataclass(frozen=True)
class Ended:
    """A drive has ended by itself."""

    text: str


def drive_simulation(
    arguments: argparse.Namespace, port: OrderPort, key: OrderKey, connection: Connection, parent: int
) -> None:
    """Drives until SIGTERM; accepts the orders of this key, and none of the scenario."""
    begin_worker(parent)
    try:
        with RunFolder("page", arguments.out, command_of(arguments)) as folder, Interruption() as interruption:
            _drive(arguments, folder, interruption, port, key, connection)
    except (HeadlandError, OSError) as error:
        sys.stderr.write(f"headland: {error}\n")
        connection.send(Ended(str(error)))
        sys.exit(REFUSED)


def _drive(
    arguments: argparse.Namespace, folder: RunFolder, interruption: Interruption, port: OrderPort, key: OrderKey,
    connection: Connection,
) -> None:  # fmt: skip
    from runtime.live.operated import Operated
    from runtime.page.resume import resumed_setup
    from runtime.setup import load_scenario, setup_from
    from runtime.stack import with_order_key

    setup = setup_from(arguments)
    folder_of_mission, resumed = stored_of(arguments)
    last_id = max((path.path_id for path in setup.plan.fixed_paths), default=0)
    stored = None if folder_of_mission is None else StoredDrive(folder_of_mission, resumed, last_id)
    if resumed is not None:
        setup = resumed_setup(setup, resumed)
    session = secrets.token_hex(16)  # as at a real start: no order for the drive before counts
    setup = replace(setup, stack=with_order_key(setup.stack, "page", key), session=session)
    scenario = load_scenario(arguments.scenario, setup.mission, arguments.field, arguments.plant)
    scenario = scenario.model_copy(update={"operator_commands": ()})
    planned = tuple(simplified(path.p_map_m) for path in setup.plan.paths)

    def announce(rings: dict[str, Path], config: str) -> None:
        connection.send(Announcement(folder.path.name, rings, config, planned, stored, arguments.setup_version))

    operated = Operated(port, announce)
    if arguments.live:
        from runtime.live.command import drive

        drive(setup, scenario, folder, None, None, 0, interruption, None, operated)
    else:
        from runtime.page.single_process import drive_in_one_process

        drive_in_one_process(setup, scenario, folder, interruption, operated, arguments.foxglove is not None)


def stored_of(arguments: argparse.Namespace) -> tuple[Path | None, Progress | None]:
    """Folder of the stored mission that is driven, and where it is resumed."""
    text: str | None = getattr(arguments, "resumed", None)
    return getattr(arguments, "stored", None), None if text is None else Progress.model_validate_json(text)
