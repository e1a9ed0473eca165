"""Faults reported by the localizer, by code."""

from messages.fault_reporter import FaultType
from messages.faults import Response, Severity

STOP = Severity.ALARM, Response.CONTROLLED_STOP
ALARM = Severity.ALARM, Response.NONE
WARNING, NOTICE = (Severity.WARNING, Response.NONE), (Severity.NOTICE, Response.NONE)

FAULTS = {
    fault.code: fault
    for fault in (
        FaultType("imu.silent", *STOP, "IMU: no data", "惯性传感器无数据"),
        FaultType("wheel.silent", *STOP, "Wheel speed: no data", "轮速传感器无数据"),
        FaultType("imu.frozen", *STOP, "IMU: repeated values", "惯性传感器数值不变"),
        FaultType("imu.noisy", *STOP, "IMU: noise too high", "惯性传感器噪声过大"),
        FaultType("imu.implausible", *STOP, "IMU: implausible values", "惯性传感器数值不合理"),
        FaultType("wheel.implausible", *STOP, "Wheel speed or steering angle implausible", "轮速或转向角数值不合理"),
        FaultType("imu_or_wheel.implausible", *STOP, "IMU and wheels contradict", "惯性传感器与车轮数据矛盾"),
        FaultType("gnss.silent", *WARNING, "GNSS: no position", "无卫星定位数据"),
        FaultType("gnss.refused", *WARNING, "GNSS positions rejected", "卫星定位数据被拒绝"),
        FaultType("gnss.contradicts_velocity", *ALARM, "GNSS contradicts its own velocity", "卫星位置与速度矛盾"),
        FaultType("gnss.contradicts_odometry", *ALARM, "GNSS contradicts wheels and IMU", "卫星定位与车轮和惯导矛盾"),
        FaultType("gnss.velocity_refused", *WARNING, "GNSS velocity contradicts its positions", "卫星速度与位置矛盾"),
        FaultType("gnss.heading_refused", *ALARM, "GNSS heading contradicts the gyro", "卫星定向与陀螺仪矛盾"),
        FaultType("wheel.slipping", *WARNING, "Wheels slip, or GNSS is spoofed", "车轮打滑或卫星信号被欺骗"),
        FaultType("gnss.no_heading", *STOP, "No GNSS heading: start needs motion", "无卫星航向:启动需要移动"),
        FaultType("localization.awaits", *STOP, "Position not found yet", "尚未确定位置"),
        FaultType("localization.not_docked", *STOP, "Position at the dock not confirmed", "停靠位置未确认"),
        FaultType("lidar_odometry.silent", *WARNING, "Lidar odometry: no data", "激光里程计无数据"),
        FaultType("lidar_localization.silent", *WARNING, "Lidar localization: no data", "激光定位无数据"),
        FaultType("uwb.refused", *WARNING, "UWB ranges rejected", "UWB测距数据被拒绝"),
        FaultType("localization.lost", *STOP, "Position lost: stand still to recover", "定位丢失:请保持静止以恢复"),
        FaultType("localization.rebuilt", *NOTICE, "Position graph rebuilt", "定位因子图已重建"),
        FaultType("imu.invalid", *NOTICE, "IMU: invalid values dropped", "惯性传感器:无效数据已丢弃"),
        FaultType("wheel.invalid", *NOTICE, "Wheel speed: invalid values dropped", "轮速传感器:无效数据已丢弃"),
        FaultType("gnss.invalid", *NOTICE, "GNSS: invalid values dropped", "卫星定位:无效数据已丢弃"),
        FaultType("uwb.invalid", *NOTICE, "UWB: invalid values dropped", "UWB:无效数据已丢弃"),
        FaultType("clock.jumped", *WARNING, "Clock jumped", "时钟跳变"),
    )
}
