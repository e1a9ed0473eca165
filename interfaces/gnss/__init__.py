"""GNSS receivers: NMEA 0183 over a serial line or a socket."""
