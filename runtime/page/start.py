"""Start of the page: ports first, then the processes of simulation and emergency stop, then the web server."""

import argparse
import multiprocessing
import os
import secrets
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http.server import ThreadingHTTPServer
from pathlib import Path

from datasets.reader import read_metadata
from hmi import emergency_stop
from hmi.access import Access, one_time_user, read_users
from hmi.calibration_view.desk import CalibrationDesk
from hmi.config import PageConfig
from hmi.foxglove import FoxgloveServer
from hmi.orders import OrderSender, own_key, public_key_of, read_key
from hmi.parts import Drive, Drives, PageParts
from hmi.plan_view.desk import PlanDesk
from hmi.plan_view.mission_store import MissionStore
from hmi.plan_view.options import default_options
from hmi.scene import scene_of
from hmi.security import LOOPBACK as LOCAL
from hmi.setup_view.desk import SetupDesk
from hmi.setup_view.store import SetupStore
from hmi.statistics.store import StatisticsStore
from hmi.upload.platform_report import PlatformReport
from hmi.upload.uploader import Uploader
from interfaces.orders.config import ORDERS, OrderKey
from interfaces.orders.port import OrderPort
from messages.errors import HeadlandError
from runtime.machine_setup import running_setup
from runtime.page.log_feed import LogFeed
from runtime.page.place import LOOPBACK, Place, place_of, qr_text
from runtime.page.running import logged, running_drive
from runtime.page.views import machine_views
from runtime.processes import begin_worker
from runtime.run_folder import RUNS
from safety.output.alarms import text_zh
from safety.rules import RULES
from safety.supervisor import texts_of

AUTHORITY = "operator"
USERS, KEY, MISSIONS = "users.yaml", "order_key.pem", "missions"  # of the state folder
STATISTICS, UPLOAD, SETUP = "statistics.db", "upload.db", "setup.db"
PLANNER = (sys.executable, "-m", "runtime.page.field_process")
NICE = 10  # of web server and planner: a log-in alone takes both cores for 0.2 s, and machine and simulation come first
UNANSWERED = 3  # checks of the emergency stop, then the machine is gone


@dataclass(frozen=True)
class Sockets:
    """Bound sockets of page and Foxglove server."""

    page: socket.socket
    foxglove: socket.socket | None


def serve_simulation(arguments: argparse.Namespace, config: PageConfig, state: Path) -> int:
    """Page with a simulation of its own, which waits for the orders of the page."""
    from runtime.page.drives import SimulatedDrives

    place = place_of(arguments.listen, state)
    listening, stop_server = _listen(place, config), _stop_server(place, config.stop_port)
    key, order_port = own_key(state / KEY), OrderPort(0)
    statistics, setups = StatisticsStore(state / STATISTICS), SetupStore(state / SETUP)
    number = order_port.number
    with _stop_process(place, stop_server, number) as stop_url:
        known = OrderKey(
            public_key=public_key_of(key).hex(), authority=AUTHORITY, orders=tuple(ORDERS),
            lost_operator_s=config.lost_operator_s,
        )  # fmt: skip
        drives = SimulatedDrives(arguments, order_port, known, setups)
        order_port.close()  # of this process; that of the drives has it
        try:
            import hmi.app  # noqa: F401  loads the web server while the simulation is planned

            sender = OrderSender(key, AUTHORITY, number)
            return _serve(
                drives.first(), config, state, sender, stop_url, "simulation", place, listening, statistics, drives,
                setups,
            )  # fmt: skip
        finally:
            drives.end()


def serve_running(
    folder: Path, key_file: Path | None, config: PageConfig, state: Path, listen: str | None = None
) -> int:
    """Page of a running drive; gives orders with a key that the machine knows."""
    from runtime.page.live_feed import LiveFeed

    found, place = running_drive(folder), place_of(listen, state)
    name = f"{folder.resolve().name}/{next(iter(found.rings.values())).parent.name}"
    scene = scene_of(found.config, str(folder / "config.yaml"))
    views = None if config.foxglove_port is None else machine_views(scene)
    drive = Drive(LiveFeed(found.rings, logged(folder), views), scene, name)
    if found.order_port is None:  # a drive of `run`: it takes no orders, and is not counted
        if key_file is not None:
            raise HeadlandError(f"--key {key_file}: a drive of `headland run` takes no orders")
        return _serve(drive, config, state, None, None, "connected", place, _listen(place, config))
    key = None if key_file is None else read_key(key_file)
    sender = None
    if key is not None and key_file is not None:
        authority = found.authority_of(public_key_of(key).hex(), key_file)
        sender = OrderSender(key, authority, found.order_port)
    listening, stop_server = _listen(place, config), _stop_server(place, config.stop_port)
    with _stop_process(place, stop_server, found.order_port) as stop_url:
        return _serve(
            replace(drive, setup=running_setup(found.config)), config, state, sender, stop_url, "connected", place,
            listening, StatisticsStore(state / STATISTICS), setups=SetupStore(state / SETUP),
        )  # fmt: skip


def serve_log(path: Path, config: PageConfig, state: Path, listen: str | None = None) -> int:
    """Page that plays a log."""
    place = place_of(listen, state)
    listening = _listen(place, config)
    feed = LogFeed(path, config.foxglove_port is not None)
    text = read_metadata(path).get("config", {}).get("yaml", "")
    scene = scene_of(text, str(path), feed.planned_map_m())
    return _serve(Drive(feed, scene, path.name), config, state, None, None, "replay", place, listening)


def _serve(
    drive: Drive, config: PageConfig, state: Path, sender: OrderSender | None, stop_url: str | None, source: str,
    place: Place, listening: Sockets, statistics: StatisticsStore | None = None, drives: Drives | None = None,
    setups: SetupStore | None = None,
) -> int:  # fmt: skip
    """Serves until SIGINT or SIGTERM."""
    os.nice(NICE)  # processes that were forked before keep their priority
    from hmi.app import make_app, serve

    users, texts = read_users(state / USERS), texts_of(RULES)
    url = place.url(listening.page.getsockname()[1])
    sys.stdout.write(f"page: {url}\n")
    if stop_url is not None:
        sys.stdout.write(f"emergency stop: {stop_url}\n")
    foxglove = None
    if listening.foxglove is not None:
        sys.stdout.write(f"foxglove: ws://{LOOPBACK}:{listening.foxglove.getsockname()[1]}\n")
        foxglove = FoxgloveServer(listening.foxglove, config.foxglove_origins, drive.name)
    if not users:
        password = secrets.token_urlsafe(9)
        users = one_time_user(password)
        sys.stdout.write(f"log-in of this start: operator, password {password} (--add-user for lasting ones)\n")
    if place.certificate is not None:
        sys.stdout.write(f"certificate (SHA-256): {place.certificate.fingerprint}\n{qr_text(url)}\n")
    sys.stdout.write("Ctrl+C ends it\n")
    sys.stdout.flush()
    access = Access(config.session, users)
    scene = drive.scene
    desk = PlanDesk(
        MissionStore((state / MISSIONS).absolute()), PLANNER, default_options(scene.vehicle.name, scene.implement.name),
        config.plan_limit_s,
    )  # fmt: skip
    report = uploader = None
    if statistics is not None:
        path = state / UPLOAD
        report, uploader = PlatformReport(path, config.upload), Uploader(path, config.upload)
    setup = calibration = None
    if setups is not None and drive.setup is not None:
        setup = SetupDesk(setups, drive.setup, drive.setup_number)
        calibration, desk.work = CalibrationDesk(setup), setup.work
    parts = PageParts(
        drive, config, access, sender, stop_url, source, lambda code: text_zh(texts, code), desk, RUNS.absolute(),
        statistics, drives, setup, calibration, report=report, uploader=uploader, url=url,
        foxglove=foxglove,
    )  # fmt: skip
    serve(make_app(parts, LOCAL | {place.host}), listening.page, place.certificate)
    if uploader is not None:
        uploader.end()
    return 0


def _listen(place: Place, config: PageConfig) -> Sockets:
    """Sockets of the ports; raises HeadlandError for one that is taken."""
    port = config.foxglove_port
    page = _socket("--port", place.host, config.port)
    return Sockets(page, None if port is None else _socket("--foxglove", LOOPBACK, port))


def _socket(option: str, host: str, port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen(64)
    except OSError as error:
        raise HeadlandError(
            f"{option} {port}: cannot be opened on {host} ({error.strerror}); 0 takes a free one"
        ) from error
    return listening


def _stop_server(place: Place, port: int) -> ThreadingHTTPServer:
    try:
        return emergency_stop.make_server(place.host, port, place.certificate.context() if place.certificate else None)
    except OSError as error:
        raise HeadlandError(f"--stop-port {port}: cannot be opened ({error.strerror}); 0 takes a free one") from error


@contextmanager
def _stop_process(place: Place, server: ThreadingHTTPServer, order_port: int) -> Iterator[str]:
    """Process of the emergency stop; its address. It outlives a killed page for as long as the machine answers."""
    process = multiprocessing.get_context("fork").Process(
        target=_serve_stop, args=(server, order_port, os.getpid()), name="emergency stop"
    )
    process.start()
    url = place.url(server.server_address[1])
    server.server_close()
    try:
        yield url
    finally:
        process.terminate()
        process.join()


def _serve_stop(server: ThreadingHTTPServer, order_port: int, parent: int) -> None:
    begin_worker(None)
    unanswered = 0

    def is_over(sender: emergency_stop.StopSender) -> bool:
        nonlocal unanswered
        if os.getppid() == parent:
            return False
        unanswered = 0 if sender.accepted() is not None else unanswered + 1
        return unanswered >= UNANSWERED

    emergency_stop.serve(server, order_port, is_over)
