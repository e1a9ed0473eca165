"""Broken devices: what each fault makes of messages on a topic, of frames on the machine's bus, of nodes and the clock.

A topic here is one of the stack's (`imu`, `lidar/front`), `can/<message of the DBC>`, `node/<name>`, `clock` or `log`.
"""
