"""Stop before a person who is visible to a single kind of sensor."""

import numpy as np
import pytest

from configs.strict import parse
from geometry.transforms import apply
from messages.command import SafeCommand
from messages.motion import MapPose
from messages.perception import Tracks
from messages.truth import TrueMachine, TrueObjects
from runtime.setup import load_setup, with_model
from simulation.scenario import Scenario
from tests.recordings import recording
from tests.scenarios.forward import Drive, forward
from tests.scenarios.straight import on_a_line

YOLOX = "onnx-detectors/yolox-nano/model/yolox_nano.onnx"


def walker(kind: str) -> Scenario:
    """A person visible to one kind of sensor, who walks to the middle of the path, stands, and leaves late."""
    return parse(
        Scenario,
        {
            "name": kind, "operator_commands": [{"at_s": 0.5, "command": "start", "expires_s": 5.0}],
            "encounters": [{
                "kind": "crossing", "name": "person", "actor": "person", "expected_stops": 1, "visible_to": [kind],
                "swath_fraction": [0.65, 0.66], "start_lateral_m": [3.0, 3.1], "skew_deg": [0.0, 1.0],
                "walk_speed_mps": [1.2, 1.3], "leave_speed_mps": [1.2, 1.3],
                "arrival_margin_s": [1.5, 1.6], "extra_stand_s": [30.0, 31.0],
            }],
        },
        kind,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "length_m", "speed_kmh"),
    [("lidar", 50.0, 10.0), ("radar", 50.0, 10.0), ("camera", 50.0, 10.0), ("ultrasonic", 40.0, 2.0)],
)
def test_stop_by_single_sensor(kind: str, length_m: float, speed_kmh: float) -> None:
    setup = on_a_line(load_setup("yard", None, None, None, 1), length_m, speed_kmh)
    setup = with_model(setup, recording(YOLOX) if kind == "camera" else None)

    def stands(drive: Drive) -> bool:
        if "safe_command" not in drive.newest:
            return False
        reason = drive.last("safe_command", SafeCommand).reason
        return (
            reason.startswith(("protective_field", "tracked_obstacle"))
            and drive.last("truth_machine", TrueMachine).speed_mps < 0.05
        )

    drive = forward(setup, stands, 60.0, walker(kind))
    assert drive.last("truth_machine", TrueMachine).contacts == 0
    (person,) = (o for o in drive.last("truth_objects", TrueObjects).objects if o.role == "person")
    assert 0.3 < person.clearance_m < 5.0
    T_map_odom = drive.last("map_pose", MapPose).T_map_odom
    sensors = [
        name.partition("_")[0]
        for track in drive.last("tracks", Tracks).tracks
        if np.linalg.norm((apply(T_map_odom, track.p_odom_m) - person.center_map_m)[:2]) < 1.0
        for name in track.sensors
    ]
    assert set(sensors) == {kind}
