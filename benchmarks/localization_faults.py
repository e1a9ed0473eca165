"""Fault cases of `benchmark localization_robustness`: what each does to the messages of a synthetic drive."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.angles import wrap
from geometry.transforms import invert, planar, transform
from messages.message import Message
from messages.motion import LidarOdometry
from messages.sensors import GnssFix, GnssSolution, ImuSample, WheelSample
from tests.localization.synthetic_drive import DATUM, START_NS, Truth, tractor

Entry = tuple[int, str, Message]
EARTH_M = 6_371_000.0
NOT_FIXED = {GnssSolution.RTK_FLOAT: 0.4, GnssSolution.SINGLE: 2.0}  # sigma of the position, m


@dataclass(frozen=True)
class Case:
    """A fault from `from_s` (with the drawn offset) for `for_s`; `edit` changes a message, None removes it.

    `edit(message, elapsed_s, draw)`: time since the fault began, and the numbers drawn for this drive.
    `beside`: further faults, each over its own time. In a clean case every alarm is false.
    """

    name: str
    edit: Callable[[Message, float, "Draw"], Message | None]
    from_s: float = 40.0
    for_s: float = math.inf
    legs: str = "field"
    is_clean: bool = False
    beside: tuple["Case", ...] = ()

    def window_s(self, draw: "Draw") -> tuple[float, float]:
        """Begin and end of the fault."""
        start_s = self.from_s + (draw.delay_s if self.from_s > 0.0 else 0.0)
        return start_s, start_s + self.for_s


@dataclass
class Draw:
    """Random numbers of one drive: direction of a horizontal error, delay of the fault, noise and slow error."""

    seed: int
    east: float = 0.0
    north: float = 0.0
    delay_s: float = 0.0
    rng: np.random.Generator = field(init=False)
    slow: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.seed, 21])
        angle = self.rng.uniform(0.0, 2.0 * math.pi)
        self.east, self.north, self.delay_s = math.cos(angle), math.sin(angle), float(self.rng.uniform(0.0, 20.0))
        self.slow = self.rng.standard_normal(3)

    def correlated(self, step_s: float, tau_s: float) -> np.ndarray:
        """Next value (3,) of a Gauss-Markov process of variance 1."""
        keep = math.exp(-step_s / tau_s)
        self.slow = keep * self.slow + math.sqrt(1.0 - keep * keep) * self.rng.standard_normal(3)
        return self.slow


def moved(fix: GnssFix, east_m: float, north_m: float, speed_mps: float = 0.0, draw: Draw | None = None) -> GnssFix:
    """The fix displaced; with a spoofer's `speed_mps` its velocity agrees with the motion of the error."""
    velocity = fix.velocity_enu_mps
    if draw is not None:
        velocity = velocity + speed_mps * np.array([draw.east, draw.north, 0.0])
    return replace(
        fix, latitude_rad=fix.latitude_rad + north_m / EARTH_M,
        longitude_rad=fix.longitude_rad + east_m / (EARTH_M * math.cos(DATUM.latitude_rad)), velocity_enu_mps=velocity,
    )  # fmt: skip


def _fix(change: Callable[[GnssFix, float, Draw], GnssFix | None]) -> Callable[[Message, float, Draw], Message | None]:
    return lambda m, s, d: change(m, s, d) if isinstance(m, GnssFix) else m


def _wrong_fix(size_m: float) -> Case:
    edit = _fix(lambda f, s, d: moved(f, size_m * d.east, size_m * d.north))
    return Case(f"wrong fix {size_m:g} m 20 s", edit, for_s=20.0)


def _multipath(size_m: float, for_s: float) -> Case:
    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix:
        error_m = size_m * math.sin(math.pi * s / for_s)
        return moved(fix, error_m * d.east, error_m * d.north)

    return Case(f"multipath {size_m:g} m {for_s:g} s", _fix(edit), for_s=for_s)


def _ramp(rate_mps: float, is_spoofed: bool) -> Case:
    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix:
        speed_mps = rate_mps if is_spoofed else 0.0
        return moved(fix, rate_mps * s * d.east, rate_mps * s * d.north, speed_mps, d)

    return Case(f"{'spoofed ramp' if is_spoofed else 'ramp'} {rate_mps:g} m/s 30 s", _fix(edit), for_s=30.0)


def worse(solution: GnssSolution, for_s: float = 30.0, from_s: float = 40.0, is_start: bool = False) -> Case:
    """Fixes of another type of solution, with its error correlated over 60 s; single ones have no heading."""

    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix | None:
        if solution is GnssSolution.NONE:
            return None
        sigma = NOT_FIXED[solution]
        error = sigma * d.correlated(0.1, 60.0)
        enu = np.array([sigma, sigma, 2.0 * sigma])
        heading = (fix.heading_rad, fix.sigma_heading_rad) if solution is GnssSolution.RTK_FLOAT else (math.nan,) * 2
        return replace(
            moved(fix, float(error[0]), float(error[1])), solution=solution, sigma_enu_m=enu,
            heading_rad=heading[0], sigma_heading_rad=heading[1],
        )  # fmt: skip

    name = "outage" if solution is GnssSolution.NONE else solution.name.lower().replace("rtk_", "")
    return Case(f"{'start in ' if is_start else ''}{name} {for_s:g} s", _fix(edit), from_s, for_s)


def _heading(offset_deg: float, from_s: float) -> Case:
    edit = _fix(lambda f, s, d: replace(f, heading_rad=wrap(f.heading_rad + math.radians(offset_deg))))
    return Case(f"heading {offset_deg:g}° {'from start' if from_s == 0.0 else '30 s'}", edit, from_s,
                math.inf if from_s == 0.0 else 30.0)  # fmt: skip


def _stamps(shift_ms: int) -> Case:
    edit = _fix(lambda f, s, d: replace(f, stamp_ns=f.stamp_ns + shift_ms * 1_000_000))
    return Case(f"gnss stamps {shift_ms:+d} ms", edit, 0.0)


def _stamp_step(shift_ms: int) -> Case:
    return replace(_stamps(shift_ms), name=f"gnss stamps {shift_ms:+d} ms 20 s", from_s=40.0, for_s=20.0)


def _old_corrections(rate_mps: float) -> Case:
    """Corrections stop; ambiguities stay fixed and the error grows."""

    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix:
        return replace(moved(fix, rate_mps * s * d.east, rate_mps * s * d.north), correction_age_s=1.0 + s)

    return Case(f"corrections stop 40 s, error {1000 * rate_mps:g} mm/s", _fix(edit), for_s=40.0)


def _fewer_satellites(size_m: float) -> Case:
    """A constellation drops out: its share of the slow error with it."""

    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix:
        return replace(moved(fix, size_m * d.east, size_m * d.north), satellites=6, constellations="BDS")

    return Case(f"BDS only, {100 * size_m:g} cm 30 s", _fix(edit), for_s=30.0)


def _together(first: Case, *others: Case) -> Case:
    """Several faults in one drive; the times are judged by the first."""
    return replace(first, name=" + ".join(c.name for c in (first, *others)), beside=others)


def _lever_arm(offset_m: float) -> Case:
    """The antenna is mounted beside the configured place; `heading_rad` turns the offset to `map`."""

    def edit(fix: GnssFix, s: float, d: Draw) -> GnssFix:
        angle = fix.heading_rad + math.atan2(d.north, d.east)
        return moved(fix, offset_m * math.cos(angle), offset_m * math.sin(angle))

    return Case(f"lever arm {100 * offset_m:g} cm", _fix(edit), 0.0)


def _vibration(sigma_mps2: float) -> Case:
    def edit(m: Message, s: float, d: Draw) -> Message:
        if not isinstance(m, ImuSample):
            return m
        return replace(m, acceleration_mps2=m.acceleration_mps2 + sigma_mps2 * d.rng.standard_normal(3))

    return Case(f"vibration {sigma_mps2:g} m/s²", edit, 0.0)


def _slip(share: float) -> Case:
    def edit(m: Message, s: float, d: Draw) -> Message:
        return replace(m, speed_mps=m.speed_mps / (1.0 - share)) if isinstance(m, WheelSample) else m

    return Case(f"slip {100 * share:g} % 10 s", edit, for_s=10.0)


def _without_heading(fix: GnssFix, s: float, d: Draw) -> GnssFix:
    return replace(fix, heading_rad=math.nan, sigma_heading_rad=math.nan)


IMU_GAP = Case("IMU gap 0.2 s", lambda m, s, d: None if isinstance(m, ImuSample) else m, from_s=48.0, for_s=0.2)
NONE, SINGLE, FLOAT = GnssSolution.NONE, GnssSolution.SINGLE, GnssSolution.RTK_FLOAT
CASES = (
    Case("clean", lambda m, s, d: m, is_clean=True),
    *(_wrong_fix(size_m) for size_m in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)),
    *(_multipath(*size) for size in ((0.1, 5), (0.1, 30), (0.2, 20), (0.3, 10), (0.3, 60), (0.5, 20), (0.5, 60))),
    *(_ramp(rate, False) for rate in (0.033, 0.05, 0.1, 0.3, 1.0)),
    *(_ramp(rate, True) for rate in (0.05, 0.1, 0.3, 1.0)),
    _stamps(-50), _stamps(50), _lever_arm(0.05), _heading(5.0, 40.0), _heading(180.0, 40.0), _heading(180.0, 0.0),
    worse(FLOAT), worse(SINGLE), worse(NONE, 5.0), worse(NONE, 30.0), worse(NONE, 60.0),
    *(_vibration(sigma) for sigma in (1.0, 2.0, 5.0)), _slip(0.1), _slip(0.25),
    worse(FLOAT, 20.0, 0.0, True), worse(SINGLE, 20.0, 0.0, True),
    Case("start with one antenna", _fix(_without_heading), 0.0),
    Case("start in motion", lambda m, s, d: m, 0.0, legs="moving", is_clean=True),
    _stamp_step(-200), _old_corrections(0.002), _fewer_satellites(0.03),
    _together(_multipath(0.3, 30), _stamps(-50)), _together(_multipath(0.3, 30), _stamps(50)),
    _together(_multipath(0.5, 20), worse(FLOAT, 20.0, 0.0, True)), _together(_ramp(0.1, False), _slip(0.25)),
    _together(_ramp(0.3, True), _slip(0.1)), _together(_wrong_fix(1.0), _slip(0.25)),
    _together(_multipath(0.2, 20), _lever_arm(0.05), _vibration(2.0)), _together(_wrong_fix(0.5), worse(NONE, 10.0)),
    _together(_multipath(0.3, 60), worse(NONE, 20.0)), _together(_multipath(0.3, 30), _heading(5.0, 40.0)),
    _together(_wrong_fix(0.2), _heading(180.0, 40.0)), _together(_ramp(0.05, False), _stamps(50), _lever_arm(0.05)),
    _together(_multipath(0.5, 60), Case("one antenna", _fix(_without_heading), 0.0)),
    _together(_slip(0.25), _stamps(50)), _together(worse(NONE, 60.0), _slip(0.25)),
    _together(worse(NONE, 60.0), _stamps(-50), _lever_arm(0.05)),
    _together(_wrong_fix(0.5), IMU_GAP), _together(_multipath(0.3, 60), IMU_GAP), _together(_ramp(0.3, True), IMU_GAP),
)  # fmt: skip


def edited(truth: Truth, case: Case, draw: Draw) -> list[Entry]:
    """The messages of a drive with the faults of a case."""
    out: list[Entry] = list(truth.messages)
    for part in (*case.beside, case):
        start_s, end_s = part.window_s(draw)
        before, out = out, []
        for arrival_ns, topic, message in before:
            t_s = (message.stamp_ns - START_NS) * 1e-9
            changed = part.edit(message, t_s - start_s, draw) if start_s <= t_s < end_s else message
            if changed is not None:
                out.append((arrival_ns, topic, changed))
    return out


def lidar_motions(truth: Truth, seed: int, seconds: float, yaw_deg: float | None = None) -> list[Entry]:
    """Lidar odometry at 5 Hz as a model of matching: white errors of each pose (5 mm, 0.02°), drift of 0.1 %, and a
    mount that is off in yaw, by 0.3° (1 σ) where it is not given.

    No scans are computed: the model is that of a yard with hedges and posts, see `benchmark localization_synthetic`.
    """
    rng, topic, period_ns = (
        np.random.default_rng([seed, 22]),
        f"lidar_odometry/{next(iter(tractor().sensors.lidar))}",
        200_000_000,
    )
    covariance = np.diag(np.repeat([math.radians(0.03), 0.008], 3) ** 2)
    off_deg = float(np.random.default_rng([seed, 23]).normal(0.0, 0.3)) if yaw_deg is None else yaw_deg
    mount = planar(0.0, 0.0, math.radians(off_deg))
    out: list[Entry] = []
    before, T_before = np.eye(4), truth.at(START_NS + period_ns)
    for stamp_ns in range(START_NS + 2 * period_ns, START_NS + int((seconds - 1.0) * 1e9), period_ns):
        T = truth.at(stamp_ns)
        motion = invert(mount) @ invert(T_before) @ T @ mount
        after = transform(rng.normal(0.0, 0.005, 3), rng.normal(0.0, math.radians(0.02), 3))
        drift_m = 0.001 * float(np.linalg.norm(motion[:3, 3])) * rng.standard_normal(3)
        measured = invert(before) @ motion @ transform(drift_m, (0.0, 0.0, 0.0)) @ after
        odometry = LidarOdometry(stamp_ns, stamp_ns - period_ns, measured, covariance, True, "", 300)
        out.append((stamp_ns + 60_000_000, topic, odometry))
        before, T_before = after, T
    return out
