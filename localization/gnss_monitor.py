"""GNSS monitor: whether positions that the receiver states as good agree with what is independent of them.

Hypotheses of one fault at a time, each with the sigmas that its prior leaves of the integrity budget (IntegrityConfig):

    wrong fix or multipath:  the position is wrong, the Doppler velocity right    1e-2 / h
    spoofing:                position and velocity are wrong and agree             1e-4 / h
    wrong velocity:          the Doppler velocity is wrong, positions are right    1e-3 / h
    wrong ambiguities:       at the return of fixed ones                           1e-3 each
    stamps:                  all fixes are late or early                           present for good

A fault that began within a window shows as separation of that window; what does not show is bounded by
`Separation.bound_m`. A fault slower than the longest covered window shows is not bounded (docs/localization.md).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from localization.gnss_gate import Position
from localization.separation import OdometrySeparation, Separation, SeparationConfig, Swing, VelocitySeparation

VELOCITY, ODOMETRY, REFUSED = "gnss.contradicts_velocity", "gnss.contradicts_odometry", "gnss.refused"


class WindowConfig(Config):
    """A window, and the sigmas of what it cannot see that the protection level covers, by hypothesis."""

    window_s: float = Field(gt=0.0, le=120.0)
    wrong_fix_sigmas: float = Field(ge=0.0, le=10.0)
    spoofing_sigmas: float = Field(ge=0.0, le=10.0)


class GnssMonitorConfig(Config):
    """Section `gnss_monitor` of map alignment."""

    separation: SeparationConfig
    windows: tuple[WindowConfig, ...] = Field(min_length=1, description="shortest first")
    detect_sigmas: float = Field(gt=1.0, le=10.0)
    cover_m: float = Field(gt=0.0, le=5.0, description="windows with a larger bound of unseen errors detect only")
    slip_s: float = Field(gt=0.0, le=120.0, description="longer windows do not bound what slip of the wheels explains")
    refused_fixes: int = Field(ge=1, le=100, description="refused in a row: suspected")
    agree_sigmas: float = Field(gt=0.0, le=10.0, description="of a suspected receiver with its reference")
    agree_floor_m: float = Field(gt=0.0, le=1.0)
    agree_s: float = Field(gt=0.0, le=60.0, description="duration of the agreement that ends a suspicion")
    reference_m: float = Field(gt=0.0, le=10.0, description="sigma above which a reference proves nothing")
    return_s: float = Field(gt=0.0, le=60.0, description="longer times without fixed ambiguities end with a return")
    return_sigmas: float = Field(ge=0.0, le=10.0, description="of the bound at the return")
    seen_sigmas: float = Field(gt=0.0, le=10.0, description="separations above may be the begin of an error")
    hold_s: float = Field(ge=0.0, le=600.0, description="longest multipath: for which those bounds are held")
    vote_sigmas: float = Field(
        gt=0.0, le=10.0, description="by which odometry is nearer to positions: velocity is wrong"
    )


ByWindow = dict[WindowConfig, Separation]


@dataclass(frozen=True)
class Finding:
    """What begins a suspicion: separation from the reference since the anchor, and slip (4,) with sigmas there."""

    code: str
    separation: Separation
    slip: Float64
    slip_sigma: Float64


class GnssMonitor:
    """Suspects the receiver of wrong positions, and ends the suspicion when they agree with the reference again."""

    def __init__(self, config: GnssMonitorConfig, odometry: OdometrySeparation) -> None:
        self._config = config
        self.odometry, self._velocity = odometry, VelocitySeparation(config.separation)
        self.anchor_ns: int | None = None  # before what is suspected
        self._agreed_ns: int | None = None
        self._refused = 0
        self._fixed_ns: int | None = None  # newest fix with fixed ambiguities
        self._held: deque[tuple[int, float]] = deque()  # time and bound
        self._level_m = self._carried_m = 0.0
        self._carried_ns: int | None = None  # first fix after an interruption
        self._velocity_wrong_ns: int | None = None
        self.suspicion = ""
        self.detail = ""
        self.is_slipping = False

    def clear(self) -> None:
        """Drops everything, at a start."""
        self.odometry.clear()
        self._velocity.clear()
        self.anchor_ns = self._agreed_ns = self._fixed_ns = self._carried_ns = None
        self._held.clear()
        self._refused, self._level_m, self._carried_m = 0, 0.0, 0.0
        self.suspicion, self.is_slipping = "", False

    def interrupt(self) -> None:
        """Drops all paths, after a gap or clock jump: a suspicion lasts, and what was not seen before is carried."""
        carried_m = self._carried_m + max([self._level_m, *(bound_m for _, bound_m in self._held)])
        suspicion = self.suspicion
        self.clear()
        self._carried_m, self.suspicion = carried_m, suspicion

    def add(self, fix: Position, swing: Swing) -> None:
        """Takes every fix that passed the checks of form, whether or not it is used."""
        if not self.is_velocity_wrong(fix.stamp_ns):
            self._velocity.add(fix, swing)

    def is_velocity_wrong(self, stamp_ns: int) -> bool:
        """Whether the receiver's velocity is not used: positions and odometry have contradicted it."""
        wrong_ns = self._velocity_wrong_ns
        return wrong_ns is not None and 0 <= stamp_ns - wrong_ns <= self._config.hold_s * 1e9

    def level_m(self, stamp_ns: int) -> float:
        """Largest error by the hypotheses of wrong positions, in addition to that of the fault-free case."""
        since_ns = stamp_ns - self._config.hold_s * 1e9
        held_m = [bound_m for held_ns, bound_m in self._held if held_ns > since_ns]
        return self._carried_m + max([self._level_m, *held_m])

    def _hold(self, stamp_ns: int, bound_m: float) -> None:
        """Holds a bound: an error that a window has shown lasts when the window has passed its begin."""
        while self._held and self._held[0][0] <= stamp_ns - self._config.hold_s * 1e9:
            self._held.popleft()
        self._held.append((stamp_ns, bound_m))

    def add_fixed(self, stamp_ns: int, bound_m: float) -> None:
        """Takes a fix with fixed ambiguities, and the bound of its error by the position before it.

        After a time without them they are wrong once in a thousand: the bound is held, or that by velocity or odometry.
        """
        since_ns, self._fixed_ns = self._fixed_ns, stamp_ns
        if since_ns is None or stamp_ns - since_ns <= self._config.return_s * 1e9:
            return
        paths = (self._velocity.since, self.odometry.since, self.odometry.by_lidar_since)
        found = [s.bound_m(self._config.return_sigmas) for path in paths if (s := path(since_ns)) is not None]
        self._hold(stamp_ns, min([bound_m, *found]))

    def evaluate(self, stamp_ns: int, is_outlier: bool, apart: Separation) -> Finding | None:
        """Evaluates the newest fix; the finding that begins a suspicion.

        `is_outlier`: the fix contradicts the prediction of the graph. `apart`: separation of the fix from the graph,
        the reference of a suspicion after an interruption.
        """
        if self._carried_ns is None:
            self._carried_ns = stamp_ns
        elif stamp_ns - self._carried_ns > self._config.hold_s * 1e9:
            self._carried_m = 0.0
        self._refused = self._refused + 1 if is_outlier else 0
        velocity = self._by_window(self._velocity.since, stamp_ns)
        odometry = self._by_window(self.odometry.since, stamp_ns)
        if self._judge_velocity(stamp_ns, [(s, odometry[w]) for w, s in velocity.items() if w in odometry]):
            velocity = {}
        if self.suspicion:
            self._follow(stamp_ns, apart)
            return None
        cfg = self._config
        lidar = {
            w: s for w, s in self._by_window(self.odometry.by_lidar_since, stamp_ns).items()
            if w in odometry and _apart(s, odometry[w]).ratio_beside_slip([odometry[w].wheel_m]) <= cfg.seen_sigmas
        }  # fmt: skip  # else the lidar may be lost itself
        self._level_m = self._bound_m(stamp_ns, velocity, odometry, lidar)
        return self._suspect(stamp_ns, velocity, odometry, lidar)

    def _by_window(self, since: Callable[[int], Separation | None], stamp_ns: int) -> ByWindow:
        found = {w: since(stamp_ns - round(w.window_s * 1e9)) for w in self._config.windows}
        return {w: separation for w, separation in found.items() if separation is not None}

    def _judge_velocity(self, stamp_ns: int, pairs: list[tuple[Separation, Separation]]) -> bool:
        """Whether the velocity is wrong: odometry agrees with the positions, or contradicts both by more than slip."""
        cfg = self._config
        for velocity, odometry in pairs:
            beside_m = odometry.d_m - velocity.d_m  # of a position by the velocity, from odometry
            by_velocity, by_positions = replace(odometry, d_m=beside_m).ratio, odometry.ratio
            is_outvoted = by_velocity**2 - by_positions**2 > cfg.vote_sigmas**2
            if velocity.ratio > cfg.detect_sigmas and by_positions <= cfg.seen_sigmas and is_outvoted:
                self._velocity.clear()
                self._velocity_wrong_ns = stamp_ns
                if self.suspicion == VELOCITY:
                    self._end_suspicion(stamp_ns, odometry)
                return True
            between = replace(velocity, d_m=beside_m, covariance=velocity.covariance + odometry.covariance)
            if self.suspicion == VELOCITY and between.ratio_beside_slip([odometry.wheel_m]) > cfg.detect_sigmas:
                self.suspicion = ODOMETRY
        return False

    def _bound_m(self, stamp_ns: int, velocity: ByWindow, odometry: ByWindow, lidar: ByWindow) -> float:
        bounds_m = [0.0]
        for w in self._config.windows:
            by_motion = [s for s in (odometry.get(w), lidar.get(w)) if s is not None]
            every = [*by_motion, *(s for s in (velocity.get(w),) if s is not None)]
            best = min(every, key=lambda s: s.bound_m(w.wrong_fix_sigmas), default=None)
            wrong_fix_m = self._bounds_m(w, best, w.wrong_fix_sigmas)
            if best is not None and best.ratio > self._config.seen_sigmas:
                for bound_m in wrong_fix_m:
                    self._hold(stamp_ns, bound_m)
            unspoofed = min(by_motion, key=lambda s: s.bound_m(w.spoofing_sigmas), default=None)
            bounds_m += wrong_fix_m + self._bounds_m(w, unspoofed, w.spoofing_sigmas)
        return max(bounds_m)

    def _bounds_m(self, window: WindowConfig, separation: Separation | None, sigmas: float) -> list[float]:
        """The bound of a window, if it sees well enough or if it sees an error, which wheels do when that is certain.

        Wheels bound nothing over longer windows than `slip_s`: in turns and in reverse slip explains decimetres there.
        """
        cfg, has_wheels = self._config, separation is not None and bool(separation.wheel_m.any())
        if separation is None or (window.window_s > cfg.slip_s and has_wheels):
            return []
        is_seen = separation.ratio > (cfg.detect_sigmas if has_wheels else cfg.seen_sigmas)
        return [separation.bound_m(sigmas)] if is_seen or sigmas * separation.sigma_m <= self._config.cover_m else []

    def _suspect(self, stamp_ns: int, velocity: ByWindow, odometry: ByWindow, lidar: ByWindow) -> Finding | None:
        limit = self._config.detect_sigmas
        ratios = {w: s.ratio for w, s in velocity.items()}
        by_velocity = max(ratios.values(), default=0.0)
        if by_velocity > limit:
            return self._begin(VELOCITY, stamp_ns, ratios)
        # a spoofer's velocity agrees with its positions
        code = VELOCITY if by_velocity > self._config.seen_sigmas else ODOMETRY
        self.is_slipping = max((s.ratio for s in odometry.values()), default=0.0) > limit
        if self.is_slipping:
            parts_m = [s.wheel_m for s in odometry.values()]  # shortest first; slip may begin or end within a window
            ratios = {w: s.ratio_beside_slip(parts_m[: k + 1]) for k, (w, s) in enumerate(odometry.items())}
            if max(ratios.values()) > limit:
                return self._begin(code, stamp_ns, ratios)
        ratios = {
            w: s.ratio for w, s in lidar.items()
            if _apart(s, odometry[w]).ratio <= max(1.0, odometry[w].ratio)
        }  # fmt: skip  # wheels are nearer to the lidar
        if max(ratios.values(), default=0.0) > limit:
            return self._begin(code, stamp_ns, ratios)
        if self._refused >= self._config.refused_fixes and not self.is_slipping:
            self._begin(REFUSED, stamp_ns, dict.fromkeys(odometry, 0.0))
        return None  # the graph has not followed refused fixes: nothing to exclude

    def _begin(self, code: str, stamp_ns: int, ratios: dict[WindowConfig, float]) -> Finding | None:
        """Begins a suspicion, anchored one window before the one that shows it best: nothing was wrong there yet."""
        windows = list(ratios)
        if not windows:
            return None
        best = windows.index(max(windows, key=lambda w: ratios[w]))
        anchor_ns = stamp_ns - round(windows[min(best + 1, len(windows) - 1)].window_s * 1e9)
        self.suspicion, self.anchor_ns, self._agreed_ns = code, anchor_ns, None
        reference, slip = self._reference(), self.odometry.slip_at(anchor_ns)
        if reference is None or slip is None:
            self.suspicion = ""
            return None
        if code != REFUSED:  # the position comes from the reference now
            self._held = deque(h for h in self._held if h[0] <= anchor_ns)
        self.detail = f"{float(np.linalg.norm(reference.d_m)):.2f} m apart in {reference.age_s:.0f} s"
        return Finding(code, reference, *slip)

    def _reference(self) -> Separation | None:
        """Separation since the anchor from the best reference that the suspicion leaves."""
        if self.anchor_ns is None:
            return None
        found = [self.odometry.since(self.anchor_ns), self.odometry.by_lidar_since(self.anchor_ns)]
        if self.suspicion != ODOMETRY:
            found.append(self._velocity.since(self.anchor_ns))
        return min((s for s in found if s is not None), key=lambda s: s.sigma_m, default=None)

    def _follow(self, stamp_ns: int, apart: Separation) -> None:
        """Ends the suspicion when the receiver has agreed with the reference for the configured time."""
        cfg, reference = self._config, apart if self.anchor_ns is None else self._reference()
        if self.suspicion == VELOCITY:
            self._level_m = 0.0  # the receiver contradicts itself: the reference is right
        elif reference is not None:
            self._level_m = reference.bound_m(cfg.return_sigmas)  # either may be right
        if reference is None or reference.sigma_m > cfg.reference_m or not self._agrees(reference):
            self._agreed_ns = None
        elif self._agreed_ns is None:
            self._agreed_ns = stamp_ns
        elif stamp_ns - self._agreed_ns >= cfg.agree_s * 1e9:
            self.clear()
            self._hold(stamp_ns, reference.bound_m(cfg.return_sigmas))

    def _end_suspicion(self, stamp_ns: int, reference: Separation) -> None:
        self.suspicion, self.anchor_ns, self._agreed_ns, self._level_m = "", None, None, 0.0
        self._hold(stamp_ns, reference.bound_m(self._config.return_sigmas))

    def _agrees(self, reference: Separation) -> bool:
        distance_m = float(np.linalg.norm(reference.d_m))
        return distance_m <= self._config.agree_floor_m or reference.ratio <= self._config.agree_sigmas


def _apart(lidar: Separation, wheels: Separation) -> Separation:
    """Separation of wheels from lidar odometry over the same window."""
    return replace(wheels, d_m=lidar.d_m - wheels.d_m)
