"""Cost of logging: milliseconds and bytes per simulated second, with realistic lidar noise.

./headland benchmark log_write [SECONDS]
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import ImplementFile, Lidar, Vehicle
from datasets.log import LogConfig, LogWriter
from datasets.summary import summarize_log
from datasets.viewer import Viewer, ViewerConfig
from geometry.arrays import Float64
from geometry.transforms import planar
from messages import command, motion, perception, plan, sensors, truth
from messages.faults import Response
from messages.message import Envelope, Message

START_NS = 1_750_000_000_000_000_000
RETURNS_OF_OBSTACLES = 600
Rng = np.random.Generator


def scan_of(lidar: Lidar, stamp_ns: int, rng: Rng) -> sensors.LidarScan:
    """Scan of a field with furrows and six obstacles, with the noise of the sensor."""
    elevation = np.radians(lidar.elevation_deg)
    half = 0.5 * np.radians(lidar.field_of_view_deg)
    azimuth = np.linspace(-half, half, lidar.columns, endpoint=False)
    height_m = lidar.mount.xyz_m[2] + 0.05 * np.sin(azimuth * 40.0 + stamp_ns * 1e-9)
    down = -np.sin(elevation)[:, None]
    range_m = np.where(down > 0.0, height_m / np.maximum(down, 1e-6), np.inf)
    for center in rng.uniform(-half, half, 6):
        range_m[:, np.abs(azimuth - center) < 0.04] = np.minimum(
            range_m[:, np.abs(azimuth - center) < 0.04], rng.uniform(5.0, 40.0)
        )
    range_m = range_m + rng.normal(0.0, lidar.range_sigma_m, range_m.shape)
    is_return = (range_m < lidar.range_m[1]) & (rng.random(range_m.shape) > 0.02)
    ranges_mm = np.where(is_return, np.round(np.where(is_return, range_m, 0.0) * 1e3), 0.0).astype(np.uint16)
    intensity = rng.normal(60.0, 6.0, np.count_nonzero(ranges_mm)).clip(0, 255).astype(np.uint8)
    offset_s = np.linspace(-0.1, 0.0, lidar.columns).astype(np.float32)
    return sensors.LidarScan(stamp_ns, ranges_mm, elevation, azimuth, np.zeros((0, 3), np.float32), intensity, offset_s)


def _noisy(rng: Rng, shape: tuple[int, ...]) -> Float64:
    return rng.normal(size=shape)


def odometry(t: int, rng: Rng) -> Message:
    """Random odometry."""
    T = planar(*rng.normal(size=3).tolist())
    x = rng.normal(size=5).tolist()
    return motion.Odometry(t, T, x[0], x[1], x[2], x[3], x[4], _noisy(rng, (6, 6)))


def map_pose(t: int, rng: Rng) -> Message:
    """Random map pose."""
    T = planar(*rng.normal(size=3).tolist())
    return motion.MapPose(t, T, T, _noisy(rng, (6, 6)), motion.PositionSource.RTK_FIXED, 0.05, 0.1, True)


def obstacles(t: int, rng: Rng) -> Message:
    """Twelve clusters with returns on vertical faces."""
    k, n = 12, RETURNS_OF_OBSTACLES
    along = np.tile(np.linspace(0.0, 1.0, n // k), k)
    corner = np.repeat(rng.uniform(-30.0, 30.0, (k, 3)), n // k, axis=0)
    points = corner + np.stack([along, 0.5 * along, np.repeat(np.linspace(0, 2, n // k), k)], 1)
    points_m = (points + rng.normal(0.0, 0.015, points.shape)).astype(np.float32)
    scores = np.full((k, 7), 1.0 / 7.0)
    offsets = np.linspace(0, n, k + 1).astype(np.int32)
    indices = np.sort(rng.permutation(30000)[:n]).astype(np.int32)
    return perception.Obstacles(
        t, "lidar/front", t, _noisy(rng, (k, 3)), _noisy(rng, (k, 3)), _noisy(rng, (k,)), _noisy(rng, (k, 3)),
        np.full((k, 2), np.nan), scores, offsets, indices, points_m,
    )  # fmt: skip


def tracks(t: int, rng: Rng) -> Message:
    """Ten tracks."""
    label = perception.ObstacleClass.PERSON
    one = [
        perception.Track(
            i, label, 0.9, _noisy(rng, (3,)), _noisy(rng, (2,)), _noisy(rng, (4, 4)), _noisy(rng, (3,)), 0.1, t, t,
            True, ("lidar/front",),
        )
        for i in range(10)
    ]  # fmt: skip
    return perception.Tracks(t, tuple(one))


def supervisor(t: int, rng: Rng) -> Message:
    """Ten rules, a protective field and ten triggering points."""
    rules = tuple(command.RuleResult(f"rule.{i}", Response.NONE, 3.0, "no objection") for i in range(10))
    return command.SupervisorState(
        t, command.Mode.AUTOMATIC, "", rules, perception.ObstacleClass.UNKNOWN, 40.0, 3.0, 12.0, 38.0, 0.0,
        rng.normal(size=(10, 3)).astype(np.float32), _noisy(rng, (60, 2)),
    )  # fmt: skip


def machine(t: int, rng: Rng) -> Message:
    """Random machine state."""
    x = rng.normal(size=8).tolist()
    return command.MachineState(
        t, t, t, t, t, t, x[0], x[1], True, 0, 0, x[2], True, x[3], True, False, False, True, 0.0, x[4], x[5], x[6],
        False, False, 13.8, 0,
    )  # fmt: skip


def frames(t: int, rng: Rng) -> Message:
    """Six frames of eight bytes."""
    return command.CanFrames(t, "can0", tuple(command.CanFrame(t, 0x18FEF100 + i, rng.bytes(8)) for i in range(6)))


def control_command(t: int, rng: Rng) -> Message:
    """Random control command."""
    x = rng.normal(size=6).tolist()
    return command.ControlCommand(t, x[0], x[1], x[2], True, True, 3, x[3], x[4], x[5], False)


def safe_command(t: int, rng: Rng) -> Message:
    """Random safe command."""
    x = rng.normal(size=2).tolist()
    return command.SafeCommand(t, command.Mode.AUTOMATIC, True, x[0], 0.0, x[1], True, True, False, False, True, "")


def true_machine(t: int, rng: Rng) -> Message:
    """Random true machine state."""
    x = rng.normal(size=5).tolist()
    return truth.TrueMachine(t, planar(*x[:3]), x[0], x[1], x[2], x[3], _noisy(rng, (3,)), x[4], 0.0, True, 0, 0)


def true_objects(t: int, rng: Rng) -> Message:
    """Twelve true objects."""
    label = perception.ObstacleClass.ANIMAL
    some = [
        truth.TrueObject(i, label, "", _noisy(rng, (3,)), np.ones(3), 0.1, _noisy(rng, (2,)), 9.0) for i in range(12)
    ]
    return truth.TrueObjects(t, tuple(some))


def health(t: int, rng: Rng) -> Message:
    """Sectors of 10 degrees."""
    return perception.SensorHealth(
        t, "lidar/front", perception.HealthState.GOOD, "", np.linspace(-np.pi, np.pi, 37), rng.uniform(30, 40, 36), 0
    )


def imu(t: int, rng: Rng) -> Message:
    """One sample."""
    return sensors.ImuSample(t, _noisy(rng, (3,)), _noisy(rng, (3,)))


def wheel(t: int, rng: Rng) -> Message:
    """One sample."""
    return sensors.WheelSample(t, *rng.normal(size=2).tolist())


def fix(t: int, rng: Rng) -> Message:
    """One GNSS fix."""
    x = rng.normal(size=3).tolist()
    return sensors.GnssFix(
        t, 0.85, 0.15, 400.0, np.full(3, 0.01), _noisy(rng, (3,)), 0.02, x[0], 0.002, sensors.GnssSolution.RTK_FIXED,
        18, 0.8, 1.0, "BDS+GPS",
    )  # fmt: skip


def mission(t: int, rng: Rng) -> Message:
    """Mission status."""
    return plan.MissionStatus(
        t, plan.MissionState.DRIVING, plan.PathSectionType.SWATH, 4, 3, 12.0, 800.0, 1500.0, "swath 4", ()
    )


# topic, rate (Hz), function
STREAMS = (
    ("imu", 100, imu), ("wheel", 50, wheel), ("machine", 50, machine), ("can/can0", 50, frames), ("odom", 50, odometry),
    ("control_command", 50, control_command), ("safe_command", 50, safe_command), ("gnss/main", 10, fix),
    ("map_pose", 10, map_pose),
    ("obstacles/front", 10, obstacles), ("tracks", 10, tracks), ("supervisor", 10, supervisor),
    ("health/front", 10, health), ("health/rear", 10, health), ("mission", 5, mission),
    ("truth_machine", 20, true_machine), ("truth_objects", 10, true_objects),
)  # fmt: skip


def second_of(k: int, vehicle: Vehicle, rng: Rng) -> list[Envelope]:
    """All messages of one second, in order of reception."""
    out: list[tuple[int, str, Message]] = []
    for topic, rate, make in STREAMS:
        stamps = [START_NS + k * 1_000_000_000 + i * (1_000_000_000 // rate) for i in range(rate)]
        out += [(t, topic, make(t, rng)) for t in stamps]
    for name, lidar in vehicle.sensors.lidar.items():
        stamps = [START_NS + k * 1_000_000_000 + i * 100_000_000 for i in range(10)]
        out += [(t, f"lidar/{name}", scan_of(lidar, t, rng)) for t in stamps]
    return [Envelope(topic, k, t, message) for t, topic, message in sorted(out, key=lambda row: row[:2])]


def seconds_of(count: int, vehicle: Vehicle) -> Iterator[list[Envelope]]:
    """Consecutive seconds; scan points are computed beforehand, as by perception."""
    rng = np.random.default_rng(5)
    for k in range(count):
        envelopes = second_of(k, vehicle, rng)
        for envelope in envelopes:
            if isinstance(envelope.message, sensors.LidarScan):
                _ = envelope.message.points_m
        yield envelopes


def main() -> None:
    """Writes a log with and without viewer topics and prints the cost."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    vehicle = load(Vehicle, CONFIGS / "machines" / "tractor_e.yaml")
    implement = load(ImplementFile, CONFIGS / "implements" / "harrow_6m.yaml").implement
    section = read_yaml(CONFIGS / "stack/datasets.yaml")
    log, view = parse(LogConfig, section["log"], "log"), parse(ViewerConfig, section["viewer"], "viewer")
    with TemporaryDirectory() as folder:
        for viewer in (None, Viewer(view, vehicle, implement, None)):
            path = Path(folder) / f"{viewer is None}.mcap"
            spent_s = 0.0
            writer = LogWriter(path, {}, log, viewer)
            for envelopes in seconds_of(count, vehicle):
                start = time.process_time()
                for envelope in envelopes:
                    writer.write(envelope)
                spent_s += time.process_time() - start
            writer.close()
            size_mb = path.stat().st_size / 1e6
            content = "messages and viewer topics" if viewer else "messages only"
            sys.stdout.write(
                f"{content}: {spent_s / count * 1e3:.1f} ms per second, {len(envelopes)} messages; "
                f"{size_mb / count:.3f} MB per second = {size_mb / count * 600:.0f} MB in 10 min\n"
            )
        start = time.perf_counter()
        summary = summarize_log(path)
        sys.stdout.write(f"summarize_log: {(time.perf_counter() - start) / count * 1e3:.1f} ms per second\n")
        for topic in summary.topics:
            sys.stdout.write(f"  {topic.topic:<28}{topic.bytes / count * 600 / 1e6:9.1f} MB raw in 10 min\n")


if __name__ == "__main__":
    main()
