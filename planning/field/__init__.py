"""The field: boundary, drivable area, generated site."""
