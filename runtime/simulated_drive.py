"""A drive in simulation: stack and world into a log, its evaluation from the log, and the report."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from configs.site import Bay
from configs.strict import Config
from configs.vehicle import Vehicle
from datasets.disk import check_room
from datasets.log import LogWriter
from datasets.reader import LogScan, decode, is_ours
from messages.errors import HeadlandError
from messages.message import Envelope
from runtime.assembly import assemble, fault_injection_for, plant_of
from runtime.bus import Sink
from runtime.commands.end_of_run import EndOfDrive, expected_s
from runtime.commands.progress import Progress
from runtime.executor import Executor
from runtime.interruption import Interruption
from runtime.node_process import node_process
from runtime.run_folder import RunFolder, resolved, versions
from runtime.setup import Setup, start_notes
from simulation.scenario import Scenario
from simulation.world import SimulationWorld
from validation.drive.detections import Detections, DetectionSample, range_rows, share_rows
from validation.drive.docking import bodies_of, docking_drive
from validation.drive.figures import draw_all
from validation.drive.record import TOPICS, DriveRecord, collect
from validation.drive.report import render
from validation.drive.sensing_figures import detections_figure, docking_figure, shares_figure
from validation.drive.summary import Planned, summarize

if TYPE_CHECKING:
    from runtime.page.shown_run import ShownRun

INTERRUPTED = "interrupted"


def drive(
    setup: Setup, scenario: Scenario, folder: RunFolder, console: TextIO, is_ablation: bool = False,
    limit_s: float | None = None, interruption: Interruption | None = None, shown: "ShownRun | None" = None,
    cores: int = 1,
) -> dict[str, Any]:  # fmt: skip
    """Drives one mission into a run folder, at most `limit_s` simulated seconds; returns the object of `run --json`.

    `shown` is the page on which it is seen meanwhile. The drive is the same on one core and on two `cores`.

    Raises HeadlandError if log or report cannot be written; what was written until then stays in the folder.
    """
    began_s = time.monotonic()
    log = setup.stack.datasets.log
    check_room(folder.path, expected_s(setup.plan.length_m, limit_s), log.drive_mb_per_s, log.min_free_mb)
    conditions = versions() | {"seed": str(setup.seed), "ablation": str(is_ablation)}
    folder.record("conditions", conditions if shown is None else conditions | {"rings": shown.rings})
    log_path = folder.file("log.mcap")
    for name in ("config.yaml", "console.log", "report.html"):
        folder.file(name)
    digest, failure = None, None
    try:
        digest = drive_into_log(
            setup, scenario, folder.path, conditions, console, is_ablation, limit_s, interruption, shown, cores
        )
    except (HeadlandError, OSError) as error:
        if not log_path.is_file():
            raise
        failure = error
    try:
        result = _report(setup, scenario, folder, {"digest": digest}, began_s, interruption)
    except (HeadlandError, OSError) as error:
        raise HeadlandError(f"{failure or error}; the drive until then is kept in {folder.path}") from error
    if failure is not None:
        raise HeadlandError(f"{failure}; the drive until then is kept in {folder.path}") from failure
    if result["outcome"] != INTERRUPTED:
        folder.finish()
    return result


def _report(
    setup: Setup, scenario: Scenario, folder: RunFolder, more: dict[str, Any], began_s: float,
    interruption: Interruption | None,
) -> dict[str, Any]:  # fmt: skip
    """Evaluates the log and writes figures, report and records; returns the object of `run --json`."""
    record, samples = read_drive(folder.path / "log.mcap", setup.vehicle)
    bay = None if setup.mission.bay is None else setup.site.bay(setup.mission.bay)
    planned = Planned(
        setup.plan.planned_area, setup.plan.field_area_m2, setup.implement.working_width_m, scenario.expected_stops, bay
    )
    summary = summarize(record, planned)
    result = summary.as_dict | {
        "seed": setup.seed,
        "wall_s": round(time.monotonic() - began_s, 1),
        "expected_stops": scenario.expected_stops,
        **more,
        "run_dir": str(folder.path),
    }
    if interruption is not None and interruption.is_requested:
        result["outcome"] = INTERRUPTED
    figures = draw_all(record, planned, summary) | _sensing_figures(record, samples, setup, bay)
    for title, png in figures.items():
        folder.file(f"{title.lower().replace(',', '').replace(' ', '-')}.png").write_bytes(png)
    ranges = range_rows(samples)
    folder.file("report.html").write_text(render(summary, result, figures, ranges), encoding="utf-8")
    folder.record("ranges", {"ranges": ranges, "shares": share_rows(samples)})
    for stop in summary.stops:
        folder.record("stop", stop.as_dict)
    folder.record("result", {"result": result})
    return result


def _drawn_plant(setup: Setup, scenario: Scenario) -> dict[str, Config]:
    """True values of a plant that is not nominal, for the record."""
    if scenario.plant == "nominal":
        return {}
    plant = plant_of(setup, scenario)
    return {
        "true_site": plant.site, "true_machine": plant.vehicle, "true_implement": plant.implement,
        "true_start": plant.start, "true_dynamics": plant.models.machine, "true_gnss": plant.models.gnss,
    }  # fmt: skip


def drive_into_log(
    setup: Setup, scenario: Scenario, folder: Path, conditions: dict[str, str], console: TextIO,
    is_ablation: bool = False, limit_s: float | None = None, interruption: Interruption | None = None,
    shown: "ShownRun | None" = None, cores: int = 1,
) -> str:  # fmt: skip
    """Runs the stack until the drive ends or is interrupted, at most `limit_s`, into a log; returns its digest."""
    config = resolved(
        mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement, stack=setup.stack,
        scenario=scenario, **_drawn_plant(setup, scenario),
    )  # fmt: skip
    (folder / "config.yaml").write_text(config, encoding="utf-8")
    if shown is not None:
        shown.begin(folder)
    metadata = {"run": conditions, "config": {"yaml": config}}
    faults = fault_injection_for(setup, scenario)
    with (
        assemble(setup, scenario, is_ablation, faults) as (world, nodes),
        node_process(nodes, cores if faults is None else 1) as process,
        (folder / "console.log").open("w") as file,
    ):
        end = EndOfDrive(setup.plan.length_m, limit_s)
        with LogWriter(folder / "log.mcap", metadata, setup.stack.datasets.log, setup.viewer(), rotates=True) as log:
            if isinstance(world, SimulationWorld):
                log.add_metadata("shapes", {"json": world.shapes_text()})
            sinks: list[Sink] = [log.write, Progress((console, file), start_notes(setup)), end]
            sinks += [one for one in (faults, None if shown is None else shown.write) if one is not None]
            Executor(world, nodes, sinks, faults, process).run(
                lambda: end.is_reached() or (interruption is not None and interruption.is_requested)
            )
            return log.digest()


def read_drive(path: Path, vehicle: Vehicle) -> tuple[DriveRecord, list[DetectionSample]]:
    """Drive record of a log, and the observations of the scenario's objects by each sensor."""
    detections = Detections(vehicle)

    def envelopes() -> Iterator[Envelope]:
        for entry in LogScan(path, detections.topics.union(TOPICS)):
            if is_ours(entry) and detections.needs(entry.topic):
                envelope = decode(entry)
                detections(envelope)
                yield envelope

    return collect(envelopes()), detections.samples


def _sensing_figures(
    record: DriveRecord, samples: list[DetectionSample], setup: Setup, bay: Bay | None
) -> dict[str, bytes]:
    """Figures of the detections against ground truth, and of the docking if there was one."""
    found = {
        "Detections near by": detections_figure(samples, record.first_ns),
        "Detections over range": shares_figure(samples),
    }
    poses, speed_mps = docking_drive(record)
    if bay is not None and setup.site.shed is not None and len(poses):
        bodies = bodies_of(setup.vehicle, setup.implement)
        found["Docking"] = docking_figure(setup.site.shed, bay, poses, speed_mps, bodies)
    return {title: png for title, png in found.items() if png is not None}
