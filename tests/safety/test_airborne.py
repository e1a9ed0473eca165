"""Dust and birds are no hits, by evidence of the range image; who is among them is."""

from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import MountedImplement, Vehicle
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.zones.footprint import Box as Area
from safety.zones.footprint import footprint_of
from tests.clause import clause
from tests.perception.lidar_scenes import box, cast, listed
from tests.safety.safety_world import START_NS, tractor

AREA, STILL = Area((-6.0, 12.0), (-4.0, 4.0)), Motion(0.0, 0.0)
SCAN_NS = 100_000_000
BIRD, BIRD_MPS = (0.4, 1.2, 0.15), 7.0  # length along its path, span, height
ADULT, CHILD = box(7.0, 0.5, 0.3, 0.5, 1.75), box(7.0, -0.5, 0.25, 0.3, 1.05)
LYING = box(6.5, 0.3, 0.45, 1.7, 0.25)


@pytest.fixture(scope="module")
def machine() -> Vehicle:
    """The shipped machine with the front lidar and a dome."""
    return tractor("front", "front_left")


def source_of(machine: Vehicle, implement: MountedImplement, config: SafetyConfig, name: str = "front") -> LidarSource:
    return LidarSource(name, machine.sensors.lidar[name], footprint_of(machine, implement), config)


def take(source: LidarSource, scan: LidarScan, *others: LidarSource) -> int:
    """Number of hits after a scan."""
    source.update(scan, np.zeros(3), STILL, 0.0, AREA, others)
    return len(source.hits_odom_m)


def dust(share: float):
    """Isolated returns 0.8 to 8 m off on a share of the beams."""

    def add(mm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        found_mm = rng.uniform(800.0, 8000.0, mm.shape).astype(np.uint16)
        return np.where((rng.random(mm.shape) < share) & ((mm == 0) | (found_mm < mm)), found_mm, mm)

    return add


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("name", ["front", "front_left"])
def test_dust_is_no_hit_and_who_is_in_it_is(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, name: str
) -> None:
    lidar, scans = machine.sensors.lidar[name], range(15)
    source = source_of(machine, implement, config, name)
    for k in scans:
        assert take(source, cast(lidar=lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=dust(0.01))) == 0, k
    for body in (ADULT, CHILD, LYING) if lidar.looks_down else (ADULT, CHILD):
        source = source_of(machine, implement, config, name)
        hits = [
            take(source, cast([body], lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=dust(0.01))) for k in scans
        ]
        assert all(hits[1:]), body


def fog(share: float):
    """Returns of fog on a share of the beams; their ranges as those of a receiver that is focused 10 m off."""
    r = np.linspace(1.0, 20.0, 2000)
    share_below = np.cumsum(np.minimum((r - 1.0) / 9.0, 1.0) / r**2 * np.exp(-0.1 * r))

    def add(mm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        found_mm = (1000.0 * np.interp(rng.random(mm.shape), share_below / share_below[-1], r)).astype(np.uint16)
        return np.where((rng.random(mm.shape) < share) & ((mm == 0) | (found_mm < mm)), found_mm, mm)

    return add


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("share", [0.05, 0.1])
@pytest.mark.parametrize("name", ["front", "front_left"])
def test_fog_is_no_hit_and_who_is_in_it_is(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, name: str, share: float
) -> None:
    lidar, scans = machine.sensors.lidar[name], range(15)
    source = source_of(machine, implement, config, name)
    for k in scans:
        assert take(source, cast(lidar=lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=fog(share))) == 0, k
    for body in (ADULT, CHILD):
        source = source_of(machine, implement, config, name)
        hits = [
            take(source, cast([body], lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=fog(share))) for k in scans
        ]
        assert all(hits[1:]), body


@clause("BD-5.2.4", rule="detection_range")
def test_fog_does_not_count_as_sight(machine: Vehicle, implement: MountedImplement, config: SafetyConfig) -> None:
    """Before, returns of fog counted as ground: a lidar that sees 6 m far reported 40 m."""
    found = []
    for share in (0.0, 0.3, 0.95):
        source = source_of(machine, implement, config)
        take(source, cast(stamp_ns=START_NS, extra=fog(share)))
        found.append(source.detection_range_m(1))
    assert found[0] == source.nominal_range_m
    assert found[0] >= found[1] > 6.0
    assert found[2] == 0.0


def test_dust_would_be_hits_without_the_evidence(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "safety.sources.lidar.scattered", lambda image, pixels, memory=None: np.zeros(len(pixels), bool)
    )
    trusting = config.model_copy(update={"airborne": config.airborne.model_copy(update={"dust_returns": 10_000})})
    source = source_of(machine, implement, trusting)
    hits = [take(source, cast(seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=dust(0.01))) for k in range(15)]
    assert np.count_nonzero(hits) >= 2


def returns_at(machine: Vehicle, count: int):
    """Some returns at (7.3, 0.2, 1.2) with nothing around them."""
    place, T = np.array([7.3, 0.2, 1.2]), machine.sensors.lidar["front"].mount.T_base_sensor
    clean = cast(noise_m=0.0)
    assert np.linalg.norm(clean.points_m + T[:3, 3] - place, axis=1).min() > 1.0

    def add(mm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        el, az = clean.elevation_rad[:, None], clean.azimuth_rad
        d = np.stack(np.broadcast_arrays(np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=-1)
        towards = (place - T[:3, 3]) / np.linalg.norm(place - T[:3, 3])
        nearest = np.argsort(-(d @ towards).ravel())[:count]
        out = mm.copy().ravel()
        out[nearest] = round(1000.0 * float(np.linalg.norm(place - T[:3, 3])))
        return out.reshape(mm.shape)

    return add


def scatter(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    """Some share of the returns, far off, is scattered."""
    monkeypatch.setattr(
        "safety.sources.lidar.scattered",
        lambda image, pixels, memory=None: np.arange(len(pixels)) < share * len(pixels),
    )


@pytest.mark.parametrize("in_fog", [False, True])
def test_few_floating_returns_in_fog_are_what_is_left_of_it(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, monkeypatch: pytest.MonkeyPatch, in_fog: bool
) -> None:
    """Scattered are 1 % of the returns, far off; in the same cell in three scans are two or eight returns."""
    scatter(monkeypatch, 0.01 if in_fog else 0.0)
    for count, expected in ((2, not in_fog), (8, True)):
        source, add = source_of(machine, implement, config), returns_at(machine, count)
        hits = [take(source, cast(seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=add)) for k in range(3)]
        assert bool(hits[-1]) == expected, count


@pytest.mark.parametrize("in_fog", [False, True])
def test_what_hangs_above_the_machine_in_fog_needs_two_scans(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, monkeypatch: pytest.MonkeyPatch, in_fog: bool
) -> None:
    """Beams that end on the machine beneath eight returns do not show that these stand."""
    scatter(monkeypatch, 0.01 if in_fog else 0.0)
    clean, add = cast(noise_m=0.0), returns_at(machine, 8)

    def above_machine(mm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        out = add(mm, rng)
        rows, columns = np.nonzero(out != mm)
        beneath = clean.elevation_rad < clean.elevation_rad[rows].min()
        out[np.ix_(beneath, np.unique(columns))] = 250  # mm, to the bumper
        return out

    source = source_of(machine, implement, config)
    hits = [take(source, cast(seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=above_machine)) > 0 for k in range(2)]
    assert hits == [not in_fog, True]


def test_few_isolated_returns_are_no_dust(machine: Vehicle, implement: MountedImplement, config: SafetyConfig) -> None:
    """Two returns of a small body with nothing beneath it count in three scans, in a list in two."""
    with_two = returns_at(machine, 2)
    for image in (True, False):
        source = source_of(machine, implement, config)
        counts = []
        for k in range(3):
            scan = cast(seed=k, stamp_ns=START_NS + k * SCAN_NS, extra=with_two)
            counts.append(take(source, scan if image else listed(scan)))
        assert counts == ([0, 0, 2] if image else [0, 2, 2])


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("name", ["front", "front_left"])
def test_a_bird_that_passes_is_no_hit_and_what_hangs_there_is(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig, name: str
) -> None:
    lidar = machine.sensors.lidar[name]
    for low_m in (1.0, 1.3):
        source = source_of(machine, implement, config, name)
        for k in range(8):
            bird = box(10.5 - 0.1 * k * BIRD_MPS, 0.5, *BIRD, low=low_m)
            assert take(source, cast([bird], lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS)) == 0, k
        branch = box(6.5, 0.0, 0.4, 1.2, 0.15, low=low_m)
        source = source_of(machine, implement, config, name)
        hits = [take(source, cast([branch], lidar, seed=k, stamp_ns=START_NS + k * SCAN_NS)) for k in range(3)]
        assert hits[:2] == [0, 0]
        assert hits[2] > 0
    for body in (ADULT, CHILD):
        source = source_of(machine, implement, config, name)
        assert take(source, cast([body, box(6.8, 0.5, *BIRD, low=1.6)], lidar)) > 0


def test_another_lidar_shows_that_a_bird_floats(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig
) -> None:
    """0.6 m before the bumper the front lidar sees nothing below 1 m; the dome beside it does, if its scan counts."""
    dome = machine.sensors.lidar["front_left"]
    bird, child = box(4.1, 0.3, 0.4, 0.8, 0.15, low=1.2), box(4.1, 0.3, 0.3, 0.3, 1.2)
    for body, is_asked, late_ns, expected in (
        (bird, True, 0, False), (bird, False, 0, True), (bird, True, 400_000_000, True), (child, True, 0, True),
    ):  # fmt: skip
        front, other = source_of(machine, implement, config), source_of(machine, implement, config, "front_left")
        take(other, cast([body], dome, stamp_ns=START_NS))
        seen = cast([body], stamp_ns=START_NS + late_ns)
        assert bool(take(front, seen, *((other,) if is_asked else ()))) == expected
    silent, listing, frozen = (source_of(machine, implement, config, "front_left") for _ in range(3))
    take(listing, listed(cast([bird], dome, stamp_ns=START_NS)))
    same = cast([bird], dome, stamp_ns=START_NS)
    for k in range(5):
        take(frozen, replace(same, stamp_ns=START_NS + k))
    assert frozen.is_frozen
    for other in (silent, listing, frozen):
        assert take(source_of(machine, implement, config), cast([bird], stamp_ns=START_NS), other) > 0


def test_a_bird_seen_to_float_is_followed_where_the_machine_hides_what_is_beneath(
    machine: Vehicle, implement: MountedImplement, config: SafetyConfig
) -> None:
    """By the last scan of any lidar, no farther and no longer than it flies, and no body that stands."""
    far, near = box(4.1, -0.8, *BIRD, low=1.25), box(4.1, 0.2, 0.4, 0.8, 0.15, low=1.25)
    follow_ns = round(config.airborne.follow_s * 1e9)

    def hits(before: list, late_ns: int, body: object, by_other: bool = False) -> bool:
        front, other = source_of(machine, implement, config), source_of(machine, implement, config, "front_left")
        first = other if by_other else front
        first.update(cast([], machine.sensors.lidar[first.name], stamp_ns=START_NS), np.zeros(3), STILL, 0.0, AREA)
        first.floated = ((START_NS, np.array(before)),)
        return bool(take(front, cast([body], stamp_ns=START_NS + late_ns), other))

    assert hits([[9.0, 3.0, 1.3]], SCAN_NS, near)
    for by_other in (False, True):
        assert not hits([[4.1, -0.3, 1.3]], SCAN_NS, near, by_other)
    assert hits([[4.1, -0.3, 1.3]], follow_ns + 1, near)
    assert hits([[5.0, -0.1, 1.3]], SCAN_NS, box(5.5, 0.0, 0.3, 0.5, 1.75))
    source = source_of(machine, implement, config, "front_left")
    take(source, cast([far], machine.sensors.lidar["front_left"], stamp_ns=START_NS))
    ((stamp_ns, floated),) = source.floated
    assert stamp_ns == START_NS
    assert floated[:, 2].min() > 1.0
