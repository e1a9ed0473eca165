"""Simulated drives of the page, one after the other: a process that starts them, forked before the web server.

The order port belongs to it, so that emergency stop and orders reach each drive at the same address.
"""

import argparse
import multiprocessing
import os
import signal
import sys
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkContext, ForkProcess
from types import FrameType

from hmi.parts import Drive, Drives
from hmi.plan_view.mission_store import MISSION, SEED, StoredMission
from hmi.plan_view.progress import Progress
from hmi.scene import scene_of
from hmi.setup_view.store import SetupStore
from interfaces.orders.config import OrderKey
from interfaces.orders.port import OrderPort
from messages.errors import HeadlandError
from runtime.machine_setup import configured_setup
from runtime.page.live_feed import LiveFeed
from runtime.page.simulation import REFUSED, Announcement, Ended, drive_simulation
from runtime.page.views import machine_views
from runtime.processes import begin_worker

TRIAL = "calibration"  # mission of the calibration wizards
END_S = 20.0  # for a simulation to close its log


class SimulatedDrives(Drives):
    """Process of the simulated drives; begins with the arguments of the command line.

    Each drive takes the newest version of the setup of its machine and implement; raises HeadlandError.
    """

    def __init__(self, arguments: argparse.Namespace, port: OrderPort, key: OrderKey, store: SetupStore) -> None:
        self._store = store
        self._arguments = arguments = self._present = self._with_setup(arguments, arguments.setup_version)
        context = multiprocessing.get_context("fork")
        self._link, there = context.Pipe()
        work = (context, arguments, port, key, there, self._link, os.getpid())
        self._process = context.Process(target=_keep, args=work, name="drives")
        self._process.start()
        there.close()

    def first(self) -> Drive:
        """The drive of the command line; raises HeadlandError if it has failed."""
        try:
            found = self._link.recv()
        except EOFError:
            found = None
        if not isinstance(found, Announcement):
            machine, number = self._present.setup_version
            raise HeadlandError(
                f"the simulation did not start; see the message above. Version {number} of the setup of {machine} "
                "is in use: --setup-version N begins with another"
            )
        return self._drive_of(found)

    def start(self, mission: StoredMission, progress: Progress | None = None) -> None:
        """Ends the present drive and begins one on a stored mission, in a run folder of its own."""
        feature = None if mission.about is None else mission.about.feature
        chosen = vars(self._arguments) | {
            "mission": str(mission.folder / MISSION), "field": str(mission.field), "feature": feature, "guidance": None,
            "machine": None, "implement": None, "bay": None, "out": None, "seed": SEED,
            "stored": mission.folder, "resumed": None if progress is None else progress.model_dump_json(),
        }  # fmt: skip
        self._begin(argparse.Namespace(**chosen))

    def restart(self) -> None:
        """Ends the present drive and begins it once more, in a run folder of its own."""
        self._begin(argparse.Namespace(**vars(self._present) | {"out": None, "resumed": None}))

    def start_trial(self) -> None:
        """Ends the present drive and begins the one of the mission `calibration`, in a run folder of its own."""
        chosen = vars(self._arguments) | {
            "mission": TRIAL, "scenario": "empty", "field": None, "feature": None, "guidance": None, "bay": None,
            "out": None, "stored": None, "resumed": None,
        }  # fmt: skip
        self._begin(argparse.Namespace(**chosen))

    def _begin(self, arguments: argparse.Namespace) -> None:
        self._present = self._with_setup(arguments)
        self._link.send(self._present)

    def _with_setup(self, arguments: argparse.Namespace, chosen: int | None = None) -> argparse.Namespace:
        """Arguments with the newest version of the setup, or with the chosen one; raises HeadlandError."""
        configured = configured_setup(arguments.mission, arguments.machine, arguments.implement)
        number, setup = self._store.newest(configured)
        if chosen is not None:
            number, setup = chosen, self._store.setup(setup.machine, chosen)
        changes = {"assumed": setup.to_json(), "setup_version": (setup.machine, number)}
        return argparse.Namespace(**vars(arguments) | changes)

    def take(self) -> Drive | str | None:
        """The drive that has begun since the last call, or why one has ended."""
        try:
            found = self._link.recv() if self._link.poll() else None
        except (EOFError, OSError):
            return None
        if isinstance(found, Announcement):
            return self._drive_of(found)
        return found.text if isinstance(found, Ended) else None

    def _drive_of(self, found: Announcement) -> Drive:
        """The drive of an announcement; its rings have a name of their own."""
        scene = scene_of(found.config, "simulation", found.planned_map_m)
        name = f"{found.run}/{next(iter(found.rings.values())).parent.name}"
        machine, number = found.setup_version
        setup = self._store.setup(machine, number)
        views = None if self._arguments.foxglove is None else machine_views(scene)
        return Drive(LiveFeed(found.rings, views=views), scene, name, found.stored, setup, number)

    def end(self) -> None:
        """Ends drive and process with the log closed."""
        self._process.terminate()
        self._process.join(END_S + 5.0)
        self._process.kill()


def _keep(
    context: ForkContext, arguments: argparse.Namespace, port: OrderPort, key: OrderKey, link: Connection,
    other: Connection, parent: int,
) -> None:  # fmt: skip
    """Keeps one drive at a time until SIGTERM."""
    begin_worker(parent)
    signal.signal(signal.SIGTERM, _terminate)
    other.close()

    def begin(given: argparse.Namespace) -> ForkProcess:
        work = (given, port, key, link, os.getpid())
        process = context.Process(target=drive_simulation, args=work, name="simulation")
        process.start()
        return process

    drive: ForkProcess | None = begin(arguments)
    try:
        while True:
            ready = wait([link] if drive is None else [link, drive.sentinel])
            if link in ready:
                given = link.recv()
                _end(drive)
                drive = begin(given)
            elif drive is not None:
                drive.join()
                if drive.exitcode != REFUSED:  # that has said why
                    text = f"the simulation has ended (exit code {drive.exitcode})"
                    sys.stderr.write(f"headland: {text}\n")
                    link.send(Ended(text))
                drive = None
    except EOFError:
        pass
    finally:
        _end(drive)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise SystemExit


def _end(drive: ForkProcess | None) -> None:
    """Ends a drive with its log closed."""
    if drive is None:
        return
    drive.terminate()
    drive.join(END_S)
    drive.kill()
    drive.join()
