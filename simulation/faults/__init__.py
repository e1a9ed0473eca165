"""Fault injection: faults of messages on a topic, of frames on the machine's bus, of nodes, clock and log.

Topics are those of the stack (`imu`, `lidar/front`), `can/<message of the DBC>`, `node/<name>`, `clock` or `log`.
"""
