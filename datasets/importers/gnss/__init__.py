"""Streams of GNSS receivers: framing, NMEA 0183 and UBX epochs, times."""
