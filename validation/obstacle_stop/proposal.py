"""Lines and pictures of the objects that are proposed as truth (`datasets/importers/sidecar_lines.py`)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import to_frame
from geometry.transforms import invert
from validation.obstacle_stop.figures import BOX, OWN, POINT, THIS, draw
from validation.obstacle_stop.observation import LogObservation, Setting
from validation.obstacle_stop.perceived_objects import Perceived

CLOSE_UP_M = 3.0


def file_line(
    log: str, frame: str, scans_ns: Sequence[int], T_base_lidar: Float64, observed: LogObservation
) -> dict[str, Any]:
    """First line of the file."""
    return {
        "log": log, "frame": frame, "first_ns": scans_ns[0], "last_ns": scans_ns[-1],
        "period_s": round(observed.period_s, 4), "ground_m": round(-float(T_base_lidar[2, 3]), 3), "is_complete": False,
        "note": "set status to accepted or rejected in the lines with a picture, or use: headland label LOG",
    }  # fmt: skip


def object_line(one: Perceived, picture: str, observed: LogObservation) -> dict[str, Any]:
    """Line of an object, with its median size."""
    first, last = (round(observed.time_s(int(one.stamps_ns[k])), 3) for k in (0, -1))
    return {
        "id": one.id, "status": "proposed", "class": one.label,
        "size_m": [round(float(v), 2) for v in np.median(one.boxes[:, 3:6], axis=0)], "first_s": first, "last_s": last,
        "range_m": [round(float(one.ranges_m[0]), 2), round(float(one.ranges_m.min()), 2)],
        "is_stop_requested": one.is_stop_requested, "picture": picture,
    }  # fmt: skip


def box_lines(one: Perceived, T_base_lidar: Float64, observed: LogObservation) -> list[dict[str, Any]]:
    """Boxes of an object in the lidar frame."""
    T = invert(T_base_lidar)
    turn = math.atan2(T[1, 0], T[0, 0])
    centers = one.boxes[:, :3] @ T[:3, :3].T + T[:3, 3]
    return [
        {
            "stamp_ns": stamp_ns, "t_s": round(observed.time_s(stamp_ns), 3), "id": one.id, "status": "proposed",
            "class": one.label, "center_m": [round(float(v), 3) for v in center],
            "size_m": [round(float(v), 2) for v in box[3:6]],
            "yaw_deg": round(math.degrees(math.remainder(box[6] + turn, 2.0 * math.pi)), 1),
            "range_m": round(float(range_m), 2),
        }
        for stamp_ns, center, box, range_m in zip(one.stamps_ns.tolist(), centers, one.boxes, one.ranges_m, strict=True)
    ]  # fmt: skip


def proposal_figure(one: Perceived, setting: Setting, observed: LogObservation) -> bytes:
    """PNG: from above, close up as seen from the machine, range over time, and the camera image if there is one."""
    view = one.view
    panels = 1 if view is None else 3 + (view.bgr is not None)

    def plot(axes: Sequence[Any]) -> None:
        t = [observed.time_s(stamp_ns) for stamp_ns in one.stamps_ns.tolist()]
        axes[0].plot(t, one.ranges_m, ".-", color=THIS)
        axes[0].set(xlabel="time in the log (s)", ylabel="range from the front (m)", ylim=(0, None))
        axes[0].set_title(f"object {one.id}: {one.label}", fontsize=9)
        if view is None:
            return
        box = one.boxes[int(np.argmin(np.abs(one.stamps_ns - view.stamp_ns)))]
        _from_above(axes[1], view.scene_m, box, setting)
        axes[1].set_title(f"from above, {observed.time_s(view.stamp_ns):.1f} s", fontsize=9)
        _close_up(axes[2], view.close_m, box)
        if view.bgr is not None:
            axes[3].imshow(view.bgr[..., ::-1])
            axes[3].set_axis_off()

    return draw(plot, panels, (3.7 * panels, 3.7))


def _from_above(ax: Any, points: Any, box: Float64, setting: Setting) -> None:
    high = points[points[:, 2] > 0.2]
    ax.plot(-high[:, 1], high[:, 0], ".", color=POINT, ms=1.5, mew=0)
    half = 0.5 * setting.width_m
    ax.fill([-half, half, half, -half], [-1.0, -1.0, setting.front_m, setting.front_m], color=OWN)
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)]) * 0.5 * box[3:5]
    x, y = to_frame(box[[0, 1, 6]], corners).T
    ax.plot(-y, x, color=THIS, lw=1.4)
    ax.plot(-box[1], box[0], "o", color=THIS, ms=14, mfc="none", lw=0.8)
    reach = max(20.0, 1.3 * float(np.hypot(*box[:2])))
    ax.set(xlim=(-0.5 * reach, 0.5 * reach), ylim=(-2, reach - 2), aspect="equal")
    ax.set(xlabel="right (m)", ylabel="ahead (m)")


def _close_up(ax: Any, points: Any, box: Float64) -> None:
    """Returns near the object, across the line of sight."""
    bearing = math.atan2(box[1], box[0])
    across = (points[:, 1] - box[1]) * math.cos(bearing) - (points[:, 0] - box[0]) * math.sin(bearing)
    along = (points[:, 0] - box[0]) * math.cos(bearing) + (points[:, 1] - box[1]) * math.sin(bearing)
    reach = max(CLOSE_UP_M, float(box[3:5].max()))
    near = (np.abs(across) < reach) & (np.abs(along) < reach)
    is_own = (np.abs(across) < 0.5 * np.hypot(*box[3:5])) & (np.abs(along) < 0.5 * np.hypot(*box[3:5]))
    for mask, color in ((near & ~is_own, BOX), (near & is_own, THIS)):
        ax.plot(-across[mask], points[mask, 2], ".", color=color, ms=3.0, mew=0)
    ax.set(
        xlim=(-reach, reach), ylim=(-0.3, 2.0 * reach - 0.3), aspect="equal", xlabel="right (m)", ylabel="height (m)"
    )
    ax.set_title("as seen from the machine", fontsize=9)
