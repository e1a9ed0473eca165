"""Sensor kinds in validation: field of view, and removal of an object from the measurements, one file per kind."""

MARGIN_M = 0.5  # of a removed object: limbs, motion within a scan, and spread of radar detections
