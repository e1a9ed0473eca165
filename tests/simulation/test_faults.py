"""Fault injection: every kind of fault on messages and frames, and validation of faults."""

import math

import can
import numpy as np
import pytest

from configs.strict import CONFIGS, load
from interfaces.can_receiver import CanReceiver
from messages.errors import ConfigError, LogError
from messages.message import Envelope
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan, WheelSample
from messages.topics import TOPICS
from simulation.faults.config import SENSOR_FAULTS, FaultKind, FaultsConfig, InjectedFault, fault_kinds_of
from simulation.faults.frames import FaultyBus
from simulation.faults.injection import HOUR_NS, FaultInjection
from simulation.machine.tractor_bus import load_database
from simulation.machine.tractor_status import StatusFrame

MS = 1_000_000
START = 1_700_000_000_000 * MS
CONFIG = load(FaultsConfig, CONFIGS / "faults.yaml")


def wheel(k: int) -> WheelSample:
    return WheelSample(START + 20 * k * MS, 2.0 + 0.001 * k, 0.1)


def faulty_samples(
    kind: FaultKind, n: int = 40, from_s: float = 0.2, for_s: float = 0.4
) -> list[tuple[int, WheelSample]]:
    """Wheel samples every 20 ms through one fault, with their time of arrival (ms)."""
    injection = FaultInjection([InjectedFault(topic="wheel", kind=kind, from_s=from_s, for_s=for_s)], CONFIG, START, 1)
    received = []
    for k in range(n):
        now_ns = START + 20 * k * MS
        received += [((now_ns - START) // MS, m) for _, m in injection.due(now_ns)]
        received += [((now_ns - START) // MS, m) for _, m in injection.apply(now_ns, [("wheel", wheel(k))])]
    return received


@pytest.mark.parametrize("kind", SENSOR_FAULTS)
def test_no_change_outside_fault_interval(kind: FaultKind) -> None:
    samples = [wheel(k) for k in range(40)]
    received = [m for t, m in faulty_samples(kind) if t < 200 or t >= 600]
    for k in (*range(10), *range(30, 40)):
        assert any(m.stamp_ns == samples[k].stamp_ns and m.speed_mps == samples[k].speed_mps for m in received), k


def samples_within_fault(kind: FaultKind) -> list[tuple[int, WheelSample]]:
    return [(t, m) for t, m in faulty_samples(kind) if 200 <= t < 600]


def test_off_without_messages() -> None:
    assert samples_within_fault(FaultKind.OFF) == []


def test_frozen_and_repeated_stamps() -> None:
    frozen, repeated = samples_within_fault(FaultKind.FROZEN), samples_within_fault(FaultKind.REPEATED)
    assert {m.speed_mps for _, m in frozen} == {m.speed_mps for _, m in repeated} == {2.010}
    assert [m.stamp_ns for _, m in frozen] == [START + t * MS for t, _ in frozen]
    assert {m.stamp_ns for _, m in repeated} == {START + 200 * MS}


def test_out_of_order_pairs() -> None:
    numbers = [round((m.speed_mps - 2.0) * 1000) for _, m in samples_within_fault(FaultKind.OUT_OF_ORDER)]
    assert numbers[:6] == [11, 10, 13, 12, 15, 14]


def test_delay_twice_max_age() -> None:
    late = [
        (t - (m.stamp_ns - START) // MS) for t, m in faulty_samples(FaultKind.DELAYED) if m.stamp_ns >= START + 200 * MS
    ]
    assert max(late) == round(2000 * TOPICS["wheel"].max_age_s)


def test_slow_gaps_exceed_max_age() -> None:
    times = [t for t, _ in samples_within_fault(FaultKind.SLOW)]
    assert min(np.diff(times)) >= 3000 * TOPICS["wheel"].max_age_s - 20


def test_corrupted_values() -> None:
    assert all(math.isnan(m.speed_mps) for _, m in samples_within_fault(FaultKind.NAN))
    assert samples_within_fault(FaultKind.OFFSET)[0][1].speed_mps == pytest.approx(2.010 + 0.5)
    assert samples_within_fault(FaultKind.WRONG_UNIT)[0][1].speed_mps == pytest.approx(2.010 * 3.6)
    noisy = np.array([m.speed_mps for _, m in samples_within_fault(FaultKind.NOISY)])
    assert 0.2 < noisy.std() < 1.0
    assert len({m.speed_mps for _, m in samples_within_fault(FaultKind.GARBAGE)}) > 15


def test_plausible_values() -> None:
    assert samples_within_fault(FaultKind.SCALE)[0][1].speed_mps == pytest.approx(2.010 * CONFIG.plausible.scale)
    assert samples_within_fault(FaultKind.SIGN)[0][1].speed_mps == pytest.approx(-2.010)
    errors = [m.speed_mps - 2.0 - (m.stamp_ns - START) * 5e-11 for _, m in samples_within_fault(FaultKind.DRIFT)]
    assert errors[0] == pytest.approx(0.0, abs=1e-9)
    assert errors[-1] == pytest.approx(0.5 * 0.38 / CONFIG.plausible.drift_s)


def test_replay_repeats_content_with_new_stamps() -> None:
    long = [m for t, m in faulty_samples(FaultKind.REPLAY, n=400, from_s=0.2, for_s=7.0) if 200 <= t < 7000]
    period = round(CONFIG.plausible.replay_s * 1e3 / 20)
    assert [m.speed_mps for m in long[period : 2 * period]] == [m.speed_mps for m in long[:period]]
    assert [m.stamp_ns for m in long] == [START + 200 * MS + 20 * k * MS for k in range(len(long))]


def test_swapped_sensors_exchange_their_topics() -> None:
    topics = ["lidar/rear", "lidar/front", "imu"]
    fault = InjectedFault(topic="lidar/front", kind=FaultKind.SWAPPED, from_s=0.1, for_s=9.0)
    injection = FaultInjection([fault], CONFIG, START, 1)
    injection.check_topics(topics)
    sent = [(topic, SAMPLES.get(topic, SAMPLES["lidar/front"])) for topic in topics]
    assert [topic for topic, _ in injection.apply(START, sent)] == topics
    assert [topic for topic, _ in injection.apply(START + 200 * MS, sent)] == ["lidar/front", "lidar/rear", "imu"]
    alone = FaultInjection([fault], CONFIG, START, 1)
    alone.check_topics(["lidar/front"])
    assert alone.apply(START + 200 * MS, sent[1:2]) == sent[1:2]


def scan() -> LidarScan:
    ranges = np.array([[0, 5000, 65535]], np.uint16)
    return LidarScan(START, ranges, np.zeros(1), np.zeros(3), np.zeros((0, 3), np.float32), np.zeros(0, np.uint8),
                     np.zeros(3, np.float32))  # fmt: skip


SAMPLES = {
    "lidar/front": scan(),
    "imu": ImuSample(START, np.zeros(3), np.zeros(3)),
    "gnss/main": GnssFix(
        START, 0.9, 0.1, 24.0, np.ones(3), np.zeros(3), 0.1, 1.0, 0.01, GnssSolution.RTK_FIXED, 20, 0.8, 1.0, "BDS"
    ),
    "wheel": wheel(0),
}


@pytest.mark.parametrize("topic", SAMPLES)
@pytest.mark.parametrize("kind", SENSOR_FAULTS)
def test_fault_kinds_keep_message_type(topic: str, kind: FaultKind) -> None:
    injection = FaultInjection([InjectedFault(topic=topic, kind=kind, from_s=0.0, for_s=9.0)], CONFIG, START, 1)
    outputs = [output for k in range(5) for output in injection.apply(START + k * MS, [(topic, SAMPLES[topic])])]
    assert all(type(message) is type(SAMPLES[topic]) for _, message in outputs)
    again = FaultInjection([InjectedFault(topic=topic, kind=kind, from_s=0.0, for_s=9.0)], CONFIG, START, 1)
    assert repr(outputs) == repr([o for k in range(5) for o in again.apply(START + k * MS, [(topic, SAMPLES[topic])])])


def test_lidar_faults_within_integer_range() -> None:
    for kind, expected in ((FaultKind.NAN, [0, 0, 0]), (FaultKind.OFFSET, [0, 6000, 65535]),
                           (FaultKind.WRONG_UNIT, [0, 500, 6554])):  # fmt: skip
        injection = FaultInjection(
            [InjectedFault(topic="lidar/front", kind=kind, from_s=0.0, for_s=9.0)], CONFIG, START, 1
        )
        (_, message), *_ = injection.apply(START, [("lidar/front", scan())])
        assert isinstance(message, LidarScan)
        assert message.ranges_mm.tolist() == [expected]


def test_invalid_fault_rejected() -> None:
    with pytest.raises(ConfigError, match="absent"):
        FaultInjection([], CONFIG, START, 1).check_topics([]) or FaultInjection(
            [InjectedFault(topic="lidar/absent", kind=FaultKind.OFF, from_s=0, for_s=1)], CONFIG, START, 1
        ).check_topics(["lidar/front"])
    with pytest.raises(ValueError, match="cannot be"):
        InjectedFault(topic="imu", kind=FaultKind.RAISES, from_s=0, for_s=1)
    with pytest.raises(ConfigError, match="no field"):
        FaultInjection([InjectedFault(topic="odom", kind=FaultKind.NAN, from_s=0, for_s=1)], CONFIG, START, 1)
    assert fault_kinds_of("node/localizer") == (FaultKind.RAISES, FaultKind.HANGS)


def test_clock_step_and_full_disk() -> None:
    faults = [InjectedFault(topic="clock", kind=FaultKind.BEHIND, from_s=1.0, for_s=1.0),
              InjectedFault(topic="log", kind=FaultKind.FULL, from_s=0.0, for_s=1.0)]  # fmt: skip
    injection = FaultInjection(faults, CONFIG, START, 1)
    assert [injection.clock_error_ns(START + t * MS) for t in (999, 1000, 1999, 2000)] == [0, -HOUR_NS, -HOUR_NS, 0]
    with pytest.raises(LogError):
        injection(Envelope("wheel", 0, START, wheel(0)))


class Rig:
    """Frames of a tractor through a faulty bus, decoded as in the gateway."""

    VALUES = {  # noqa: RUF012
        "WheelBasedSpeed": {"Speed": 2.0, "Direction": 1},
        "GuidanceMachineStatus": {"EstimatedCurvature": -50.0, "MechanicalLockout": 0, "SteeringReady": 1,
                                  "LimitStatus": 0, "ExitCode": 0},
        "RearHitchStatus": {"Position": 80.0, "InWork": 1, "LimitStatus": 0},
        "RearPtoStatus": {"Speed": 540.0, "Engaged": 1, "LimitStatus": 0},
        "HeartbeatTractor": {"Sequence": 0},
        "CabState": {"Group": 2, "BrakePedal": 0, "ClutchPedal": 0, "SupplyVoltage": 13.8, "Seat": 0,
                     "EmergencyButton": 0, "ParkBrakeState": 0, "HornState": 0, "BeaconState": 0},
    }  # fmt: skip

    def __init__(self, name: str, kind: FaultKind) -> None:
        channel = f"faults{id(self)}"
        self.near, self.far = can.Bus(channel, interface="virtual"), can.Bus(channel, interface="virtual")
        fault = InjectedFault(topic=f"can/{name}", kind=kind, from_s=0.5, for_s=60.0)
        self.injection = FaultInjection([fault], CONFIG, START, 1)
        self.bus = FaultyBus(self.near, self.injection, load_database())
        self.frame = StatusFrame(load_database().get_message_by_name(name))
        self.receiver, self.name, self.count = CanReceiver(240), name, 0
        self.received: list[bytes] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.count += 1
            self.injection.now_ns = START + self.count * 100 * MS
            values = dict(self.VALUES[self.name])
            values |= {"Counter": self.count & 15} if self.name == "CabState" else {}
            values |= {"Sequence": self.count} if self.name == "HeartbeatTractor" else {}
            data = self.frame.encode(values)
            self.far.send(can.Message(arbitration_id=self.frame.identifier, data=data, is_extended_id=True))
            while (frame := self.bus.recv(0)) is not None:
                self.received.append(bytes(frame.data))
                self.receiver.receive(self.injection.now_ns, 28, frame.arbitration_id, bytes(frame.data))

    def close(self) -> None:
        self.near.shutdown()
        self.far.shutdown()


@pytest.mark.parametrize("name", Rig.VALUES)
@pytest.mark.parametrize("kind", SENSOR_FAULTS)
def test_frame_faults_only_in_interval(name: str, kind: FaultKind) -> None:
    rig = Rig(name, kind)
    try:
        rig.run(0.4)
        assert rig.receiver.rejected == 0
        assert len(rig.received) == 4
        rig.run(2.0)
    finally:
        rig.close()
    after = rig.received[4:]
    assert len(after) == {FaultKind.OFF: 0, FaultKind.DELAYED: 14, FaultKind.SLOW: 3}.get(kind, 20)
    assert rig.injection.faulty_items == {f"can/{name}": 20}
    if kind is FaultKind.NAN and name != "HeartbeatTractor":
        fresh = {"WheelBasedSpeed": rig.receiver.motion_ns, "GuidanceMachineStatus": rig.receiver.steering_ns,
                 "RearHitchStatus": rig.receiver.hitch_ns, "RearPtoStatus": rig.receiver.pto_ns,
                 "CabState": rig.receiver.cab_ns}[name]  # fmt: skip
        assert fresh == START + 400 * MS


def test_frozen_signal_with_running_counter() -> None:
    rig = Rig("CabState", FaultKind.FROZEN)
    rig.run(3.0)
    rig.close()
    assert rig.receiver.rejected == 0
    assert len({data[7] for data in rig.received[5:]}) == 16


def test_repeated_counter_rejected() -> None:
    for name in ("CabState", "HeartbeatTractor"):
        rig = Rig(name, FaultKind.REPEATED)
        rig.run(3.0)
        rig.close()
        assert rig.receiver.rejected >= 20


def test_wrong_unit_speed_accepted() -> None:
    rig = Rig("WheelBasedSpeed", FaultKind.WRONG_UNIT)
    rig.run(1.0)
    rig.close()
    assert rig.receiver.speed_mps == pytest.approx(7.2)
