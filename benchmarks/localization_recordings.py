"""Recordings with faults laid over them: what the localizer that one configuration serves makes of each.

    ./headland benchmark localization_recordings [--only REGEX] [--recordings NAME...] [--at S...] [--seed K]

A fault begins at each of the times `--at` after the begin of the recording. Truth is that of the recording; where it
has none, the localizer's own positions over the recording as it is. One line per drive: share of the time with a
position after the first, median and largest error, share of the errors above the protection level (time error after
the fault began in brackets), median level, alarms.
"""

import argparse
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import numpy as np

from benchmarks.localization_faults import moved
from benchmarks.recordings import DATA
from configs.strict import CONFIGS, load
from datasets.importers.formats import open_recording
from datasets.importers.recording import Received, Recording
from messages.message import Message
from messages.motion import Odometry
from messages.sensors import GnssFix, ImuSample, WheelSample
from runtime.localize.config import LocalizeConfig
from runtime.localize.drive import Localized, localize
from runtime.localize.sources import sources_of
from runtime.stack import load_stack
from validation.localization.judgement import errors_of
from validation.localization.truth import Truth, of_fixes, read_truth


@dataclass(frozen=True)
class Source:
    """A recording: file, vehicle file, true positions (None: none), seconds of it that are used, every n-th fix."""

    path: Path
    vehicle: Path | None
    truth: Path | None
    seconds: float
    fixes_every: int
    at_s: tuple[float, ...]


def _recordings() -> dict[str, Source]:
    comma = next((DATA / "comma2k19-example" / "Example_1").glob("*/40"), Path("comma2k19"))
    husky = DATA / "robot-localization-bags" / "test" / "test1.bag"
    kitti = Path(gtsam.findExampleDataFile("KittiEquivBiasedImu.txt"))  # type: ignore[no-untyped-call]
    return {
        "comma2k19": Source(comma, None, comma / "global_pose", 60.0, 1, (25.0, 38.0)),
        "husky": Source(husky, CONFIGS / "vehicles/husky.yaml", None, 110.0, 1, (50.0, 75.0)),
        "kitti": Source(kitti, None, None, 200.0, 10, (100.0, 150.0)),
    }


SOURCES = _recordings()


@dataclass(frozen=True)
class Case:
    """A fault of `for_s`; `edit(message, elapsed_s, rng)` changes a message, None removes it."""

    name: str
    edit: Callable[[Message, float, np.random.Generator], Message | None]
    for_s: float = math.inf


def _fix(change: Callable[[GnssFix, float, np.random.Generator], GnssFix | None]) -> Callable[..., Message | None]:
    return lambda m, s, rng: change(m, s, rng) if isinstance(m, GnssFix) else m


def _rate(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., Message | None]:
    return lambda m, s, rng: replace(m, rate_radps=change(m.rate_radps)) if isinstance(m, ImuSample) else m


def _wheels(factor: float) -> Callable[..., Message | None]:
    return lambda m, s, rng: replace(m, speed_mps=factor * m.speed_mps) if isinstance(m, WheelSample | Odometry) else m


def _jitter(sigma_s: float) -> Callable[..., Message | None]:
    return _fix(lambda f, s, rng: replace(f, stamp_ns=f.stamp_ns + round(1e9 * sigma_s * rng.standard_normal())))


CASES = (
    Case("as it is", lambda m, s, rng: m, 0.0),
    *(Case(f"all cut out {for_s:g} s", lambda m, s, rng: None, for_s) for for_s in (1.5, 3.0, 6.0)),
    Case("no fixes 3 s", _fix(lambda f, s, rng: None), 3.0),
    Case("step 30 m 10 s", _fix(lambda f, s, rng: moved(f, 0.0, 30.0)), 10.0),
    Case("ramp 3 m/s 10 s", _fix(lambda f, s, rng: moved(f, 0.0, 3.0 * s)), 10.0),
    Case("gyro step 2 deg/s", _rate(lambda w: w + math.radians(2.0))),
    Case("wheels at zero", _wheels(0.0), 15.0),
    Case("wheels negated", _wheels(-1.0)),
    Case("fix stamps jittered by 30 ms", _jitter(0.03)),
)  # fmt: skip


def changed(recording: Recording, case: Case, at_s: float, seconds: float, seed: int) -> Recording:
    """The first seconds of a recording, with a fault from `at_s` on."""

    def messages() -> Iterator[Received]:
        rng, first_ns = np.random.default_rng(seed), None
        for receive_ns, topic, message in recording.read():
            first_ns = receive_ns if first_ns is None else first_ns
            elapsed_s = (receive_ns - first_ns) * 1e-9
            if elapsed_s > seconds:
                return
            is_faulty = 0.0 <= elapsed_s - at_s < case.for_s
            kept = case.edit(message, elapsed_s - at_s, rng) if is_faulty else message
            if kept is not None:
                yield receive_ns, topic, kept

    return replace(recording, messages=messages)


class Trial:
    """A recording, its configuration and its truth."""

    def __init__(self, source: Source, seed: int) -> None:
        stack = load_stack()
        self.source, self._seed = source, seed
        self._config = load(LocalizeConfig, CONFIGS / "localize.yaml").of(stack.localization)
        self._latency_ns = stack.executor.latency_ns("localizer")
        recording = open_recording(source.path)
        self._sources = sources_of(recording, source.vehicle, self._config.map_alignment.gnss.sensor)
        whole, withheld = self._run(CASES[0], 0.0)
        antenna = self._sources.vehicle.sensors.gnss[self._config.map_alignment.gnss.sensor]
        self._antenna_m = np.array(antenna.mount.xyz_m)
        if source.truth is not None:
            self._truth = read_truth(source.truth, whole.datum)
        elif withheld:
            self._truth = of_fixes("fixes that were withheld", withheld, whole.datum)
        else:
            found = whole.trajectory
            self._truth = Truth("the localizer", found.stamps_ns, found.T_map_base[:, :2, 3], False, True)

    def _run(self, case: Case, at_s: float) -> tuple[Localized, list[GnssFix]]:
        recording = changed(self._sources.recording, case, at_s, self.source.seconds, self._seed)
        sources = replace(self._sources, recording=recording)
        return localize(sources, self._config, self._latency_ns, self.source.fixes_every)

    def line(self, case: Case, at_s: float) -> str:
        """The result of one drive as a row of the table."""
        run, _ = self._run(case, at_s)
        errors, share = errors_of(run.trajectory, self._truth, self._antenna_m), run.placed_after_alignment
        if errors is None or share is None:
            return "no position"
        awaited = sum(run.awaited_s.values())
        start_s = ((run.placed_first_ns or 0) - (run.first_ns or 0)) * 1e-9
        faults = " ".join(code for code in run.faults if code != "localization.awaits") or "—"
        cells = (
            f"{100.0 * share:.1f}", f"{start_s:.1f}", f"{awaited - start_s:.1f}",
            f"{np.median(errors.distance_m):.2f}", f"{np.max(errors.distance_m):.2f}",
            f"{100.0 * errors.exceeded_share:.1f}", f"{np.max(errors.distance_m - errors.level_m):.2f}",
            f"{np.median(errors.level_m):.1f}", f"{errors.nees:.1f}", faults,
        )  # fmt: skip
        return " | ".join(cells)


HEAD = "placed % | start s | lost s | median m | largest m | above PL % | error - PL m | median PL m | NEES | alarms"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", nargs="+", choices=SOURCES, default=list(SOURCES))
    parser.add_argument("--only", type=re.compile, default=re.compile(""))
    parser.add_argument("--at", nargs="+", type=float)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"| recording | case | at s | {HEAD} |\n|{'---|' * 13}")
    for name in arguments.recordings:
        trial = Trial(SOURCES[name], arguments.seed)
        for case in CASES:
            if arguments.only.search(case.name):
                for at_s in (arguments.at or SOURCES[name].at_s)[: 1 if case is CASES[0] else None]:
                    print(f"| {name} | {case.name} | {at_s:g} | {trial.line(case, at_s)} |", flush=True)


if __name__ == "__main__":
    main()
