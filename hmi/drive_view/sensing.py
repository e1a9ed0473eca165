"""Health and detection range of the obstacle sensors, and the obstacles."""

import math

import numpy as np

from geometry.pose2 import Pose2, from_frame
from hmi.drive_view.row import Level, Row, number
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.motion import Odometry
from messages.perception import HealthState, ObstacleClass, SensorHealth, Track, Tracks

LEVELS: dict[HealthState, Level] = {
    HealthState.GOOD: "good", HealthState.DEGRADED: "warning", HealthState.BLIND: "alarm",
}  # fmt: skip
LIVING = (ObstacleClass.PERSON, ObstacleClass.ANIMAL)
MAX_LISTED = 5
NEAR_M = 40.0


def sensor_rows(state: PageState, texts: Texts) -> list[Row]:
    """State and largest detection range of each sensor of the machine."""
    rows = []
    for topic in state.topics("health"):
        name = topic.partition("/")[2]
        kind, _, place = name.partition("_")
        known = f"sensor_kind.{kind}"
        label = f"{texts(known) if known in texts else kind} {texts.named('place', place)}"
        health = state.fresh(topic, SensorHealth)
        if health is None:
            rows.append(Row(name, label, texts("health.silent"), "alarm"))
            continue
        ahead_m = float(health.detection_range_m.max(initial=0.0))
        value = texts("health.range", state=texts(f"health.{health.state}"), range=number(ahead_m, 0, "m"))
        rows.append(Row(name, label, value, LEVELS[health.state]))
    return rows


def obstacle_rows(state: PageState, texts: Texts) -> list[Row]:
    """Tracked obstacles with class, distance, direction and speed: persons and animals first, then the nearest."""
    rows = []
    found = sorted(near_tracks(state), key=lambda one: one[0].label not in LIVING)
    for track, x_m, y_m in found[:MAX_LISTED]:
        text = texts(
            "obstacle.at", range=number(math.hypot(x_m, y_m), 0, "m"), side=texts(f"direction.{_direction(x_m, y_m)}"),
            speed=number(float(np.hypot(*track.velocity_mps[:2])), 1, "m/s"),
        )  # fmt: skip
        level: Level = "warning" if track.label in LIVING else "plain"
        rows.append(Row(f"track_{track.id}", texts(f"class.{track.label}"), text, level))
    return rows


def near_tracks(state: PageState) -> list[tuple[Track, float, float]]:
    """Confirmed tracks within `NEAR_M` with their place in `base` (x, y), nearest first."""
    tracks, odometry = state.fresh("tracks", Tracks), state.fresh("odom", Odometry)
    if tracks is None or odometry is None or not np.isfinite(odometry.T_odom_base).all():
        return []
    base = Pose2.of(odometry.T_odom_base)
    found = []
    for track in tracks.tracks:
        if not track.is_confirmed or not np.isfinite(track.p_odom_m).all():
            continue
        x_m, y_m = from_frame(base, track.p_odom_m[None, :2])[0].tolist()
        if math.hypot(x_m, y_m) <= NEAR_M:
            found.append((track, x_m, y_m))
    return sorted(found, key=lambda one: math.hypot(*one[1:]))


def track_text(track: Track, texts: Texts) -> str:
    """Class and speed of an obstacle."""
    return f"{texts(f'class.{track.label}')} {number(float(np.hypot(*track.velocity_mps[:2])), 1, 'm/s')}"


def _direction(x_m: float, y_m: float) -> str:
    """Direction from the machine: ahead, left, right or behind, by quadrants about its axes."""
    if abs(y_m) <= abs(x_m):
        return "ahead" if x_m >= 0.0 else "behind"
    return "left" if y_m > 0.0 else "right"
