"""Lidar agreement: a lidar with wrong ranges is named, whatever the ground; wrong alone or beside right ones."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import Lidar, Vehicle
from geometry.arrays import Float64
from messages.command import Mode
from messages.message import Message
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.monitors.lidar_agreement import LidarAgreement
from safety.sources.ground_filter import Motion
from safety.sources.ground_heights import ground_heights
from safety.sources.lidar import LidarSource
from safety.supervisor import Supervisor
from safety.zones.footprint import Box, footprint_of
from safety.zones.geofence import Geofence
from tests.safety.safety_world import NO_BYTES, START_NS, World, scan_of, straight_path, tractor

AREA = Box((-12.0, 15.0), (-8.0, 8.0))
FRONT = ("front", "front_left", "front_right")
PERIOD_NS = 100_000_000
Change = Callable[[LidarScan, np.random.Generator], LidarScan]
Ground = Callable[[Float64, Float64], Float64]


def ranges(change: Callable[[Float64, np.random.Generator], Float64]) -> Change:
    """A change of the ranges, in m, of all returns."""

    def changed(scan: LidarScan, random: np.random.Generator) -> LidarScan:
        metres = change(scan.ranges_mm * 1e-3, random)
        is_return = (scan.ranges_mm > 0) & (metres > 0.1)
        mm = np.where(is_return, np.clip(metres * 1e3, 0, 65_000), 0).astype(np.uint16)
        return replace(scan, ranges_mm=mm)

    return changed


WRONG = {
    "offset": ranges(lambda m, random: m + 1.0),
    "nearer": ranges(lambda m, random: m - 0.6),
    "scale": ranges(lambda m, random: 1.1 * m),
    "shorter": ranges(lambda m, random: 0.9 * m),
    "noise": ranges(lambda m, random: m + random.normal(0.0, 0.5, m.shape)),
    "feet": ranges(lambda m, random: m / 0.3048),
    "garbage": ranges(lambda m, random: random.uniform(0.0, 65.0, m.shape)),
}


def flat(x: Float64, y: Float64) -> Float64:
    return np.zeros_like(x)


def waves(x: Float64, y: Float64) -> Float64:
    return np.asarray(0.1 * np.sin(2 * math.pi * x / 6.0))


def crest(x: Float64, y: Float64) -> Float64:
    return np.asarray(-np.clip(x - 4.0, 0.0, None) * 0.15)


def side_slope(x: Float64, y: Float64) -> Float64:
    return np.asarray(0.2 * y)


def furrows(x: Float64, y: Float64) -> Float64:
    return np.asarray(-0.12 * (np.sin(2 * math.pi * y / 0.75) > 0.3))


def on(ground: Ground, lidar: Lidar, scan: LidarScan) -> LidarScan:
    """The scan of level ground moved along its rays onto another ground, to within millimetres."""
    T = lidar.mount.T_base_sensor
    el, az = scan.elevation_rad[:, None], scan.azimuth_rad
    rays = np.stack(
        np.broadcast_arrays(np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=-1
    ) @ T[:3, :3].T  # fmt: skip
    is_down = rays[..., 2] < -0.02
    length = np.where(is_down, -T[2, 3] / np.where(is_down, rays[..., 2], -1.0), 0.0)
    for _ in range(60):
        x, y = (T[k, 3] + length * rays[..., k] for k in (0, 1))
        length += 0.5 * np.where(is_down, (ground(x, y) - T[2, 3]) / np.minimum(rays[..., 2], -0.02) - length, 0.0)
    is_seen = is_down & (length < lidar.range_m[1]) & (length > lidar.range_m[0])
    return replace(scan, ranges_mm=np.where(is_seen, length * 1e3, 0).astype(np.uint16))


class Rig:
    """Lidars of the vehicle that stand over a ground; `wrong` are those with changed scans."""

    def __init__(self, vehicle: Vehicle, implement, config: SafetyConfig, names: tuple[str, ...] = FRONT) -> None:
        self.lidars = {name: vehicle.sensors.lidar[name] for name in names}
        footprint = footprint_of(vehicle, implement)
        self.sources = [LidarSource(name, lidar, footprint, config) for name, lidar in self.lidars.items()]
        self.agreement = LidarAgreement(config.lidar_agreement)
        self.random, self.now_ns = np.random.default_rng(1), START_NS

    def run(self, count: int, wrong: dict[str, Change] | None = None, ground: Ground = flat) -> list[str]:
        """Codes after `count` scans of each lidar, all at its own time within the period."""
        for _ in range(count):
            self.now_ns += PERIOD_NS
            for k, source in enumerate(self.sources):
                lidar = self.lidars[source.name]
                scan = scan_of(lidar, self.now_ns + 10_000_000 * k, (0.0, 0.0, 0.0), (), self.random)
                scan = on(ground, lidar, scan) if ground is not flat else scan
                scan = (wrong or {}).get(source.name, lambda scan, _: scan)(scan, self.random)
                source.update(scan, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
                self.agreement.update(self.sources)
        return [failure.code for failure in self.agreement.failures(self.sources, 1)]


@pytest.fixture(scope="module")
def shipped() -> Vehicle:
    """The shipped machine with its lidars alone: three that see the same ground ahead, one behind."""
    return tractor(*FRONT, "rear")


@pytest.fixture
def rig(shipped: Vehicle, implement, config: SafetyConfig) -> Rig:
    return Rig(shipped, implement, config)


@pytest.mark.parametrize("ground", [flat, waves, crest, side_slope, furrows])
def test_right_lidars_agree_on_any_ground(rig: Rig, ground: Ground) -> None:
    for _ in range(4):
        assert rig.run(4, ground=ground) == []


@pytest.mark.parametrize("name", FRONT)
@pytest.mark.parametrize("kind", WRONG)
def test_wrong_lidar_is_named_after_the_hold_time(rig: Rig, name: str, kind: str, config: SafetyConfig) -> None:
    assert rig.run(3) == []
    scans = round(config.lidar_agreement.hold_s * 1e9 / PERIOD_NS)
    assert rig.run(scans - 1, {name: WRONG[kind]}) == []
    assert rig.run(3, {name: WRONG[kind]}) == [f"lidar/{name}.contradicted"]
    assert rig.run(1) == []


@pytest.mark.parametrize("wrong", FRONT[:2])
@pytest.mark.parametrize("kind", ["offset", "scale", "garbage"])
def test_of_two_the_one_that_contradicts_the_wheels_comes_first(
    shipped: Vehicle, implement, config: SafetyConfig, wrong: str, kind: str
) -> None:  # fmt: skip
    assert Rig(shipped, implement, config, FRONT[:2]).run(5, {wrong: WRONG[kind]})[0] == f"lidar/{wrong}.contradicted"


@pytest.mark.parametrize("ground", [waves, crest, side_slope, furrows])
def test_wrong_lidar_is_named_on_any_ground(rig: Rig, ground: Ground) -> None:
    """Another that only the wrong one shares enough ground with may be accused too."""
    assert rig.run(13, {"front": WRONG["scale"]}, ground)[0] == "lidar/front.contradicted"


def test_brief_contradictions_do_not_add_up(rig: Rig) -> None:
    for _ in range(5):
        assert rig.run(2, {"front": WRONG["offset"]}) == []
        rig.run(1)


def test_two_lidars_accuse_each_other(shipped: Vehicle, implement, config: SafetyConfig) -> None:
    rig = Rig(shipped, implement, config, ("front", "front_left"))
    assert rig.run(12, {"front": WRONG["offset"]}) == ["lidar/front.contradicted", "lidar/front_left.contradicted"]
    text = rig.agreement.failures(rig.sources, 1)[0].text
    assert "lidar/front, lidar/front_left" in text


def test_nothing_to_compare(shipped: Vehicle, implement, config: SafetyConfig) -> None:
    """One lidar alone, lidars that look elsewhere, one without a scan, and scans too far apart in time."""
    alone = Rig(shipped, implement, config, ("front",))
    assert alone.run(12, {"front": WRONG["scale"]}) == []
    assert LidarAgreement(config.lidar_agreement).failures([], 1) == ()
    both = Rig(shipped, implement, config, ("front", "front_left"))
    both.agreement.update(both.sources)
    silent = Rig(shipped, implement, config, ("front", "front_left"))
    silent.run(1)
    late = silent.sources[0]
    for k in range(20):
        stamp_ns = silent.now_ns + round((k + 2) * config.lidar_agreement.max_interval_s * 1e9)
        scan = scan_of(silent.lidars["front"], stamp_ns, (0.0, 0.0, 0.0), (), silent.random)
        late.update(WRONG["offset"](scan, silent.random), np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
        silent.agreement.update(silent.sources)
        assert silent.agreement.failures(silent.sources, 1) == ()


def test_failures_by_direction(rig: Rig) -> None:
    rig.run(12, {"front": WRONG["offset"]})
    assert rig.agreement.failures(rig.sources, -1) == ()


def test_lidar_with_other_rings(rig: Rig) -> None:
    """Two lidars whose cables are exchanged."""

    def exchanged(scan: LidarScan, random: np.random.Generator) -> LidarScan:
        return scan_of(rig.lidars["front_left"], scan.stamp_ns, (0.0, 0.0, 0.0), (), random)

    assert rig.run(1, {"front": exchanged})[0] == "lidar/front.foreign"
    assert rig.run(1) == []
    points = LidarScan(
        rig.now_ns + 1, np.empty((0, 0), np.uint16), np.empty(0), np.empty(0), np.ones((5, 3), np.float32), NO_BYTES,
        np.empty(0, np.float32),
    )  # fmt: skip
    rig.sources[0].update(points, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
    assert not rig.sources[0].has_other_rings


def test_ground_heights_by_cell() -> None:
    """The lowest return of each cell, in odom; beams that would meet level ground farther away do not count."""
    xyz = np.array([[3.2, 3.4, 5.5, 20.0], [0.1, 0.2, 0.3, 0.0], [0.3, -0.1, 0.0, 0.0]], np.float32)
    origin, pose = np.array([0.0, 0.0, 2.0]), np.array([100.0, 50.0, math.pi / 2])
    found = ground_heights(xyz, origin, 8.0, pose, 1.0)
    assert found.height_m == pytest.approx([-0.1, 0.0])
    turned = ground_heights(xyz[:, ::-1].copy(), origin, 8.0, pose, 1.0)
    assert (turned.cells == found.cells).all()
    assert (turned.height_m == found.height_m).all()
    assert len(ground_heights(xyz[:, 3:], origin, 8.0, pose, 1.0).cells) == 0


@pytest.fixture
def lidar_world(shipped: Vehicle, implement, config, geofence: Geofence) -> World:
    """Closed loop with that machine."""
    return World(Supervisor(shipped, implement, config, geofence, ()), shipped, straight_path(), is_plain=True)


def test_machine_stops_and_waits_for_a_person(lidar_world: World) -> None:
    world = lidar_world.start()
    assert world.mode == Mode.AUTOMATIC
    put = world.put

    def wrong(topic: str, message: Message) -> None:
        is_wrong = topic == "lidar/front" and isinstance(message, LidarScan)
        put(topic, WRONG["scale"](message, world.rng) if is_wrong else message)

    world.put = wrong  # type: ignore[method-assign]
    world.run(2.5)
    assert world.mode == Mode.FAULT_STOP
    assert "lidar/front.contradicted" in {fault.code for fault in world.faults}
