"""True cross-track error while working."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64, Int64
from messages.plan import Path, PathSectionType
from validation.drive.record import DriveRecord, stamps_of, true_poses

STANDSTILL_MPS = 0.05  # below, samples are dropped: a stop would repeat one position
SEARCH_M = 2.0  # error of the position on the path in the control command


@dataclass(frozen=True)
class CrossTrack:
    """Error of `base` against its path, left positive, (N,), with stamps and path section types."""

    stamp_ns: Int64
    xte_m: Float64
    section_type: tuple[PathSectionType, ...]
    is_working: Float64

    def on(self, section_type: PathSectionType) -> Float64:
        """Errors on one type of path section while the implement worked."""
        chosen = np.array([it is section_type for it in self.section_type], bool) & (self.is_working > 0)
        return self.xte_m[chosen] if len(chosen) else self.xte_m


def lateral_offset(path: Path, x_m: float, y_m: float, s_m: float) -> float:
    """Distance (m) of a point from the path near arc length `s_m`, left of the heading positive."""
    first, last = np.searchsorted(path.s_m, (s_m - SEARCH_M, s_m + SEARCH_M))
    near = path.p_map_m[first : max(int(last), int(first) + 2)]
    offset = np.array([x_m, y_m]) - near[:-1]
    step = near[1:] - near[:-1]
    share = np.clip((offset * step).sum(1) / np.maximum((step**2).sum(1), 1e-12), 0.0, 1.0)
    gap = offset - share[:, None] * step
    k = int(np.argmin((gap**2).sum(1)))
    heading = path.heading_rad[first + k]
    return float(-np.sin(heading) * gap[k, 0] + np.cos(heading) * gap[k, 1])


def measure_cross_track(record: DriveRecord) -> CrossTrack:
    """Error of every true pose with a control command on a known path, at most 0.1 s old, against the driven line."""
    truth, control_commands, paths, mission = record.truth, record.control_commands, record.paths, record.mission
    mission_stamps = stamps_of(mission)
    poses = true_poses(truth)
    index = np.searchsorted(stamps_of(control_commands), stamps_of(truth), side="right") - 1
    rows: list[tuple[int, float, PathSectionType, float]] = []
    for k, (machine, i) in enumerate(zip(truth, index, strict=True)):
        control_command = control_commands[i] if i >= 0 else None
        path = paths.get(control_command.path_id) if control_command else None
        if control_command is None or path is None or machine.stamp_ns - control_command.stamp_ns > 100_000_000:
            continue
        m = int(np.searchsorted(mission_stamps, machine.stamp_ns, side="right")) - 1
        dx, dy = (mission[m].shift_x_m, mission[m].shift_y_m) if m >= 0 else (0.0, 0.0)
        at = path.index_at(control_command.path_s_m)
        section_type = path.sections[path.section_index[at]].section_type
        xte = lateral_offset(path, poses[k, 0] - dx, poses[k, 1] - dy, control_command.path_s_m)
        is_working = path.is_working[at] and machine.is_working and abs(machine.speed_mps) > STANDSTILL_MPS
        rows.append((machine.stamp_ns, xte, section_type, float(is_working)))
    stamps, errors, section_types, work = zip(*rows, strict=True) if rows else ((), (), (), ())
    return CrossTrack(np.array(stamps, np.int64), np.array(errors, float), tuple(section_types), np.array(work, float))


def statistics(errors_m: Float64) -> dict[str, float] | None:
    """Standard deviation, mean and largest absolute value; None without samples."""
    if len(errors_m) == 0:
        return None
    return {
        "sigma": float(errors_m.std()),
        "mean": float(errors_m.mean()),
        "max_abs": float(np.abs(errors_m).max()),
    }
