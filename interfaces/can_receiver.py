"""CAN receiver: decodes the frames of the machine and keeps the newest valid values of each group."""

import math
from collections.abc import Callable

from interfaces.isobus import address, cab, guidance, heartbeat, implement, speed
from interfaces.isobus.checksum import ProtectionCheck
from interfaces.isobus.frame import BROADCAST, decode_identifier
from interfaces.isobus.values import BadFrame, require_length
from messages.command import MachineState

_NO_STEERING = guidance.GuidanceStatus(0.0, False, False, 7, guidance.EXIT_NOT_AVAILABLE)
_NO_DRIVER_STEERING = cab.DriverSteering(0.0, 0.0, 0.0)
_NO_CAB = cab.CabState(0.0, 0.0, 0.0, False, False, False, False, False)
_RADPS_PER_RPM = 2.0 * math.pi / 60.0


class CanReceiver:
    """Decodes the frames of one tractor; an invalid frame is counted and changes nothing."""

    def __init__(self, tractor_address: int) -> None:
        self._tractor = tractor_address
        self.rejected = 0
        self.claims: list[tuple[int, int]] = []
        self.is_claim_requested = False
        self.heartbeat = heartbeat.HeartbeatCheck()
        self.steering, self.steering_ns = _NO_STEERING, 0
        self.speed_mps, self.motion_ns = 0.0, 0
        self.hitch, self.hitch_ns = implement.HitchStatus(0.0, False, 7), 0
        self.pto, self.pto_ns = implement.PtoStatus(0.0, False, 7), 0
        self.driver_steering, self.driver_steering_ns = _NO_DRIVER_STEERING, 0
        self.cab, self.cab_ns = _NO_CAB, 0
        self.fold, self.fold_ns = 0.0, 0
        self._heartbeat_ns = 0
        self._protection: dict[int, ProtectionCheck] = {}
        self._readers: dict[int, Callable[[int, int, bytes], None]] = {
            guidance.STATUS_GROUP: self._read_guidance,
            speed.WHEEL_GROUP: self._read_speed,
            implement.REAR_HITCH_GROUP: self._read_hitch,
            implement.REAR_PTO_GROUP: self._read_pto,
            cab.GROUP: self._read_cab,
            heartbeat.GROUP: self._read_heartbeat,
        }

    def receive(self, now_ns: int, own_address: int, identifier: int, data: bytes) -> None:
        """Processes one frame; frames of other senders or to other receivers are ignored."""
        group, source, destination = decode_identifier(identifier)[1:]
        try:
            if group in (address.CLAIM_GROUP, address.REQUEST_GROUP):
                self._read_network(group, source, data)
            elif source == self._tractor and destination in (own_address, BROADCAST):
                reader = self._readers.get(group)
                if reader is not None:
                    reader(now_ns, identifier, data)
        except BadFrame:
            self.rejected += 1

    def state(self, now_ns: int) -> MachineState:
        """Newest values of all groups; the stamp of a group of several frames is that of the oldest.

        The fold frame is optional: an implement that cannot fold does not send it and stays at working width.
        """
        implement_ns = min(self.hitch_ns, self.pto_ns)
        return MachineState(
            stamp_ns=now_ns,
            motion_stamp_ns=self.motion_ns,
            steering_stamp_ns=self.steering_ns,
            implement_stamp_ns=min(implement_ns, self.fold_ns) if self.fold_ns else implement_ns,
            cab_stamp_ns=min(self.driver_steering_ns, self.cab_ns),
            heartbeat_stamp_ns=self._heartbeat_ns,
            speed_mps=self.speed_mps,
            curvature_radpm=self.steering.curvature_radpm,
            is_steering_ready=self.steering.is_steering_ready and not self.steering.is_locked_out,
            steering_exit_code=self.steering.exit_code,
            steering_limit=self.steering.limit,
            hitch=self.hitch.position,
            is_hitch_in_work=self.hitch.is_in_work,
            pto_radps=self.pto.speed_rpm * _RADPS_PER_RPM,
            is_pto_engaged=self.pto.is_engaged,
            is_park_brake_set=self.cab.is_park_brake_set,
            is_horn_on=self.cab.is_horn_on,
            is_beacon_on=self.cab.is_beacon_on,
            brake_pedal=self.cab.brake_pedal,
            driver_torque_nm=self.driver_steering.torque_nm,
            driver_rate_radps=self.driver_steering.rate_radps,
            driver_angle_rad=self.driver_steering.angle_rad,
            is_seat_occupied=self.cab.is_seat_occupied,
            is_emergency_button_pressed=self.cab.is_emergency_button_pressed,
            supply_v=self.cab.supply_v,
            rejected_frames=self.rejected,
            fold_position=self.fold,
        )

    def _read_network(self, group: int, source: int, data: bytes) -> None:
        if group == address.CLAIM_GROUP:
            require_length(data)
            self.claims.append((source, int.from_bytes(data, "little")))
        elif data == address.CLAIM_GROUP.to_bytes(3, "little"):
            self.is_claim_requested = True

    def _read_guidance(self, now_ns: int, identifier: int, data: bytes) -> None:
        self.steering, self.steering_ns = guidance.decode_status(data), now_ns

    def _read_speed(self, now_ns: int, identifier: int, data: bytes) -> None:
        self.speed_mps, self.motion_ns = speed.decode_speed(data), now_ns

    def _read_hitch(self, now_ns: int, identifier: int, data: bytes) -> None:
        self.hitch, self.hitch_ns = implement.decode_hitch(data), now_ns

    def _read_pto(self, now_ns: int, identifier: int, data: bytes) -> None:
        self.pto, self.pto_ns = implement.decode_pto(data), now_ns

    def _read_cab(self, now_ns: int, identifier: int, data: bytes) -> None:
        self._protection.setdefault(data[0] if data else 0, ProtectionCheck()).check(identifier, data)
        state = cab.decode_cab_state(data)
        if isinstance(state, cab.DriverSteering):
            self.driver_steering, self.driver_steering_ns = state, now_ns
        elif isinstance(state, cab.FoldState):
            self.fold, self.fold_ns = state.position, now_ns
        else:
            self.cab, self.cab_ns = state, now_ns

    def _read_heartbeat(self, now_ns: int, identifier: int, data: bytes) -> None:
        require_length(data, 1)
        if not self.heartbeat.receive(now_ns, data[0]):
            raise BadFrame(f"heartbeat {data[0]}")
        if self.heartbeat.is_good(now_ns):
            self._heartbeat_ns = now_ns
